"""Counts and ranges, as results show them in a line when they are printed."""

from collections.abc import Mapping

import numpy as np


def count_of(which: Mapping[str, np.ndarray]) -> str:
    """How many there are of each, those that there are."""
    counts = {name: int(np.sum(mask)) for name, mask in which.items()}
    return ", ".join(f"{count:,} {name}" for name, count in counts.items() if count) or "none"


def range_of(values: np.ndarray) -> str:
    """The value of one; of several the least, the median and the largest."""
    values = np.asarray(values, float)
    if not values.size:
        return "of nothing"
    if values.size == 1:
        return f"{float(values.reshape(())):.4g}"
    return f"{values.min():.4g} to {values.max():.4g}, median {np.median(values):.4g}"
