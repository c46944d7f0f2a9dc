// What NVIDIA Warp's generated code needs of its header builtin.h to publish the kernel's addresses on a processor.
//
// Parsing the whole of builtin.h takes a second, longer than compiling the solver. Nothing here depends on the layout
// of Warp's structures: the code runs once, whatever the bounds, and reads one integer, the first argument. Where
// another version of Warp generates code that needs more, compiled.py compiles with the whole header.
#ifndef JAXGRASP_KERNEL_WARP_HEADERS_BUILTIN_H
#define JAXGRASP_KERNEL_WARP_HEADERS_BUILTIN_H

#include "crt.h"  // Warp's own: declarations of memcpy and its like.

#define CUDA_CALLABLE
#define WP_FORCEINLINE inline

namespace wp {

typedef unsigned long long uint64;

template <int Dimensions> struct launch_bounds_t {
  static constexpr int size = 1;
};
struct tile_shared_storage_t {};
static tile_shared_storage_t* shared_tile_storage [[maybe_unused]];

}  // namespace wp

#endif
