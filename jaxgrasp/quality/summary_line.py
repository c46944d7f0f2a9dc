"""Counts and ranges, as results show them in a line when they are printed."""

from collections.abc import Mapping

import numpy as np


def count_of(masks: Mapping[str, np.ndarray]) -> str:
    """Format the count of true entries of each mask with its name, without masks that have none."""
    counts = {name: int(np.sum(mask)) for name, mask in masks.items()}
    return ", ".join(f"{count:,} {name}" for name, count in counts.items() if count) or "none"


def range_of(values: np.ndarray) -> str:
    """Format a single value as it is, and several values as their least, largest and median."""
    values = np.asarray(values, float)
    if not values.size:
        return "of nothing"
    if values.size == 1:
        return f"{float(values.reshape(())):.4g}"
    return f"{values.min():.4g} to {values.max():.4g}, median {np.median(values):.4g}"
