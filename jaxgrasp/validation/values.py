"""Checks of one argument by its name: an array of real numbers with the right last axes, an object of a class."""

from typing import Any

import numpy as np

Tail = tuple[int | str, ...]
"""Last axes of an array: sizes, or a letter for any size."""
LONGEST = 50
"""Characters of a wrong value that a message shows."""


def check_numbers(name: str, array: Any, tail: Tail = ()) -> None:
    """Raise TypeError for what is no array of real numbers, ValueError for wrong last axes."""
    if isinstance(array, list | tuple | int | float):
        try:
            array = np.asarray(array)
        except ValueError:
            raise TypeError(f"{name} is of unequal lists: expected {numbers_of(tail)}") from None
    dtype = getattr(array, "dtype", None)
    if dtype is None:
        raise TypeError(f"{name} is {shown(array)}: expected {numbers_of(tail)}")
    if not is_real(dtype):
        raise TypeError(f"{name} is an array of {dtype}: expected {numbers_of(tail, 'real ')}")
    shape = np.shape(array)
    if not ends_in(shape, tail):
        raise ValueError(f"{name} has shape {shape}: expected {shape_of(tail)}")


def check_instance(name: str, value: Any, kind: type) -> None:
    """Raise TypeError unless ``value`` is of a type of this package's."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} is {shown(value)}: expected a {kind.__name__}")


def is_real(dtype: Any) -> bool:
    """Whether numbers of a type are real; True and False are none."""
    # The kind of NumPy's own types tells at once; of those that JAX adds, such as bfloat16, only the name does.
    return dtype.kind in "fiu" or (dtype.kind == "V" and "float" in dtype.name)


def ends_in(shape: tuple[int, ...], tail: Tail) -> bool:
    """Whether an array of this shape has these last axes."""
    end = shape[len(shape) - len(tail) :]
    return len(end) == len(tail) and not any(isinstance(size, int) and size != own for size, own in zip(tail, end))


def shape_of(tail: Tail) -> str:
    """Last axes as a message has them."""
    return f"(..., {', '.join(map(str, tail))})"


def numbers_of(tail: Tail, kind: str = "") -> str:
    """What an array of numbers with these last axes is called in a message."""
    shape = f" of shape {shape_of(tail)}" if tail else ""
    return f"{'' if kind else 'an array of '}{kind}numbers{shape}"


def shown(value: Any) -> str:
    """A value and its type, in a few words."""
    if value is None:
        return "None"
    text = " ".join(repr(value).split())
    return f"{text if len(text) <= LONGEST else text[:LONGEST] + ' ...'} of type {type(value).__name__}"
