"""Sampled times of the commands that simulate a motion."""

import numpy as np


def sampled_times(seconds: float, step: float) -> np.ndarray:
    """Return times from 0 to ``seconds``, about ``step`` apart [s]; raise ValueError for a step above ``seconds``."""
    if step > seconds:
        raise ValueError(f"step is {step}: expected at most seconds, {seconds}")
    return np.linspace(0, seconds, max(2, round(seconds / step) + 1))
