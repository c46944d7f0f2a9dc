"""What every public function asks of its arguments before any work: grasps that are grasps, arrays of real numbers."""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.grasp import Grasp

Tail = tuple[int | str, ...]
"""Last axes of an array: sizes, or a letter for any size."""
FIELDS: dict[str, Tail] = {"points": ("n", 3), "normals": ("n", 3), "friction": ("n",), "squeeze": ("n",)}
LONGEST = 50
"""Characters of a wrong value that a message shows."""
OPTIONAL_FIELDS: dict[str, Tail] = {"present": ("n",), "torsion": ("n",)}


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
    given = {name: one for name, one in optional.items() if one[0] is not None}
    for name, (array, tail) in (required | given).items():
        check_numbers(name, array, tail)
    _warn_of_lost_precision(grasp, *(array for array, _ in (required | given).values()))


def check_kind(grasp: Any) -> None:
    """Raise TypeError unless it is a Grasp whose fields are arrays of real numbers."""
    if not isinstance(grasp, Grasp):
        raise TypeError(f"grasp is {_shown(grasp)}: expected a jaxgrasp.Grasp")
    for name in FIELDS:
        check_numbers(name, getattr(grasp, name))
    for name in OPTIONAL_FIELDS:
        if getattr(grasp, name) is not None:
            check_numbers(name, getattr(grasp, name))


def check_numbers(name: str, array: Any, tail: Tail | None = None) -> None:
    """Raise TypeError for what is no array of real numbers, ValueError for wrong last axes."""
    wanted = f"numbers of shape (..., {', '.join(map(str, tail))})" if tail else "numbers"
    dtype = getattr(array, "dtype", None)
    if dtype is None and isinstance(array, list | tuple | int | float):
        try:
            array = np.asarray(array)
            dtype = array.dtype
        except ValueError:
            raise TypeError(f"{name} is of unequal lists: expected an array of {wanted}") from None
    if dtype is None:
        raise TypeError(f"{name} is {_shown(array)}: expected an array of {wanted}")
    if not (jnp.issubdtype(dtype, jnp.floating) or jnp.issubdtype(dtype, jnp.integer)):
        raise TypeError(f"{name} is an array of {dtype}: expected real {wanted}")
    shape = np.shape(array)
    if tail is None:
        return
    end = shape[len(shape) - len(tail) :] if len(shape) >= len(tail) else None
    if end is None or any(isinstance(size, int) and size != own for size, own in zip(tail, end)):
        raise ValueError(f"{name} has shape {shape}: expected (..., {', '.join(map(str, tail))})")


def check_sign(name: str, values: Any, above: bool = False) -> None:
    """Raise ValueError for a concrete number below zero, or at zero where it must be ``above``; NaN is let through."""
    if isinstance(values, jax.core.Tracer):
        return
    bad = np.asarray(values) <= 0 if above else np.asarray(values) < 0
    for index in np.argwhere(bad):
        place = f"[{', '.join(map(str, index))}]" if index.size else ""
        wanted = "a number above zero" if above else "zero or more"
        raise ValueError(f"{name}{place} is {np.asarray(values)[tuple(index)]}: expected {wanted}")


def check_instance(name: str, value: Any, kind: type) -> None:
    """Raise TypeError unless ``value`` is of a type of this package's."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} is {_shown(value)}: expected a {kind.__name__}")


def _shown(value: Any) -> str:
    if value is None:
        return "None"
    text = repr(value)
    return f"{text if len(text) <= LONGEST else text[:LONGEST] + ' ...'} of type {type(value).__name__}"


def _warn_of_lost_precision(*arguments: Any) -> None:
    """Say so where float64 data will be computed in float32; two calls below the function that the user calls."""
    given = any(isinstance(a, np.ndarray) and a.dtype == np.float64 for a in jax.tree.leaves(arguments))
    if given and not jax.config.read("jax_enable_x64"):
        warnings.warn(
            "float64 data are computed in float32, since JAX's 64-bit mode is off: "
            "call jax.config.update('jax_enable_x64', True) first, or pass float32 arrays",
            stacklevel=4,
        )
