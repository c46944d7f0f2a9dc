"""Checks of arguments before any work, against their annotations or by name; an error is a sentence that names them.

A public function of the rooms is ``checked``. What its signature says is what is asked of its arguments: kinds, last
axes, names out of a few. What sizes make sense it says itself.

Single values, and several attributes of an object, are checked by their names; None stands for a number that was not
given.
"""

import collections.abc
import inspect
import math
import os
import types
import typing
from collections.abc import Callable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

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


P = ParamSpec("P")
R = TypeVar("R")


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Return the function with its arguments checked against its annotations at every call.

    Raises, when called:
        TypeError: for an argument of another kind.
        ValueError: for other last axes, or a name that is none of those that may be given.
    """
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            passed_arguments = signature.bind(*args, **kwargs).arguments
        except TypeError:
            # Too few, too many or unknown: Python's own message says it best.
            return function(*args, **kwargs)
        hints = hints_of(function)
        for name, value in passed_arguments.items():
            if name in hints:
                check_value(name, value, hints[name])
        return function(*args, **kwargs)

    call.__is_checked__ = True  # type: ignore[attr-defined]
    return call


@cache
def hints_of(function: Callable) -> dict[str, Any]:
    """Return the annotations of a function's named parameters, text evaluated to the types that are installed."""
    inner = inspect.unwrap(function)
    named = {
        name
        for name, parameter in inspect.signature(inner).parameters.items()
        if parameter.kind not in (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    }
    hints = {}
    for name, hint in inspect.get_annotations(inner).items():
        try:
            hints[name] = eval(hint, inner.__globals__) if isinstance(hint, str) else hint
        except NameError:
            # A type of a package that need not be installed: what it is of stays unchecked.
            continue
    return {name: hint for name, hint in hints.items() if name in named}


def check_value(name: str, value: Any, hint: Any) -> None:
    """Raise TypeError or ValueError, with the name of the argument, if the value does not fit the annotation."""
    misfit = _misfit(value, hint)
    if misfit is None:
        return
    error_class, expected = misfit
    if error_class is ValueError and hasattr(value, "shape"):
        raise ValueError(f"{name} has shape {tuple(value.shape)}: expected {expected}")
    dtype = getattr(value, "dtype", None)
    description = describe_value(value) if dtype is None or np.shape(value) == () else f"an array of {dtype}"
    if isinstance(value, str) and error_class is ValueError:
        description = repr(value)
    raise error_class(f"{name} is {description}: expected {expected}")


def _misfit(value: Any, hint: Any) -> tuple[type[Exception], str] | None:
    """Return the class of the error and the expectation as text; None if the value fits the annotation."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return _misfit_of_all(value, typing.get_args(hint))
    if origin is typing.Literal:
        names = typing.get_args(hint)
        fits = any(value is name or (type(value) is type(name) and value == name) for name in names)
        *others, last = map(repr, names)
        return None if fits else (ValueError, f"{', '.join(others)} or {last}" if others else last)
    if hint is Any:
        return None
    if hint is None or hint is type(None):
        return None if value is None else (TypeError, "None")
    if hasattr(hint, "dim_str") or _is_array(hint):
        return _misfit_of_numbers(value, _tail(getattr(hint, "dim_str", "...")))
    if hint in _SCALARS:
        text, is_one = _SCALARS[hint]
        return None if is_one(value) else (TypeError, text)
    return _misfit_of_class(value, origin or hint)


def _misfit_of_all(value: Any, hints: tuple) -> tuple[type[Exception], str] | None:
    misfits = [_misfit(value, hint) for hint in hints]
    failures = [misfit for misfit in misfits if misfit is not None]
    if len(failures) < len(misfits):
        return None
    classes = {error_class for error_class, _ in failures}
    expectations = (
        text
        for error_class, text in failures
        if error_class is ValueError or ValueError not in classes or text == "None"
    )
    texts = dict.fromkeys(expectations)
    return (ValueError if ValueError in classes else TypeError), " or ".join(texts)


def _misfit_of_class(value: Any, class_: Any) -> tuple[type[Exception], str] | None:
    if class_ is collections.abc.Callable:
        return None if callable(value) else (TypeError, "a function")
    if not isinstance(class_, type) or (getattr(class_, "_is_protocol", False) and not _is_runtime(class_)):
        return None
    if isinstance(value, str) and issubclass(str, class_) and class_ is not str:
        # A text is a sequence of texts, and never meant as one.
        return TypeError, "a list, not one text"
    fits = isinstance(value, class_) or (class_ in (list, tuple) and isinstance(value, list | tuple))
    return None if fits else (TypeError, f"a {class_.__name__}")


def _is_runtime(class_: type) -> bool:
    return getattr(class_, "_is_runtime_protocol", False)


def _tail(dimensions: str) -> Tail:
    """Return the last axes that an annotation such as ``"*batch n 3"`` fixes: sizes, or letters for any size."""
    tail: list[int | str] = []
    for dimension in reversed(dimensions.split()):
        if dimension.startswith(("*", "#*", "...")):
            break
        tail.append(int(dimension) if dimension.isdigit() else dimension.lstrip("#"))
    return tuple(reversed(tail))


def _misfit_of_numbers(value: Any, tail: Tail) -> tuple[type[Exception], str] | None:
    expected = numbers_of(tail)
    if isinstance(value, list | tuple):
        try:
            value = np.asarray(value)
        except ValueError:
            return TypeError, expected
    dtype = getattr(value, "dtype", None)
    if dtype is None:
        return None if not tail and _is_number(value) else (TypeError, expected)
    if not (is_real(dtype) or dtype.kind == "b"):
        return TypeError, expected
    return None if ends_in(np.shape(value), tail) else (ValueError, shape_of(tail))


def _is_number(value: Any) -> bool:
    if isinstance(value, bool | np.bool_):
        return False
    if isinstance(value, int | float | np.integer | np.floating):
        return True
    dtype = getattr(value, "dtype", None)
    return dtype is not None and np.shape(value) == () and np.dtype(dtype).kind in "fiu"


def _is_whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) or np.dtype(getattr(value, "dtype", float)).kind in "iu"


_SCALARS: dict[Any, tuple[str, Callable[[Any], bool]]] = {
    float: ("a number", _is_number),
    int: ("a whole number", _is_whole),
    bool: ("True or False", lambda value: isinstance(value, bool | np.bool_)),
    str: ("a text", lambda value: isinstance(value, str)),
    os.PathLike: ("a path", lambda value: isinstance(value, os.PathLike)),
}


def _is_array(hint: Any) -> bool:
    """Check that an annotation stands for arrays of any shape: NumPy's, JAX's (need not be installed), or both."""
    from_jax = getattr(hint, "__module__", "").startswith("jax")
    return (
        hint is np.ndarray
        or hasattr(hint, "stands_for")
        or (from_jax and getattr(hint, "__name__", "").endswith("Array"))
    )
