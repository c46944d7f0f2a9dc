"""Grasps out of other people's simulators and hand models (extra ``hands``)."""
