"""Force bound of INFEASIBLE: the total normal force up to which no allowed forces exist, in either precision."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Solution, Verdict
from jaxgrasp.testing import problems as P

COUNT = 96
LEAST = {"float64": 4.6e5, "float32": 20.0}
"""In units of the load."""


def near_a_line(n: int, dtype: str) -> tuple[Grasp, np.ndarray]:
    """Return contacts 1e-4 off a line, on which only forces far larger than the load turn the object about it."""
    rng = np.random.default_rng(n)
    along = rng.normal(size=(COUNT, 1, 3))
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    points = 0.05 * (rng.uniform(-1, 1, (COUNT, n, 1)) * along + 1e-4 * rng.normal(size=(COUNT, n, 3)))
    normals = rng.normal(size=(COUNT, n, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    wrench = rng.normal(size=(COUNT, 6)) * (1, 1, 1, 0.02, 0.02, 0.02)
    made = (points, normals, rng.uniform(0.2, 0.8, (COUNT, n)), rng.uniform(0.5, 5, (COUNT, n)))
    return Grasp(*(array.astype(dtype) for array in made)), wrench.astype(dtype)


def wide(grasp: Grasp) -> Grasp:
    return jax.tree.map(lambda array: np.asarray(array, float), grasp)


def solve(grasp: Grasp, wrench: np.ndarray, largest_force=None) -> Solution:
    return jaxgrasp.constrained_optimum(grasp, wrench, largest_force=largest_force)


@pytest.fixture(scope="module")
def both_precisions() -> tuple[Grasp, np.ndarray, Solution, Solution]:
    grasp, wrench = near_a_line(5, "float32")
    single = jax.device_get(solve(grasp, wrench))
    double = jax.device_get(solve(wide(grasp), wrench.astype(float)))
    return grasp, wrench, single, double


@pytest.mark.slow
def test_forces_that_double_precision_finds_lie_beyond_what_single_excludes(both_precisions):
    grasp, _, single, double = both_precisions
    is_missed = (single.verdict == Verdict.INFEASIBLE) & (double.verdict == Verdict.OPTIMAL)
    assert is_missed.sum() > 20
    total = np.sum(double.forces * np.asarray(grasp.normals, float), (-2, -1))
    assert np.all(single.force_bound[is_missed] <= total[is_missed] * 1.001)


@pytest.mark.slow
def test_it_is_the_certificates(both_precisions):
    grasp, wrench, single, double = both_precisions
    for one_grasp, solution in ((grasp, single), (wide(grasp), double)):
        infeasible = solution.verdict == Verdict.INFEASIBLE
        assert infeasible.any()
        exact = wide(one_grasp)
        verified = np.asarray(
            jaxgrasp.verify_certificate(exact, wrench.astype(float), solution.certificate.astype(float))
        )
        # A force does no more work than its normal component times what one of those can do.
        assert np.all(verified[infeasible] >= solution.force_bound[infeasible])
        assert np.all(solution.force_bound[~infeasible] == 0)
        load = np.linalg.norm(wrench[:, :3], axis=-1)
        assert np.all(solution.force_bound[infeasible] >= LEAST[solution.forces.dtype.name] * load[infeasible])


@pytest.mark.slow
def test_what_the_hand_could_exert_leaves_open_what_is_not_excluded(both_precisions):
    grasp, wrench, single, double = both_precisions
    could = 2e4
    limited = jax.device_get(solve(grasp, wrench, could))
    short = (single.verdict == Verdict.INFEASIBLE) & (single.force_bound < could)
    assert 0 < short.sum() < (single.verdict == Verdict.INFEASIBLE).sum()
    np.testing.assert_array_equal(limited.verdict, np.where(short, Verdict.NOT_CONVERGED, single.verdict))
    index = int(np.flatnonzero(short)[0])
    advice = jax.tree.map(lambda array: array[index], limited).advice
    assert f"less than {single.force_bound[index]:.3g} N" in advice and "float64" in advice
    # In double precision the proofs reach further than any hand.
    np.testing.assert_array_equal(jax.device_get(solve(wide(grasp), wrench.astype(float), 2e4)).verdict, double.verdict)


def test_advice_says_how_far_a_proof_reaches(both_precisions):
    double = both_precisions[3]
    index, held = (int(np.flatnonzero(double.verdict == v)[0]) for v in (Verdict.INFEASIBLE, Verdict.OPTIMAL))
    assert f"up to {double.force_bound[index]:.3g} N in all" in double[index].advice
    assert double[index].advice in str(double[index])
    assert double[held].advice == Verdict.OPTIMAL.advice
    with pytest.raises(ValueError, match=r"this is a batch \(96,\)"):
        _ = double.advice


@pytest.mark.parametrize("bad", [-1.0, "much", np.array([1.0, -2.0])])
def test_a_largest_force_that_is_none_is_refused(unchecked, bad):
    problem = P.problems("ordinary", 3, 2, seed=0)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    with pytest.raises(ValueError, match="largest_force is .*: expected a number, 0 or more"):
        jaxgrasp.constrained_optimum(grasp, problem.wrench, largest_force=bad)


def test_a_collinear_grasp_makes_no_wrench_vanish():
    """In single precision a line's own axis is out of reach by rounding; what is asked about it is missed, and said."""
    grasp, wrench = near_a_line(5, "float32")
    line = Grasp(np.float32(1e-4) * grasp.points, grasp.normals, grasp.friction, grasp.squeeze)
    for one_grasp in (grasp, line):
        solution = jax.device_get(solve(one_grasp, wrench))
        solved = solution.verdict <= Verdict.OPTIMAL
        points, forces = np.asarray(one_grasp.points, float), np.asarray(solution.forces, float)
        made = np.concatenate([forces.sum(1), np.cross(points, forces).sum(1)], -1)
        size = np.sqrt(np.mean(np.sum((points - points.mean(1, keepdims=True)) ** 2, -1), 1))
        unit = np.concatenate([np.ones((COUNT, 3)), np.repeat(1 / size[:, None], 3, 1)], 1)
        left, load = np.linalg.norm((made - wrench) * unit, axis=-1), np.linalg.norm(wrench * unit, axis=-1)
        granted = 32 * np.finfo(np.float32).eps * np.linalg.norm(forces, axis=-1).sum(-1)
        assert np.all(left[solved] <= np.maximum(5e-4 * load, granted)[solved])
