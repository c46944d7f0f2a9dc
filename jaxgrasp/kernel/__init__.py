"""Solver of one grasp in C++17: headers for controllers without JAX, and what JAX calls where the extra is installed"""

import os
from importlib.util import find_spec
from pathlib import Path

VARIABLE = "JAXGRASP_KERNEL"
"""Environment variable that, set to 0, leaves all problems to the JAX solver; read when the first one is solved."""
MISSING = "the compiled kernel needs NVIDIA Warp: pip install 'jaxgrasp[kernel]'"
_choice: bool | None = None


def include_folder() -> Path:
    """Return the folder of ``one_grasp.h`` and ``one_grasp_c.h``, for the compiler's option ``-I``."""
    return Path(__file__).parent


def is_installed() -> bool:
    """Return whether the extra ``kernel``, NVIDIA Warp, is installed; nothing is imported."""
    return find_spec("warp") is not None


def use_kernel(enabled: bool = True) -> None:
    """Have the C++ kernel solve what it can, or leave all problems to the JAX solver.

    Without this call the kernel is used where the extra ``kernel`` is installed, unless the environment variable
    ``JAXGRASP_KERNEL`` is 0. The kernel has no guides (``free``), no limits of joint torques, and up to 128 contacts;
    other problems go to the JAX solver, and so do programs for ``jax.export``, which are to run on other machines.
    Programs that ``jax.jit`` has compiled before keep what they were compiled with.

    Raises:
        ImportError: where it is enabled and the extra is not installed, with the pip command.
    """
    global _choice
    if enabled and not is_installed():
        raise ImportError(MISSING)
    _choice = bool(enabled)


def is_used() -> bool:
    """Return whether the kernel solves the problems that it can."""
    global _choice
    if _choice is None:
        _choice = os.environ.get(VARIABLE) != "0" and is_installed()
    return _choice
