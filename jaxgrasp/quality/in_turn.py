"""Long batches, so many grasps at a time, with word of how far they have come."""

from collections.abc import Callable

import numpy as np

from jaxgrasp.model.progress import Progress

TOGETHER = 256
"""Grasps that are looked at before the next: enough that the price of each operation does not count, where one takes
some milliseconds, and few enough that word comes often."""
MANY_TOGETHER = 1024
"""The same where a grasp takes some microseconds."""


def in_turn(
    count: int,
    question: Callable[[np.ndarray], tuple[np.ndarray, ...]],
    progress: Progress | None = None,
    together: int = TOGETHER,
) -> tuple[np.ndarray, ...]:
    """Call ``question`` on chunks of indices ``(g,)``; join its arrays ``(g, ...)`` into arrays ``(count, ...)``."""
    answers = []
    for start in range(0, max(count, 1), together):
        indices = np.arange(start, min(count, start + together))
        answers.append(question(indices))
        if progress is not None:
            progress(len(indices))
    return tuple(np.concatenate(parts) for parts in zip(*answers))
