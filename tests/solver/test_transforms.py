"""Equal answers by leading axes, vmap, nested vmaps and loops, which all take one route."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P

COUNT, N = 64, 3
METHODS = {"closed": jaxgrasp.closed_form, "optimum": jaxgrasp.constrained_optimum}
FIELDS = ("forces", "multiplier", "objective")


@pytest.fixture(scope="module")
def rows():
    """Return ordinary problems, a hopeless one and one with bad data among them."""
    problem = P.problems("ordinary", N, COUNT, seed=21)
    hopeless = P.problems("infeasible", N, 1, seed=22)
    arrays = [getattr(problem, name).copy() for name in ("points", "normals", "friction", "squeeze", "wrench")]
    for array, hopeless_row in zip(arrays, hopeless[1:6], strict=True):
        array[9] = hopeless_row[0]
    arrays[0][17, 2, 1] = np.nan
    return tuple(arrays)


def solve(method: str, points, normals, friction, squeeze, wrench):
    return METHODS[method](Grasp(points, normals, friction, squeeze), wrench, squeeze)


@pytest.fixture(scope="module", params=METHODS)
def flat(request, rows):
    return request.param, jax.device_get(solve(request.param, *rows))


def assert_same(got, expected):
    """Check for equal verdicts, and answers equal to 1e-12 of each problem's own size; NaN nowhere.

    Forces of an INFEASIBLE problem are where the search was when the proof stood: no answer, and no tighter than it.
    A residual that stands at the very threshold may by its last bit ask for one step more, which moves the answer by
    what the threshold leaves open: of so few problems, one at most.
    """
    more = np.asarray(got.steps).ravel() != expected.steps.ravel()
    infeasible = expected.verdict.ravel() == Verdict.INFEASIBLE
    rtol = np.select([infeasible, more], [1e-6, 1e-9], 1e-12)
    assert (more & ~infeasible).sum() <= 1
    np.testing.assert_array_equal(np.asarray(got.verdict).ravel(), expected.verdict.ravel())
    np.testing.assert_array_equal(np.asarray(got.rank).ravel(), expected.rank.ravel())
    for name in FIELDS:
        a = np.asarray(getattr(got, name)).reshape(expected.verdict.size, -1)
        b = getattr(expected, name).reshape(expected.verdict.size, -1)
        assert np.isfinite(a).all()
        assert (np.abs(a - b).max(-1) <= rtol * np.abs(b).max(-1)).all(), name


def test_the_samples_meet_every_outcome(flat):
    method, expected = flat
    assert expected.verdict[17] == Verdict.INVALID_DATA
    others = np.delete(expected.verdict, [9, 17])
    if method == "optimum":
        assert expected.verdict[9] == Verdict.INFEASIBLE
        assert set(others.tolist()) == {Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL}
    else:
        assert set(others.tolist()) == {Verdict.CLOSED_FORM_OPTIMAL, Verdict.OUTSIDE_CONES}


@pytest.mark.parametrize("shape", [(8, 8), pytest.param((4, 1, 16), marks=pytest.mark.slow)])
def test_any_leading_axes(flat, rows, shape):
    method, expected = flat
    got = solve(method, *(x.reshape(*shape, *x.shape[1:]) for x in rows))
    assert got.forces.shape == (*shape, N, 3) and got.multiplier.shape == (*shape, 6)
    for name in ("verdict", "residual", "objective", "steps", "rank"):
        assert getattr(got, name).shape == shape
    assert_same(got, expected)


def test_vmap_of_a_single_call_is_the_batch(flat, rows):
    method, expected = flat
    assert_same(jax.vmap(lambda *x: solve(method, *x))(*rows), expected)


@pytest.mark.slow
def test_vmap_of_vmap_under_jit_is_the_batch(flat, rows):
    method, expected = flat
    nested = jax.jit(jax.vmap(jax.vmap(lambda *x: solve(method, *x))))
    assert_same(nested(*(x.reshape(8, 8, *x.shape[1:]) for x in rows)), expected)


@pytest.mark.slow
def test_loop_over_single_calls_is_the_batch(flat, rows):
    method, expected = flat
    alone = [jax.device_get(solve(method, *(x[i] for x in rows))) for i in range(COUNT)]
    assert alone[0].forces.shape == (N, 3) and alone[0].verdict.shape == ()
    assert_same(jax.tree.map(lambda *leaves: np.stack(leaves), *alone), expected)


@pytest.mark.slow
def test_mapped_axis_may_be_any(flat, rows):
    method, expected = flat
    last = tuple(np.moveaxis(x, 0, -1) for x in rows)
    assert_same(jax.vmap(lambda *x: solve(method, *x), in_axes=-1)(*last), expected)


@pytest.mark.slow
def test_one_grasp_serves_many_wrenches(flat, rows):
    """Broadcast, mapped over wrenches alone, or written out: one answer."""
    method, _ = flat
    grasp, wrenches = tuple(x[0] for x in rows[:4]), rows[4]
    wide = tuple(np.broadcast_to(x, (COUNT, *x.shape)).copy() for x in grasp)
    expected = jax.device_get(solve(method, *wide, wrenches))
    assert_same(solve(method, *grasp, wrenches), expected)
    assert_same(solve(method, *(x[None] for x in grasp), wrenches), expected)
    assert_same(jax.vmap(lambda w: solve(method, *grasp, w))(wrenches), expected)
    assert len(set(expected.verdict.tolist())) > 1


@pytest.mark.slow
def test_many_grasps_share_a_wrench(flat, rows):
    method, _ = flat
    wrench = rows[4][0]
    expected = jax.device_get(solve(method, *rows[:4], np.broadcast_to(wrench, (COUNT, 6)).copy()))
    assert_same(solve(method, *rows[:4], wrench), expected)


@pytest.mark.slow
def test_grasps_cross_wrenches(flat, rows):
    """(8, 1) grasps against (1, 8) wrenches."""
    method, _ = flat
    grasps = tuple(np.delete(x, [9, 17], 0)[:8] for x in rows[:4])
    wrenches = np.delete(rows[4], [9, 17], 0)[:8]
    crossed = solve(method, *(x[:, None] for x in grasps), wrenches[None])
    expected = jax.device_get(solve(method, *(np.repeat(x, 8, 0) for x in grasps), np.tile(wrenches, (8, 1))))
    assert crossed.forces.shape == (8, 8, N, 3)
    assert_same(crossed, expected)


@pytest.mark.slow
@pytest.mark.parametrize("count", [129, 300])
def test_batches_that_do_not_fill_their_tiles(flat, count):
    """Around the tile of 128 problems: the last tile overlaps, the unfinished are gathered."""
    method, _ = flat
    problem = P.problems("ordinary", N, count, seed=23)
    arrays = tuple(getattr(problem, name) for name in ("points", "normals", "friction", "squeeze", "wrench"))
    expected = jax.device_get(solve(method, *arrays))
    for start in (0, count - COUNT):
        part = jax.device_get(solve(method, *(x[start : start + COUNT] for x in arrays)))
        assert_same(jax.tree.map(lambda x, start=start: x[start : start + COUNT], expected), part)


def test_neighbours_of_bad_data_are_untouched(flat, rows):
    method, expected = flat
    poisoned = tuple(x.copy() for x in rows)
    poisoned[0][5] = np.nan
    poisoned[4][33] = np.inf
    poisoned[1][60] = 0.0
    got = jax.device_get(solve(method, *poisoned))
    bad = np.isin(np.arange(COUNT), [5, 33, 60])
    assert (got.verdict[bad] == Verdict.INVALID_DATA).all()
    assert_same(jax.tree.map(lambda x: x[~bad], got), jax.tree.map(lambda x: x[~bad], expected))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(got))


@pytest.mark.slow
def test_a_single_bad_problem_does_not_raise(flat, rows):
    method, _ = flat
    got = solve(method, *(x[17] for x in rows))
    assert int(got.verdict) == Verdict.INVALID_DATA
    assert (np.asarray(got.forces) == 0).all()


@pytest.mark.slow
def test_both_answers_at_once_are_the_two(rows):
    """Values to the last digits, and derivatives."""
    points, normals, friction, squeeze, wrench = rows
    grasp, mix = Grasp(points, normals, friction, squeeze), np.random.default_rng(23).normal(size=points.shape)
    both_solutions = jax.device_get(jaxgrasp.closed_form_and_optimum(grasp, wrench))
    for solution, method in zip(both_solutions, METHODS, strict=True):
        assert_same(solution, jax.device_get(METHODS[method](grasp, wrench)))

    def by_squeeze(k: int, s):
        solved = jaxgrasp.closed_form_and_optimum(Grasp(points, normals, friction, s), wrench)[k]
        return (mix * solved.forces).sum()

    for k, method in enumerate(METHODS.values()):
        alone = jax.grad(lambda s, m=method: (mix * m(Grasp(points, normals, friction, s), wrench).forces).sum())
        np.testing.assert_allclose(jax.grad(by_squeeze, 1)(k, squeeze), alone(squeeze), rtol=1e-9, atol=1e-12)
