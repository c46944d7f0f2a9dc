"""Checks of several attributes of an object by their names; None stands for a number that was not given."""

import math


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
