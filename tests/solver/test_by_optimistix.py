"""The optimum by solvers from outside: what they claim is judged like our own, and their failures are said."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R

COUNT, N = 64, 3
TOLERANCE = 1e-8
SOLVERS = {
    "newton": optx.Newton(rtol=TOLERANCE, atol=TOLERANCE),
    "bfgs": optx.BFGS(rtol=TOLERANCE, atol=TOLERANCE),
    "dogleg": optx.Dogleg(rtol=TOLERANCE, atol=TOLERANCE),
    "levenberg": optx.LevenbergMarquardt(rtol=TOLERANCE, atol=TOLERANCE),
}
LEAST_SOLVED = {"newton": 0.85, "bfgs": 0.9, "dogleg": 0.9, "levenberg": 0.9}
"""Of ordinary problems with three contacts; 0.92, 0.97, 0.95 and 0.98 were measured."""
QUICK = [*("newton", "bfgs"), *(pytest.param(name, marks=pytest.mark.slow) for name in ("dogleg", "levenberg"))]


def solve(problem: P.Problems, weights: np.ndarray, solver=None):
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    return jax.device_get(jaxgrasp.constrained_optimum(grasp, problem.wrench, weights, solver=solver))


def solved(solution) -> np.ndarray:
    return (solution.verdict == Verdict.OPTIMAL) | (solution.verdict == Verdict.CLOSED_FORM_OPTIMAL)


def mixed(seed: int) -> P.Problems:
    """Return four problems of each stressing kind that needs no solver to make, and ordinary ones to fill the batch."""
    kinds = [kind for kind in P.STRESS_KINDS if kind not in P.LIMIT_KINDS]
    some = [P.problems(kind, N, 4, seed) for kind in kinds]
    some.append(P.problems("ordinary", N, COUNT - 4 * len(some), seed))
    arrays = {name: np.concatenate([getattr(p, name) for p in some]) for name in R.ARRAYS}
    return P.Problems("mixed", **arrays, feasible=None)


@pytest.fixture(scope="module", params=QUICK)
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def ordinary():
    problem = P.problems("ordinary", N, COUNT, seed=1)
    return problem, solve(problem, problem.squeeze)


def test_agrees_with_our_own(name, ordinary):
    problem, ours = ordinary
    theirs = solve(problem, problem.squeeze, SOLVERS[name])
    good = solved(theirs)
    assert good.mean() >= LEAST_SOLVED[name]
    assert (theirs.verdict[~good] == Verdict.NOT_CONVERGED).all()
    closed = ours.verdict == Verdict.CLOSED_FORM_OPTIMAL
    np.testing.assert_array_equal(theirs.verdict == Verdict.CLOSED_FORM_OPTIMAL, closed)
    assert (theirs.steps[closed] == 0).all() and (theirs.steps[~closed] > 0).all()
    scale = np.abs(ours.forces).max((1, 2))
    apart = np.abs(theirs.forces - ours.forces).max((1, 2)) / scale
    assert apart[good].max() <= 100 * TOLERANCE
    assert (np.abs(theirs.objective - ours.objective) <= 10 * TOLERANCE * ours.objective)[good].all()
    assert (theirs.rank == ours.rank).all()


@pytest.mark.parametrize("sharing", ["squeeze", "uniform"])
def test_never_silently_wrong(name, sharing):
    for seed in range(4):
        problem = mixed(seed)
        weights = problem.weights(sharing)
        solution = solve(problem, weights, SOLVERS[name])
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(solution))
        good, hopeless = solved(solution), solution.verdict == Verdict.INFEASIBLE
        judgement = R.judge(problem, weights, solution.forces, solution.multiplier)
        # Rounding of wrench and points moves the optimum of contacts near a line by more than the tolerance.
        assert (judgement.gap <= np.maximum(2 * TOLERANCE, judgement.rounding))[good].all()
        assert judgement.backward_error[good].max() <= 2 * TOLERANCE
        assert judgement.violation[good].max() <= 1e-13
        assert R.proven_need(problem, weights, solution.certificate)[hopeless].min(initial=np.inf) > 1e6
        assert (solution.certificate[good] == 0).all()


def moving_forces(problem: P.Problems, solver):
    """Return the forces' derivative along one direction through ``solver``, the solved problems, and the direction."""
    rng = np.random.default_rng(3)
    tangents = tuple(
        rng.normal(size=x.shape) * np.abs(x).max(-1, keepdims=True) for x in (problem.squeeze, problem.wrench)
    )

    def forces(squeeze, wrench):
        grasp = Grasp(problem.points, problem.normals, problem.friction, squeeze)
        solution = jaxgrasp.constrained_optimum(grasp, wrench, squeeze, solver=solver)
        return solution.forces, solved(solution)

    # Verdicts out of the same program: where a solver only just converges, another one may round otherwise.
    _, slope, good = jax.jit(lambda *at: jax.jvp(forces, at, tangents, has_aux=True))(problem.squeeze, problem.wrench)
    return np.asarray(slope), np.asarray(good), tangents


@pytest.mark.slow
def test_derivatives_are_the_slope_of_our_own_answers(ordinary):
    problem, _ = ordinary
    slope, good, (squeeze, wrench) = moving_forces(problem, SOLVERS["newton"])
    ends = []
    for h in (-1e-6, 1e-6):
        moved = problem._replace(squeeze=problem.squeeze + h * squeeze, wrench=problem.wrench + h * wrench)
        ends.append(solve(moved, moved.squeeze).forces)
    difference = (ends[1] - ends[0]) / 2e-6
    apart = np.abs(slope - difference).max((1, 2)) / np.abs(difference).max((1, 2))
    # A kink within the difference's reach is rare: most problems have none.
    assert (apart[good] < 1e-4).mean() > 0.95
    assert np.isnan(slope[~good]).all()  # no answer, no derivative


@pytest.mark.slow
def test_derivatives_are_our_own(ordinary):
    problem, _ = ordinary
    solver = optx.Newton(rtol=1e-12, atol=1e-12)
    theirs, good, _ = moving_forces(problem, solver)
    assert good.mean() > 0.85
    ours, *_ = moving_forces(problem, None)
    assert (np.abs(theirs - ours).max((1, 2)) <= 1e-8 * np.abs(ours).max((1, 2)))[good].all()


@pytest.mark.slow
def test_mapped_singly_it_is_the_batch(ordinary):
    problem, _ = ordinary
    expected = solve(problem, problem.squeeze, SOLVERS["newton"])

    def solve_single(points, normals, friction, squeeze, wrench):
        grasp = Grasp(points, normals, friction, squeeze)
        return jaxgrasp.constrained_optimum(grasp, wrench, squeeze, solver=SOLVERS["newton"])

    single = jax.device_get(jax.vmap(solve_single)(*(getattr(problem, name) for name in R.ARRAYS)))
    np.testing.assert_array_equal(single.verdict, expected.verdict)
    np.testing.assert_allclose(
        single.forces[solved(expected)], expected.forces[solved(expected)], rtol=1e-12, atol=1e-12
    )


@pytest.mark.slow
def test_one_grasp_serves_many_wrenches_in_tiles():
    """More problems than a tile holds, on one grasp."""
    problem = P.problems("ordinary", 5, 1, seed=4)
    grasp = Grasp(problem.points[0], problem.normals[0], problem.friction[0], problem.squeeze[0])
    wrenches = problem.wrench * np.linspace(0.5, 1.0, 200)[:, None]
    ours = jaxgrasp.constrained_optimum(grasp, wrenches)
    theirs = jaxgrasp.constrained_optimum(grasp, wrenches, solver=SOLVERS["newton"])
    good = solved(theirs)
    assert good.mean() > 0.95
    np.testing.assert_allclose(theirs.forces[good], ours.forces[good], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_looser_solvers_are_judged_at_their_own_tolerance(ordinary):
    problem, ours = ordinary
    solution = solve(problem, problem.squeeze, optx.BFGS(rtol=1e-4, atol=1e-5))
    good = solved(solution)
    assert good.mean() > 0.9
    judgement = R.judge(problem, problem.squeeze, solution.forces, solution.multiplier)
    assert judgement.gap[good].max() <= 2e-4 and judgement.backward_error[good].max() <= 2e-4
    assert judgement.backward_error[solution.verdict == Verdict.OPTIMAL].max() > 1e-9  # it stops early indeed


def test_what_is_no_solver_is_refused(ordinary):
    problem, _ = ordinary
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    for bad in ("newton", optx.Newton, 3, optx.FixedPointIteration(rtol=1e-8, atol=1e-8)):
        with pytest.raises(TypeError, match="expected None, or an optimistix root finder"):
            jaxgrasp.constrained_optimum(grasp, problem.wrench, solver=bad)
    with pytest.raises(TypeError, match="Newton holds arrays"):
        jaxgrasp.constrained_optimum(grasp, problem.wrench, solver=optx.Newton(rtol=jnp.ones(()), atol=1e-8))


def test_optimistix_and_jaxopt_load_only_when_asked_for():
    code = (
        "import sys, jax, jax.numpy as jnp, jaxgrasp\n"
        "grasp = jaxgrasp.Grasp(jnp.eye(3), -jnp.eye(3), jnp.ones(3), jnp.ones(3))\n"
        "jax.eval_shape(jaxgrasp.constrained_optimum, grasp, jnp.ones(6))\n"
        "[getattr(jaxgrasp, name) for name in jaxgrasp.__all__ if name not in ('MujocoGrasp', 'from_mujoco')]\n"
        "assert not {'optimistix', 'jaxopt'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
