"""Off the processor many problems are computed at a time: programs there have few tiles, whatever the batch."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Grasp, closed_form, constrained_optimum
from jaxgrasp.numerics import tiling

SMALL, LARGE = 1_000, 100_000
TILES = -(-LARGE // 128)
"""How many tiles the closed form of so many grasps takes on a processor."""
CONSTANT = re.compile(r"(%\w+) = stablehlo.constant dense<(\d+)> : tensor<i(?:32|64)>")
CONDITION = re.compile(r"cond \{(.*?)\} do \{", re.DOTALL)


def loop_bounds(question, size: int, platform: str) -> list[int]:
    """List every integer in the conditions of loops of the program for another platform."""
    shapes = [jax.ShapeDtypeStruct((size, *tail), jnp.float64) for tail in ((3, 3), (3, 3), (3,), (3,), (6,))]
    compiled = jax.jit(lambda *arrays: question(Grasp(*arrays[:4]), arrays[4]).forces)
    text = jax.export.export(compiled, platforms=[platform])(*shapes).mlir_module()
    bounds = []
    # Names begin anew with each function of the module.
    for part in text.split("func.func"):
        constants = {name: int(value) for name, value in CONSTANT.findall(part)}
        names = (name for body in CONDITION.findall(part) for name in re.findall(r"%\w+", body))
        bounds += [constants[name] for name in names if name in constants]
    return sorted(bounds)


@pytest.mark.parametrize("question", [closed_form, pytest.param(constrained_optimum, marks=pytest.mark.slow)])
def test_loops_off_the_processor_do_not_grow_with_the_batch(question):
    # A call outside of any program is traced for this machine alone; others are to know nothing of it.
    jax.clear_caches()
    none = np.zeros((SMALL, 3, 3))
    question(Grasp(none, none, none[..., 0], none[..., 0]), np.zeros((SMALL, 6)))
    small, large = (loop_bounds(question, size, "cuda") for size in (SMALL, LARGE))
    # A loop over gathered tiles goes on while fewer problems are done than were chosen, a tile at a time. What else
    # loops are bounded by, such as steps of Newton's method, is the same for all batches.
    grown = [bound for bound in large if bound not in small]
    trips = max(tiling.TRIPS, tiling.GATHERED_TRIPS)
    assert all(bound <= trips or bound * trips >= LARGE for bound in grown)
    assert TILES not in large


def test_on_the_processor_tiles_stay_as_narrow_as_they_are():
    assert TILES in loop_bounds(closed_form, LARGE, "cpu")


@pytest.mark.parametrize("size", [1, 127, 1_000, 16_384, 100_000, 3_000_000])
@pytest.mark.parametrize("tile", [16, 128])
@pytest.mark.parametrize("trips", [tiling.TRIPS, tiling.GATHERED_TRIPS])
def test_tiles_are_few_and_hold_all(size, tile, trips):
    wide = tiling.width(size, tile, trips)
    assert wide >= min(tile, size) and -(-size // wide) <= trips


@pytest.mark.parametrize("size", [20, 50])
def test_wide_tiles_find_what_narrow_ones_find(size, monkeypatch):
    """Tiles as wide as on another platform give the same answers when run here."""
    rng = np.random.default_rng(0)
    rows, chosen = jnp.asarray(rng.normal(size=(size, 2))), jnp.asarray(rng.uniform(size=size) < 0.5)
    before = jnp.zeros(size)

    def all_of(rows):
        return jnp.sum(jnp.sin(rows), 1)

    def tile_both(rows, chosen):
        in_tiles = tiling.over_tiles(all_of, rows, size, 4)
        return in_tiles, tiling.over_chosen(lambda e, _: all_of(e), rows, before, chosen, 4)

    narrow = jax.jit(tile_both)(rows, chosen)
    monkeypatch.setattr(tiling, "NARROW", "tpu")
    monkeypatch.setattr(tiling, "WIDE", 8)
    wide = jax.jit(lambda *arrays: tile_both(*arrays))(rows, chosen)
    for narrow_value, wide_value in zip(narrow, wide, strict=True):
        np.testing.assert_allclose(narrow_value, wide_value, rtol=1e-15)
