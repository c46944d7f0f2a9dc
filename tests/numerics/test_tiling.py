"""Tiles change nothing: what is computed in parts is what is computed at once, and what is left alone stays."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.numerics import tiling
from jaxgrasp.numerics.compiled_code import traced_for_here
from jaxgrasp.numerics.tiling import over_chosen, over_tiles


def function(arguments):
    rows, shared = arguments
    return {"sum": jnp.sum(jnp.abs(rows), 1) + shared[0], "twice": 2 * rows}


@pytest.mark.parametrize("size", [0, 1, 7, 8, 9, 23, 24])
def test_a_batch_in_tiles_is_the_batch(size):
    rows, shared = jnp.asarray(np.random.default_rng(0).normal(size=(size, 3))), jnp.asarray([2.0])
    expected = function((rows, shared))
    tiles = jax.jit(lambda rows: over_tiles(function, (rows, shared), size, 8))
    for tiled in (over_tiles(function, (rows, shared), size, 8), tiles(rows)):
        for name, array in expected.items():
            np.testing.assert_allclose(tiled[name], array, rtol=1e-15)


@pytest.mark.parametrize("count", [0, 1, 8, 9, 20])
def test_tiles_behind_the_count_are_zeros(count):
    rows = jnp.asarray(np.random.default_rng(0).normal(size=(20, 3)))
    doubled = over_tiles(function, (rows, jnp.asarray([2.0])), 20, 8, jnp.int32(count))["twice"]
    np.testing.assert_array_equal(doubled[:count], 2 * rows[:count])
    # Off the processor one tile holds all of so few.
    tile = 8 if jax.default_backend() == tiling.NARROW else tiling.width(20, 8, tiling.TRIPS)
    behind = 20 if tile >= 20 else -(-count // tile) * tile
    assert not np.any(doubled[behind:])


@pytest.mark.parametrize("size", [1, 3, 4, 5, 16, 50])
@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_the_chosen_are_replaced_and_no_others(size, share):
    rng = np.random.default_rng(size)
    rows, chosen = jnp.asarray(rng.normal(size=(size, 2))), jnp.asarray(rng.uniform(size=size) < share)
    before = {"value": jnp.asarray(rng.normal(size=size)), "steps": jnp.arange(size)}

    def improve(arguments, results):
        return {"value": jnp.sum(arguments, 1) + results["value"], "steps": results["steps"] + 1}

    after = jax.jit(lambda e, r, c: over_chosen(improve, e, r, c, 4))(rows, before, chosen)
    new = improve(rows, before)
    for name in before:
        np.testing.assert_array_equal(after[name], np.where(chosen, new[name], before[name]))


@pytest.mark.skipif(jax.default_backend() != tiling.NARROW, reason="other platforms have one way of tiling")
def test_what_is_for_this_processor_is_traced_once():
    rows, traced = jnp.zeros((20, 2)), []

    def twice(tile):
        traced.append(len(tile))
        return 2 * tile

    def all_of(rows):
        return over_tiles(twice, rows, 20, 8)

    def tiles_traced(function):
        traced.clear()
        jax.jit(function).trace(rows)
        return set(traced)

    assert tiles_traced(traced_for_here(all_of)) == {8}
    # Even of the same function: a user's own program may be lowered for another platform.
    assert tiles_traced(all_of) == {8, 20}
