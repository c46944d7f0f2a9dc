"""Solver of one grasp in C++17, without JAX: headers for controllers, and their folder"""

from pathlib import Path


def include_folder() -> Path:
    """Return the folder of ``one_grasp.h`` and ``one_grasp_c.h``, for the compiler's option ``-I``."""
    return Path(__file__).parent
