"""Times of rivals that take turns in one process, so that the machine's moods hit all of them."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

LEAST_REPEATS = 3
PATIENCE = 4


def interleaved(calls: Mapping[Any, Callable[[], Any]], repeats: int, budget: float) -> dict[Any, float]:
    """Median seconds of each call; slow ones stop repeating once they have had ``budget`` seconds.

    They repeat a few times all the same, unless that takes many times as long.
    """
    seconds: dict[Any, list[float]] = {key: [] for key in calls}
    for call in calls.values():
        call()
    for turn in range(repeats):
        for key, call in calls.items():
            if sum(seconds[key]) < (PATIENCE * budget if turn < LEAST_REPEATS else budget):
                start = time.perf_counter()
                call()
                seconds[key].append(time.perf_counter() - start)
    return {key: float(np.median(spent)) for key, spent in seconds.items()}
