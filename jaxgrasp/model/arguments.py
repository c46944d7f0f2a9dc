"""What every public function asks of its arguments before any work: grasps that are grasps, arrays of real numbers.

How whoever waits for a long batch is told how far it has come.
"""

import warnings
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxgrasp.model.grasp import OPTIONAL, Grasp
from jaxgrasp.validation.checked import Tail, check_numbers, describe_value

Progress = Callable[[int], object]
"""Is told how many more problems are done, as ``tqdm.update`` is; what it raises ends the work."""


def check_arguments(grasp: Any, required: dict[str, tuple[Any, Tail]], optional: dict[str, tuple[Any, Tail]]) -> None:
    """Check the arguments of a function that users call, by their names; say so where precision will be lost.

    Args:
        grasp: what was given for one.
        required: each array and its last axes.
        optional: those that may be None.

    Raises:
        TypeError: for what is no Grasp, or no array of real numbers.
        ValueError: for wrong last axes.
    """
    check_kind(grasp)
    fields = required | {name: field for name, field in optional.items() if field[0] is not None}
    for name, (array, tail) in fields.items():
        check_numbers(name, array, tail)
    _warn_of_lost_precision(grasp, *(array for array, _ in fields.values()))


def check_kind(grasp: Any) -> None:
    """Raise TypeError unless it is a Grasp whose fields are arrays of real numbers."""
    if not isinstance(grasp, Grasp):
        raise TypeError(f"grasp is {describe_value(grasp)}: expected a jaxgrasp.Grasp")
    for name in Grasp.last_axes:
        array = getattr(grasp, name)
        if array is not None or name not in OPTIONAL:
            check_numbers(name, array)


def check_sign(name: str, values: Any) -> None:
    """Raise ValueError for a concrete number below zero; NaN is let through."""
    if isinstance(values, jax.core.Tracer):
        return
    numbers = np.asarray(values)
    for index in np.argwhere(numbers < 0):
        position = f"[{', '.join(map(str, index))}]" if index.size else ""
        raise ValueError(f"{name}{position} is {numbers[tuple(index)]}: expected zero or more")


def _warn_of_lost_precision(*arguments: Any) -> None:
    """Say so where float64 data will be computed in float32; two calls below the function that the user calls."""
    has_float64 = any(isinstance(a, np.ndarray) and a.dtype == np.float64 for a in jax.tree.leaves(arguments))
    if has_float64 and not jax.config.read("jax_enable_x64"):
        warnings.warn(
            "float64 data are computed in float32, since JAX's 64-bit mode is off: "
            "call jax.config.update('jax_enable_x64', True) first, or pass float32 arrays",
            stacklevel=4,
        )
