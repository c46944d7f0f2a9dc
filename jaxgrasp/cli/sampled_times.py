"""The instants of commands that go on for a while."""

import numpy as np


def sampled_times(seconds: float, step: float) -> np.ndarray:
    """Times from zero on, a step apart [s]; ValueError where the step is longer than all of it."""
    if step > seconds:
        raise ValueError(f"step is {step}: expected at most seconds, {seconds}")
    return np.linspace(0, seconds, max(2, round(seconds / step) + 1))
