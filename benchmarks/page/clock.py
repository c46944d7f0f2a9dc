"""Times of rivals that take turns in one process, so that the machine's moods hit all of them."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

LEAST_REPEATS = 3
PATIENCE = 4


def interleaved(
    calls: Mapping[Any, Callable[[], Any]],
    repeats: int,
    budget: float,
    burst: float = 0.0,
    statistic: Callable[[list[float]], Any] = np.median,
) -> dict[Any, float]:
    """Return the median seconds of each call; slow ones stop repeating once they have had ``budget`` seconds.

    They repeat a few times all the same, unless that takes many times as long. A turn is one call, or as many as
    fit into ``burst`` seconds: a short call that follows a stranger's finds every cache and pipeline cold, which
    is not how anybody calls it in a loop. ``statistic`` of the turns takes the place of the median.
    """
    seconds: dict[Any, list[float]] = {key: [] for key in calls}
    for call in calls.values():
        call()
    for turn in range(repeats):
        for key, call in calls.items():
            if sum(seconds[key]) < (PATIENCE * budget if turn < LEAST_REPEATS else budget):
                seconds[key].append(_turn(call, burst))
    return {key: float(statistic(spent)) for key, spent in seconds.items()}


def _turn(call: Callable[[], Any], burst: float) -> float:
    """Return the seconds a call."""
    start, count, spent = time.perf_counter(), 0, 0.0
    while count == 0 or spent < burst:
        call()
        count, spent = count + 1, time.perf_counter() - start
    return spent / count
