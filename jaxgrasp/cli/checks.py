"""What the numbers among a command's arguments must be; None is an argument that was not given."""

import math

import numpy as np


def check_positive(arguments: object, *names: str) -> None:
    """Raise ValueError at the first of these that is not a positive number."""
    for name, value in _given(arguments, names):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}: expected a positive number")


def check_finite(arguments: object, *names: str) -> None:
    """Raise ValueError at the first of these that is not a finite number."""
    for name, value in _given(arguments, names):
        if not math.isfinite(value):
            raise ValueError(f"{name} is {value}: expected a finite number")


def check_not_negative(arguments: object, *names: str) -> None:
    """Raise ValueError at the first of these that is not a finite number, 0 or more."""
    for name, value in _given(arguments, names):
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name} is {value}: expected a finite number, 0 or more")


def _given(arguments: object, names: tuple[str, ...]) -> list[tuple[str, float | int]]:
    return [(name, value) for name in names if (value := getattr(arguments, name)) is not None]


def sampled_times(seconds: float, step: float) -> np.ndarray:
    """Times from zero on, a step apart [s]; ValueError where the step is longer than all of it."""
    if step > seconds:
        raise ValueError(f"step is {step}: expected at most seconds, {seconds}")
    return np.linspace(0, seconds, max(2, round(seconds / step) + 1))
