"""Grouping of contact sets of all sizes into blocks of a few shapes, since each shape takes seconds to compile."""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits

WIDTHS = (2, 4, 6, 8, 12, 16, 20, 24, 32, 48, 64)
LARGEST_BLOCK = 1 << 17
"""Problems that are computed at a time: enough to keep every device busy, and few beside what memory holds."""
WORTH_A_SHAPE = 30_000
"""Problems that a shape of its own must serve; below, padding costs less time than compiling."""
LEAST_BLOCK = 128
"""Problems in a block of a device, at least: from here on the solver's tiles have one size, and a problem's answer is
the same to the last bit whatever stands beside it."""


def widths(sizes: np.ndarray, wrenches: int) -> np.ndarray:
    """Compute the padded width of each grasp ``(N,)``: few widths, each for many problems or the largest grasps."""
    if len(sizes) == 0 or np.all(sizes == sizes[0]):
        return sizes.astype(int)
    largest = int(sizes.max())
    steps = [w for w in WIDTHS if w < largest]
    steps += [next((w for w in WIDTHS if w >= largest), largest)]
    step = np.searchsorted(steps, sizes)
    for i in range(len(steps) - 1):
        if np.count_nonzero(step == i) * wrenches < WORTH_A_SHAPE:
            step[step == i] = i + 1
    return np.asarray(steps)[step]


def _in_buckets(sizes: np.ndarray, buckets: tuple[int, ...]) -> np.ndarray:
    """Return the smallest of the ascending ``buckets`` that holds each grasp ``(N,)``; the last must hold them all."""
    return np.asarray(buckets)[np.searchsorted(buckets, sizes)]


class Block(NamedTuple):
    """Padded problems of equal shape."""

    rows: np.ndarray
    """Their grasps' indices."""
    grasp: Grasp
    limits: Limits | None
    wrench: np.ndarray


def blocks(sets: ContactSets, chunk: int, devices: int, buckets: tuple[int, ...] | None = None) -> Iterator[Block]:
    """Yield the problems of ``sets`` in padded blocks, grouped by shape.

    The problems of grasp ``i`` of a block stand together, one for each wrench. In a stream of chunks, a
    block is brought to the size of a full ``chunk``, or an eighth of it where grasps of several widths
    share the chunk, by zeros, on which no solver spends time; so later chunks meet shapes that are
    compiled already. The extra answers come last. What is larger than ``LARGEST_BLOCK`` comes in blocks of that size.
    Where ``buckets`` are given, each grasp is brought to the least of these widths, and each block is of ``chunk``
    grasps: so there is one shape for each of them, whatever comes.
    """
    padded = widths(sets.sizes, sets.wrenches) if buckets is None else _in_buckets(sets.sizes, buckets)
    distinct_widths = np.unique(padded)
    step = chunk if len(distinct_widths) == 1 or buckets else max(1, chunk // 8)
    step = max(-(-step // devices), -(-LEAST_BLOCK // sets.wrenches)) * devices
    largest_size = step if buckets else max(devices, LARGEST_BLOCK // sets.wrenches // devices * devices)
    for width in distinct_widths:
        same_width = np.flatnonzero(padded == width)
        size = largest_size if len(same_width) > largest_size else -(-len(same_width) // step) * step
        for start in range(0, len(same_width), size):
            rows = same_width[start : start + size]
            selected = sets if len(rows) == len(sets) else sets.rows(rows)
            widen = partial(widened, missing=size - len(rows), repeats=sets.wrenches)
            grasp, limits = jax.tree.map(widen, (selected.padded(int(width)), selected.limits(int(width))))
            yield Block(rows, grasp, limits, widened(selected.wrench, size - len(rows)).reshape(-1, 6))


def widened(array: np.ndarray, missing: int, repeats: int = 1) -> np.ndarray:
    """Append ``missing`` zero rows to an array, and repeat each row ``repeats`` times."""
    if missing:
        array = np.concatenate([array, np.zeros((missing, *array.shape[1:]), array.dtype)])
    return np.repeat(array, repeats, 0) if repeats > 1 else array
