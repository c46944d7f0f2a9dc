// In place of NVIDIA Warp's header of this name, of which publishing addresses needs nothing; see builtin.h.
