"""Checks of single values by their names, and of several attributes of an object.

Checks of several attributes of an object by their names; None stands for a number that was not given.
"""

import math
from typing import Any

import numpy as np

Tail = tuple[int | str, ...]
"""Last axes of an array: sizes, or a letter for any size."""
LONGEST = 50
"""Characters of a wrong value that a message shows."""


def check_numbers(name: str, array: Any, tail: Tail = ()) -> None:
    """Raise TypeError if ``array`` does not hold real numbers, ValueError if its last axes differ from ``tail``."""
    if isinstance(array, list | tuple | int | float):
        try:
            array = np.asarray(array)
        except ValueError:
            raise TypeError(f"{name} is of unequal lists: expected {numbers_of(tail)}") from None
    dtype = getattr(array, "dtype", None)
    if dtype is None:
        raise TypeError(f"{name} is {describe_value(array)}: expected {numbers_of(tail)}")
    if not is_real(dtype):
        raise TypeError(f"{name} is an array of {dtype}: expected {numbers_of(tail, 'real ')}")
    shape = np.shape(array)
    if not ends_in(shape, tail):
        raise ValueError(f"{name} has shape {shape}: expected {shape_of(tail)}")


def check_instance(name: str, value: Any, class_: type) -> None:
    """Raise TypeError unless ``value`` is an instance of ``class_``."""
    if not isinstance(value, class_):
        raise TypeError(f"{name} is {describe_value(value)}: expected a {class_.__name__}")


def is_real(dtype: Any) -> bool:
    """Check that a dtype holds real numbers: integers or floats, bfloat16 included, but not booleans."""
    # The kind of NumPy's own types tells at once; of those that JAX adds, such as bfloat16, only the name does.
    return dtype.kind in "fiu" or (dtype.kind == "V" and "float" in dtype.name)


def ends_in(shape: tuple[int, ...], tail: Tail) -> bool:
    """Check that a shape ends in the last axes ``tail``; a letter matches any size."""
    end = shape[len(shape) - len(tail) :]
    return len(end) == len(tail) and not any(
        isinstance(size, int) and size != actual for size, actual in zip(tail, end)
    )


def shape_of(tail: Tail) -> str:
    """Format last axes for a message, such as ``(..., n, 3)``."""
    return f"(..., {', '.join(map(str, tail))})"


def numbers_of(tail: Tail, adjective: str = "") -> str:
    """Describe an array of numbers with these last axes, for a message."""
    shape = f" of shape {shape_of(tail)}" if tail else ""
    return f"{'' if adjective else 'an array of '}{adjective}numbers{shape}"


def describe_value(value: Any) -> str:
    """Format a value, cut after 50 characters, and its type for a message."""
    if value is None:
        return "None"
    text = " ".join(repr(value).split())
    return f"{text if len(text) <= LONGEST else text[:LONGEST] + ' ...'} of type {type(value).__name__}"


def check_positive(arguments: object, *names: str) -> None:
    """Raise ValueError at the first of these that is not a positive number."""
    for name, value in _set_values(arguments, names):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}: expected a positive number")


def check_finite(arguments: object, *names: str) -> None:
    """Raise ValueError at the first of these that is not a finite number."""
    for name, value in _set_values(arguments, names):
        if not math.isfinite(value):
            raise ValueError(f"{name} is {value}: expected a finite number")


def check_not_negative(arguments: object, *names: str) -> None:
    """Raise ValueError at the first of these that is not a finite number, 0 or more."""
    for name, value in _set_values(arguments, names):
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name} is {value}: expected a finite number, 0 or more")


def check_vectors(arguments: object, *names: str) -> None:
    """Raise ValueError at the first of these that is given and not three finite numbers."""
    for name in names:
        value = getattr(arguments, name)
        if value is not None and (len(value) != 3 or not all(map(math.isfinite, value))):
            raise ValueError(f"{name} is {list(value)}: expected three finite numbers")


def check_directions(arguments: object, *names: str) -> None:
    """Raise ValueError at the first of these that is not three finite numbers, or all zeros."""
    check_vectors(arguments, *names)
    for name in names:
        if not any(value := getattr(arguments, name)):
            raise ValueError(f"{name} is {list(value)}: expected a direction, not all zeros")


def _set_values(arguments: object, names: tuple[str, ...]) -> list[tuple[str, float | int]]:
    return [(name, value) for name in names if (value := getattr(arguments, name)) is not None]
