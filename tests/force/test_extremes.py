"""Numbers whose squares overflow or vanish, and precisions that hold few digits: answered rightly or refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from benchmarks.laws import any_of, hold
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P

COUNT, N = 64, 3
POWERS = {"float64": (100, 150, 180, 300), "float32": (12, 17, 19, 30)}


def scaled(what: str, factor: float, dtype: str) -> tuple[P.Problems, np.ndarray]:
    """Return ordinary problems in other units of length or force, or with other weights."""
    problem = P.problems("ordinary", N, COUNT, seed=1)
    weights = problem.squeeze
    if what == "length":
        wrench = problem.wrench * np.repeat([1.0, factor], 3)
        problem = problem._replace(points=problem.points * factor, wrench=wrench)
    if what == "force":
        problem = problem._replace(squeeze=problem.squeeze * factor, wrench=problem.wrench * factor)
    if what == "weight":
        weights = weights * factor
    with np.errstate(over="ignore"):
        return problem.cast(np.dtype(dtype).type), weights.astype(dtype)


def grasp_of(problem: P.Problems) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)


@pytest.mark.parametrize("dtype", POWERS)
@pytest.mark.parametrize("what", ["length", "force", "weight"])
def test_extreme_units_are_solved_or_refused(what, dtype):
    for power in POWERS[dtype]:
        for sign in (1, -1):
            problem, weights = scaled(what, 10.0 ** (sign * power), dtype)
            solution = jax.device_get(jaxgrasp.constrained_optimum(grasp_of(problem), problem.wrench, weights))
            refused = solution.verdict == Verdict.INVALID_DATA
            assert np.isfinite(solution.forces[~refused]).all() and np.isfinite(solution.multiplier[~refused]).all()
            assert (solution.verdict != Verdict.INFEASIBLE).all()
            if not refused.all():
                assert not any_of(hold(problem, weights, solution).broken).any(), (what, sign * power)
                assert (solution.verdict[~refused] <= Verdict.OPTIMAL).mean() > 0.98


@pytest.mark.parametrize(
    "what, factor",
    [("length", 1e-170), ("length", 1e170), ("force", 1e170), ("direction", 1e-170), ("direction", 1e170)],
)
@pytest.mark.slow
def test_a_margin_of_extreme_units_is_refused(what, factor):
    problem, weights = scaled(what, factor, "float64")
    direction = np.random.default_rng(2).normal(size=(COUNT, 6)) * (factor if what == "direction" else 1)
    theta = np.asarray(jaxgrasp.wrench_margin(grasp_of(problem), problem.wrench, direction, weights))
    assert (theta == -np.inf).all()


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [jnp.float16, pytest.param(jnp.bfloat16, marks=pytest.mark.slow)])
def test_half_precision_is_solved_in_single(dtype):
    problem = P.problems("ordinary", N, COUNT, seed=1)
    names = ("points", "normals", "friction", "squeeze", "wrench")
    half = [jnp.asarray(getattr(problem, name), dtype) for name in names]
    solution = jaxgrasp.constrained_optimum(Grasp(*half[:4]), half[4])
    single = [array.astype(jnp.float32) for array in half]
    expected = jaxgrasp.constrained_optimum(Grasp(*single[:4]), single[4])
    assert solution.forces.dtype == jnp.float32
    np.testing.assert_array_equal(solution.forces, expected.forces)


@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.slow)])
@pytest.mark.parametrize("sharing", ["squeeze", pytest.param("uniform", marks=pytest.mark.slow)])
def test_a_weight_that_processors_take_for_zero_is_refused(dtype, sharing):
    """A weight that flushes to zero would fix its contact's force, which is another problem, so it is refused."""
    problem = P.problems("ordinary", N, COUNT, seed=2).cast(np.dtype(dtype).type)
    least = np.finfo(dtype).tiny
    # Beside the other weights, of some newtons, one of the least normal size vanishes too.
    vanishes = sharing == "squeeze"
    for squeeze, refused in ((least / 4, vanishes), (least, vanishes), (1e6 * least, False), (0.0, False)):
        squeezes = problem.squeeze.copy()
        squeezes[: COUNT // 2, 1] = squeeze
        grasp = Grasp(problem.points, problem.normals, problem.friction, squeezes)
        for solve in (jaxgrasp.constrained_optimum, jaxgrasp.closed_form):
            verdict = np.asarray(solve(grasp, problem.wrench, sharing).verdict)
            assert np.all((verdict[: COUNT // 2] == Verdict.INVALID_DATA) == refused)
            assert not np.any(verdict[COUNT // 2 :] == Verdict.INVALID_DATA)
        if squeeze == least / 4:
            with pytest.raises(jaxgrasp.GraspError, match=r"squeeze\[0, 1\] is .*: expected 0, or at least"):
                jaxgrasp.check_grasp(grasp)
        else:
            jaxgrasp.check_grasp(grasp)


@pytest.mark.parametrize("dtype, length, force", [("float64", 1e119, 1e123), ("float32", 1e14, 1e15)])
def test_products_that_overflow_are_refused(dtype, length, force):
    """The data are within range one by one; the torque about the contacts' centre is not."""
    problem, _ = scaled("length", length, "float64")
    wrench = np.zeros_like(problem.wrench)
    wrench[:, 1] = force
    problem = problem._replace(wrench=wrench).cast(np.dtype(dtype).type)
    for solve in (jaxgrasp.constrained_optimum, jaxgrasp.closed_form):
        solution = jax.device_get(solve(grasp_of(problem), problem.wrench))
        assert (solution.verdict == Verdict.INVALID_DATA).all() and np.isfinite(solution.forces).all()


def test_a_spin_radius_hides_no_torque():
    """A spin radius far beyond the spread of the points is the unit of length, but not that of the torques' errors."""
    exponents = np.array([1, 3, 5, 7, 9, 11, 13, 20, 60, 123])
    count = 100
    problem = P.problems("ordinary", N, count, seed=24)
    exponent = np.resize(exponents, count)
    torsion = np.where(np.arange(N) == 1, 10.0 ** exponent[:, None], 0.005) + 0 * problem.friction
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, torsion=torsion)
    solution = jax.device_get(jaxgrasp.constrained_optimum(grasp, problem.wrench))
    torque = np.cross(problem.points, solution.forces).sum(1) + np.sum(solution.moments[..., None] * problem.normals, 1)
    missed = np.linalg.norm(torque - problem.wrench[:, 3:], axis=-1)
    size = np.abs(solution.forces).sum((1, 2)) + np.abs(solution.moments).sum(-1)
    is_answer = np.isin(solution.verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.FEASIBLE])
    assert not np.any((missed > 1e-5 * size) & is_answer)
    assert is_answer[exponent <= 9].mean() >= 0.98
