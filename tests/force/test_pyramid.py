"""Optima over friction pyramids: allowed by the cones, dearer, better with more sides, and what Clarabel finds."""

import jax
import numpy as np
import pytest

from jaxgrasp import Grasp, Verdict, pyramid_optimum
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT, N = 64, 3
TOL = 1e-6
GAP = 100 * TOL
"""Between objectives, relative to the larger of the optimum's and that of no force: as documented."""
HELD, BARE, SLIPPERY, HOPELESS, BROKEN, NOBODY = (slice(40, 44), slice(44, 48), slice(48, 52), slice(52, 56), 56, 57)


class Batch:
    """Ordinary problems, and few of each kind that could go wrong, as one batch with weights and padding."""

    def __init__(self):
        problem = P.problems("ordinary", N, COUNT, seed=1)
        arrays = {name: getattr(problem, name).copy() for name in R.ARRAYS}
        self.weights, self.present = problem.squeeze.copy(), np.ones((COUNT, N))
        slippery, hopeless = P.problems("zero_friction", N, 4, seed=2), P.problems("infeasible", N, 4, seed=3)
        for name, array in arrays.items():
            array[SLIPPERY], array[HOPELESS] = getattr(slippery, name), getattr(hopeless, name)
        self.weights[SLIPPERY], self.weights[HOPELESS] = slippery.squeeze, hopeless.squeeze
        self.weights[HELD, 0] = 0
        self.present[BARE, 1] = 0
        self.present[NOBODY] = 0
        forces = P.allowed_forces(np.random.default_rng(4), P.Contacts(*list(arrays.values())[:4]), arrays["squeeze"])
        forces[HELD, 0] = arrays["squeeze"][HELD, :1] * arrays["normals"][HELD, 0]
        wrench = P.exact_wrench(arrays["points"], forces * self.present[..., None])
        for some in (HELD, BARE):
            arrays["wrench"][some] = wrench[some]
        arrays["points"][BARE, 1] = np.nan
        arrays["wrench"][BROKEN, 2] = np.inf
        self.problem = P.Problems("batch", **arrays, feasible=None)

    def solve(self, **settings):
        p = self.problem
        grasp = Grasp(p.points, p.normals, p.friction, p.squeeze, self.present)
        return jax.device_get(pyramid_optimum(grasp, p.wrench, self.weights, **settings))

    def judge(self, solution) -> R.Judgement:
        """Judge the solution, with absent contacts and the broken wrench set to zero."""
        is_present = self.present > 0
        clean = {
            name: np.where(is_present[..., None], getattr(self.problem, name), 0) for name in ("points", "normals")
        }
        squeeze, weights = (np.where(is_present, x, 0) for x in (self.problem.squeeze, self.weights))
        wrench = np.where(np.isfinite(self.problem.wrench), self.problem.wrench, 0)
        problem = self.problem._replace(**clean, squeeze=squeeze, wrench=wrench)
        return R.judge(problem, weights, solution.forces, solution.multiplier)

    def scale(self, objective: np.ndarray) -> np.ndarray:
        """Return the larger of the objective and the cost of no force at all."""
        is_movable = self.present * (self.weights > 0)
        squeeze_cost = np.sum(
            np.where(is_movable, self.problem.squeeze**2 / np.where(is_movable, 2 * self.weights, 1), 0), -1
        )
        return np.maximum(objective, squeeze_cost)


@pytest.fixture(scope="module")
def batch() -> Batch:
    return Batch()


@pytest.fixture(scope="module")
def by_sides(batch):
    return {sides: batch.solve(sides=sides) for sides in (4, 8, 16)}


def edges_of(normals: np.ndarray, friction: np.ndarray, sides: int) -> np.ndarray:
    """Return the edges ``(n, sides, 3)`` of each pyramid, where the documentation has them."""
    farthest = np.eye(3)[np.argmin(np.abs(normals), -1)]
    first = P.unit(np.cross(normals, farthest))
    second = np.cross(normals, first)
    angle = (2 * np.pi * np.arange(sides) / sides)[:, None]
    around = np.cos(angle) * first[:, None] + np.sin(angle) * second[:, None]
    return normals[:, None] + friction[:, None, None] * around


def clarabel_pyramid(
    batch: Batch, i: int, sides: int, wrench: np.ndarray | None = None
) -> tuple[np.ndarray, float] | None:
    """Solve for forces that are sums of nonnegative multiples of the edges, without any facet, by Clarabel.

    The wrench is the problem's own unless ``wrench`` is given. Return forces and objective, None without an answer.
    """
    import clarabel
    from scipy import sparse

    p, k = batch.problem, batch.weights[i]
    indices = np.flatnonzero(batch.present[i])
    held = k[indices] == 0
    normals, n = p.normals[i, indices], len(indices)
    squeezing = p.squeeze[i, indices, None] * normals
    middle = p.points[i, indices].mean(0)
    arms = (p.points[i, indices] - middle) / 0.05
    load_wrench = p.wrench[i] if wrench is None else wrench
    load = np.concatenate([load_wrench[:3], (load_wrench[3:] - np.cross(middle, load_wrench[:3])) / 0.05])
    grasp = np.concatenate([np.concatenate([np.eye(3), np.cross(np.eye(3), r).T * -1]) for r in arms], 1)
    edges = edges_of(normals, p.friction[i, indices], sides)
    spread = np.zeros((3 * n, n * sides))
    for c in range(n):
        spread[3 * c : 3 * c + 3, c * sides : (c + 1) * sides] = 0 if held[c] else edges[c].T
    fixed = np.where(held[:, None], squeezing, 0).ravel()
    cost = np.repeat(np.where(held, 0, 1 / np.where(held, 1, k[indices])), 3)
    size, many = 3 * n + n * sides, n * sides
    quadratic = sparse.csc_matrix((cost, (range(3 * n), range(3 * n))), shape=(size, size))
    rows = np.zeros((6 + 3 * n + many, size))
    rows[:6, : 3 * n] = grasp
    rows[6 : 6 + 3 * n] = np.concatenate([np.eye(3 * n), -spread], 1)
    rows[6 + 3 * n :, 3 * n :] = -np.eye(many)
    right = np.concatenate([load, fixed, np.zeros(many)])
    kinds = [clarabel.ZeroConeT(6 + 3 * n), clarabel.NonnegativeConeT(many)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    linear = np.concatenate([-cost * squeezing.ravel(), np.zeros(many)])
    answer = clarabel.DefaultSolver(quadratic, linear, sparse.csc_matrix(rows), right, kinds, settings).solve()
    if str(answer.status) != "Solved":
        return None
    forces = np.zeros((N, 3))
    forces[indices] = np.asarray(answer.x)[: 3 * n].reshape(n, 3)
    return forces, float(np.sum(cost * (forces[indices].ravel() - squeezing.ravel()) ** 2) / 2)


@pytest.mark.slow
def test_most_are_solved_and_the_rest_is_said(by_sides):
    for sides, solution in by_sides.items():
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(solution))
        verdict = solution.verdict
        assert verdict[BROKEN] == Verdict.INVALID_DATA and verdict[NOBODY] == Verdict.NO_CONTACTS
        # No pyramid inside the cones can do what the cones cannot; and nothing is proven here.
        assert (verdict[HOPELESS] == Verdict.NOT_CONVERGED).all() and (solution.steps[HOPELESS] == 4000).all()
        others = np.delete(verdict, [*range(52, 56), BROKEN, NOBODY])
        assert set(others.tolist()) <= {Verdict.OPTIMAL, Verdict.NOT_CONVERGED}
        assert (others == Verdict.OPTIMAL).mean() > (0.8 if sides == 4 else 0.9)


@pytest.mark.slow
def test_forces_are_allowed_and_balance(batch, by_sides):
    for solution in by_sides.values():
        good = solution.verdict == Verdict.OPTIMAL
        judgement = batch.judge(solution)
        assert judgement.violation.max() <= 1e-13  # whatever the verdict
        assert judgement.backward_error[good].max() <= 10 * TOL
        np.testing.assert_allclose(
            solution.objective[good], judgement.primal[good].astype(float), rtol=1e-9, atol=1e-12
        )


@pytest.mark.slow
def test_agrees_with_clarabel(batch, by_sides):
    for sides, solution in by_sides.items():
        gaps = []
        scale = batch.scale(solution.objective)
        for i in np.flatnonzero(solution.verdict == Verdict.OPTIMAL):
            reference = clarabel_pyramid(batch, i, sides)
            if reference is None:
                continue
            forces, objective = reference
            gaps.append(abs(solution.objective[i] - objective) / scale[i])
            assert gaps[-1] <= GAP, (sides, i)
            # Strong convexity turns a gap into a distance of forces.
            largest = max(np.abs(forces).max(), batch.problem.squeeze[i].max())
            assert np.abs(solution.forces[i] - forces).max() <= 3 * GAP**0.5 * largest, (sides, i)
        assert len(gaps) > 0.8 * COUNT and np.median(gaps) <= TOL


@pytest.mark.slow
def test_dearer_than_the_cones_and_better_with_more_sides(batch, by_sides):
    """Pyramids of 4, 8 and 16 sides contain one another, and the cones contain them all."""
    good = np.all([solution.verdict == Verdict.OPTIMAL for solution in by_sides.values()], 0)
    four, eight, sixteen = (by_sides[sides].objective for sides in (4, 8, 16))
    scale = batch.scale(four)
    assert (eight <= four + GAP * scale)[good].all() and (sixteen <= eight + GAP * scale)[good].all()
    cones = np.full(COUNT, np.nan)
    plain = good & (np.arange(COUNT) < 40)
    for i in np.flatnonzero(plain):
        forces, _, status = R.clarabel_optimum(batch.problem, batch.weights, i)
        if status == "Solved":
            apart = np.sum((forces - batch.problem.squeeze[i, :, None] * batch.problem.normals[i]) ** 2, -1)
            cones[i] = np.sum(apart / (2 * batch.weights[i]))
    is_finite = np.isfinite(cones)
    assert is_finite[plain].mean() > 0.8
    price = [(x - cones)[is_finite] / scale[is_finite] for x in (four, eight, sixteen)]
    assert min(p.min() for p in price) >= -GAP
    # The price of the flat facets falls about fourfold as sides are doubled.
    assert price[0].mean() > 2 * price[1].mean() > 4 * price[2].mean() > 0


def test_both_solvers_agree(batch, by_sides):
    by_box_osqp, by_default = batch.solve(sides=8, solver="box_osqp"), by_sides[8]
    is_solved_by_both = (by_default.verdict == Verdict.OPTIMAL) & (by_box_osqp.verdict == Verdict.OPTIMAL)
    assert is_solved_by_both.mean() > 0.8
    np.testing.assert_array_equal(by_default.verdict[HOPELESS], by_box_osqp.verdict[HOPELESS])
    scale = batch.scale(by_default.objective)
    assert (np.abs(by_default.objective - by_box_osqp.objective) <= GAP * scale)[is_solved_by_both].all()
    apart = np.abs(by_default.multiplier - by_box_osqp.multiplier).max(-1)[is_solved_by_both]
    assert np.median(apart / np.abs(by_default.multiplier).max(-1)[is_solved_by_both]) < 1e-3


def test_multiplier_is_the_price_of_the_wrench(batch, by_sides):
    """The optimum's slope by the wrench, as Clarabel's optima have it; a few have a kink within reach."""
    solution, rng = by_sides[8], np.random.default_rng(5)
    apart = []
    for i in np.flatnonzero(solution.verdict[:40] == Verdict.OPTIMAL):
        step = 1e-4 * rng.normal(size=6) * np.abs(batch.problem.wrench[i])
        ends = [clarabel_pyramid(batch, i, 8, batch.problem.wrench[i] + sign * step) for sign in (-1, 1)]
        if None not in ends:
            slope = (ends[1][1] - ends[0][1]) / 2
            apart.append(abs(slope - solution.multiplier[i] @ step) / np.sum(np.abs(solution.multiplier[i] * step)))
    assert len(apart) > 30
    assert np.median(apart) < 1e-3 and np.mean(np.array(apart) < 1e-2) > 0.9


def test_held_contacts_keep_their_squeezing_force(batch, by_sides):
    expected = batch.problem.squeeze[HELD, :1, None] * batch.problem.normals[HELD, :1]
    for solution in by_sides.values():
        np.testing.assert_allclose(solution.forces[HELD, :1], expected, rtol=1e-13, atol=1e-13)
        assert (solution.forces[BARE, 1] == 0).all() and (solution.forces[NOBODY] == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("x64", [True, False])
def test_single_precision(batch, by_sides, x64):
    """At a tolerance it can meet; and asked for too much it does not pretend."""
    p = batch.problem.cast(np.float32)
    present, weights = batch.present.astype(np.float32), batch.weights.astype(np.float32)
    with jax.enable_x64(x64):
        grasp = Grasp(p.points, p.normals, p.friction, p.squeeze, present)
        solution = jax.device_get(pyramid_optimum(grasp, p.wrench, weights, tol=1e-4))
        strict = jax.device_get(pyramid_optimum(grasp, p.wrench, weights, tol=1e-8))
    assert solution.forces.dtype == np.float32
    is_solved_by_both = (solution.verdict == Verdict.OPTIMAL) & (by_sides[8].verdict == Verdict.OPTIMAL)
    assert is_solved_by_both.mean() > 0.8
    scale = batch.scale(by_sides[8].objective)
    assert (np.abs(solution.objective - by_sides[8].objective) <= 1e-2 * scale)[is_solved_by_both].all()
    claimed = strict.verdict == Verdict.OPTIMAL
    assert (np.abs(strict.objective - by_sides[8].objective) <= 1e-4 * scale)[claimed & is_solved_by_both].all()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((solution, strict)))


@pytest.mark.slow
def test_leading_axes_and_vmap(batch, by_sides):
    p = batch.problem
    arrays = (p.points, p.normals, p.friction, p.squeeze, batch.present, p.wrench, batch.weights)

    def solve(points, normals, friction, squeeze, present, wrench, weights):
        return pyramid_optimum(Grasp(points, normals, friction, squeeze, present), wrench, weights)

    folded = solve(*(x.reshape(8, 8, *x.shape[1:]) for x in arrays))
    mapped = jax.vmap(solve)(*arrays)
    good = by_sides[8].verdict == Verdict.OPTIMAL
    for other_forces in (folded.forces.reshape(COUNT, N, 3), mapped.forces):
        np.testing.assert_allclose(other_forces[good], by_sides[8].forces[good], rtol=0, atol=1e-4)


def test_an_empty_batch_has_an_empty_answer(batch):
    p = batch.problem
    grasp = Grasp(p.points[:0], p.normals[:0], p.friction[:0], p.squeeze[:0])
    assert pyramid_optimum(grasp, p.wrench[:0]).forces.shape == (0, N, 3)


def test_it_has_no_derivatives(batch):
    p = batch.problem
    grasp = Grasp(p.points[0], p.normals[0], p.friction[0], p.squeeze[0])
    with pytest.raises(NotImplementedError, match="differentiate constrained_optimum"):
        jax.grad(lambda w: pyramid_optimum(grasp, w).objective)(p.wrench[0])


@pytest.mark.parametrize(
    "bad, message",
    [({"sides": 2}, "sides is 2"), ({"solver": "qp"}, "solver is 'qp'"), ({"tol": 0.0}, "tol is 0.0")]
    + [({"tol": float("nan")}, "tol is nan"), ({"max_steps": 0}, "max_steps is 0"), ({"sharing": "even"}, "sharing")],
)
def test_bad_arguments_raise(batch, bad, message, unchecked):
    p = batch.problem
    with pytest.raises(ValueError, match=message):
        pyramid_optimum(Grasp(p.points, p.normals, p.friction, p.squeeze), p.wrench, **bad)
