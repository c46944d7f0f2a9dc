"""A large batch in tiles that fit in the cache, and the few problems that need more work gathered.

That is so on a processor. Other platforms compute many problems at a time: there a batch goes in a few wide tiles, and
which of the two it is is decided where a program is lowered.

Arrays are batch-first here. A leaf of leading size 1 is shared by the whole batch and is handed to every
tile as it is. Nothing here rests on ``lax.cond`` under ``vmap``, which would compute both branches.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.typing import ArrayLike

from jaxgrasp.numerics.compiled_code import traces_for_processor
from jaxgrasp.numerics.fused_cpu_kernel import keep_separate
from jaxgrasp.numerics.iterate import varying_like

Tree = TypeVar("Tree")
Out = TypeVar("Out")

FEW = 4
"""A batch of so few is computed whole when any of it is chosen: gathering would cost more."""
NARROW = "cpu"
"""The platform whose cores compute narrow tiles, which stay in their caches. All others compute many problems at a
time, and wait for one tile after the other."""
WIDE = 1 << 15
"""Problems in a tile of other platforms at least, where a batch has so many."""
TRIPS = 8
"""Tiles, one after the other, on other platforms at the most."""
GATHERED_TRIPS = 32
"""The same of problems that were gathered, in narrower tiles since all wait for the slowest of them."""


def spread(batch: tuple[int, ...], array: Array, tail: tuple[int, ...] = ()) -> Array:
    """Broadcast an array to a batch's leading axes, and flatten these into one."""
    return jnp.broadcast_to(array, (*batch, *tail)).reshape(math.prod(batch), *tail)


def shared_or_spread(batch: tuple[int, ...], array: ArrayLike, tail: tuple[int, ...] = ()) -> Array:
    """Spread an array, but keep a leading axis of size 1 where there is one entry, which the batch then shares."""
    array = jnp.asarray(array)
    return array.reshape(1, *tail) if array.size == math.prod(tail) else spread(batch, array, tail)


def over_tiles(
    function: Callable[[Tree], Out],
    arguments: Tree,
    size: int,
    tile: int,
    count: Array | None = None,
) -> Out:
    """Compute ``function`` of ``size`` problems, ``tile`` problems at a time, or more off the processor.

    With a ``count``, tiles behind the first ``count`` problems are not computed, and stay zero.

    The last tile overlaps the one before it instead of being padded: its problems are computed twice,
    to the same bits.
    """
    if size == 0:
        return _empty_answers(function, arguments)
    return _by_platform(partial(_over_tiles, function, arguments, size, count), size, tile, TRIPS)


def _over_tiles(function: Callable[[Tree], Out], arguments: Tree, size: int, count: Array | None, tile: int) -> Out:
    if size <= tile:
        # A program for several platforms holds this and the loop below, which must be of one type.
        return varying_like(function(arguments), arguments)
    shapes = jax.eval_shape(lambda start: function(_slice(arguments, start, size, tile)), jnp.int32(0))
    results = jax.tree.map(lambda s: jnp.zeros((size, *s.shape[1:]), s.dtype), shapes)
    results = varying_like(results, arguments)

    def body(i, results):
        start = jnp.minimum(keep_separate(i) * tile, size - tile)
        return _write(results, function(_slice(arguments, start, size, tile)), start)

    tiles = -(-(size if count is None else jnp.minimum(count, size)) // tile)
    return lax.fori_loop(0, tiles, body, results)


def width(size: int, tile: int, trips: int) -> int:
    """Problems in a tile off the processor, so that there are at most so many tiles whatever the size of the batch."""
    return max(tile, min(size, max(WIDE, -(-size // trips))))


def _by_platform(compute: Callable[[int], Out], size: int, tile: int, trips: int) -> Out:
    """Choose the tile by the platform, where the program is lowered: ``tile`` problems on the processor.

    Both ways are traced, unless it is known to be for the processor.
    """
    wide = width(size, tile, trips)
    if wide == tile or traces_for_processor():
        return compute(tile)
    return lax.platform_dependent(default=partial(compute, wide), **{NARROW: partial(compute, tile)})


def over_chosen(function: Callable[[Tree, Out], Out], arguments: Tree, results: Out, chosen: Array, tile: int) -> Out:
    """``results`` with those of the ``chosen`` problems replaced by ``function(arguments, results)`` of them.

    The chosen ones are gathered, in order, into as many tiles as they need; when none is chosen nothing
    runs. ``function`` may meet problems that were not chosen; what it says of them is dropped. The time is
    that of the chosen problems plus one pass over the batch.
    """
    size = chosen.shape[0]
    if size == 0:
        return results
    if size <= FEW:
        return lax.cond(jnp.any(chosen), lambda r: merged(chosen, function(arguments, r), r), lambda r: r, results)
    count = jnp.sum(chosen, dtype=jnp.int32)

    def replace(results):
        narrow = min(tile, size)
        compute = partial(_replace, function, arguments, results, chosen, count, narrow)
        return _by_platform(compute, size, narrow, GATHERED_TRIPS)

    return lax.cond(count > 0, replace, lambda results: results, results)


def _replace(
    function: Callable[[Tree, Out], Out],
    arguments: Tree,
    results: Out,
    chosen: Array,
    count: Array,
    narrow: int,
    tile: int,
) -> Out:
    """``results`` with those of the ``chosen`` problems, of which there are ``count``, replaced tile by tile.

    On the processor tiles are as ``narrow`` as this.
    """
    size = chosen.shape[0]
    last = jnp.cumsum(chosen, dtype=jnp.int32)
    padded = -(-size // tile) * tile
    order = _searched(last, padded) if tile == narrow else _in_order(chosen, last, padded)

    def body(state):
        i, gathered = keep_separate(state[0]), state[1]
        problems = lax.dynamic_slice_in_dim(order, i * tile, tile)
        answer = function(_take(arguments, problems, size), _take(results, problems, size))
        return i + 1, _write(gathered, answer, i * tile)

    gathered = jax.tree.map(lambda r: jnp.zeros((padded, *r.shape[1:]), r.dtype), results)
    gathered = varying_like(gathered, arguments, results)
    _, gathered = lax.while_loop(lambda state: state[0] * tile < count, body, (jnp.int32(0), gathered))
    position = jnp.maximum(last - 1, 0)
    return merged(chosen, jax.tree.map(lambda g: g[position], gathered), results)


def _searched(last: Array, padded: int) -> Array:
    """Return the chosen problems' indices in order, by searching their running count; cheap on a processor."""
    order = jnp.searchsorted(last, jnp.arange(1, padded + 1, dtype=jnp.int32))
    return jnp.minimum(order, last.shape[0] - 1).astype(jnp.int32)


def _in_order(chosen: Array, last: Array, padded: int) -> Array:
    """Return the chosen problems' indices off the processor, where a search is slow: each writes itself into place."""
    indices = jnp.arange(chosen.shape[0], dtype=jnp.int32)
    position = jnp.where(chosen, last - 1, padded + indices)
    return jnp.zeros(padded, jnp.int32).at[position].set(indices, mode="drop", unique_indices=True)


def _empty_answers(function: Callable[[Tree], Out], arguments: Tree) -> Out:
    """Return the results of a batch without problems."""
    single = jax.tree.map(lambda x: jax.ShapeDtypeStruct((1, *x.shape[1:]) if x.ndim else (), x.dtype), arguments)
    return jax.tree.map(lambda s: jnp.zeros((0, *s.shape[1:]), s.dtype), jax.eval_shape(function, single))


def merged(mask: Array, new: Tree, old: Tree) -> Tree:
    """Take the new leaves of the problems where ``mask`` ``(B,)`` is true, and the old leaves of the others."""
    return jax.tree.map(lambda p, q: jnp.where(beside(mask, q), p, q), new, old)


def _slice(tree: Tree, start: Array, size: int, tile: int) -> Tree:
    return jax.tree.map(lambda x: lax.dynamic_slice_in_dim(x, start, tile) if _is_long(x, size) else x, tree)


def _take(tree: Tree, problems: Array, size: int) -> Tree:
    return jax.tree.map(lambda x: x[problems] if _is_long(x, size) else x, tree)


def _is_long(array: Array, size: int) -> bool:
    """Return whether an array has an entry for each problem, rather than one that all share."""
    return array.ndim > 0 and array.shape[0] == size


def _write(results: Out, part: Out, start: Array) -> Out:
    return jax.tree.map(lambda r, p: lax.dynamic_update_slice_in_dim(r, p, start, 0), results, part)


def beside(per_problem: Array, array: Array) -> Array:
    """Reshape an array ``(*B,)`` to broadcast against an array ``(*B, ...)``."""
    return per_problem.reshape(per_problem.shape + (1,) * (array.ndim - per_problem.ndim))
