"""Problems nobody chose: every claim is judged in extended precision, by code that shares nothing with the solver.

A quick share of all 32 kinds, the rest long, in both precisions: ``JAXGRASP_TEST_ALL=1 pytest -m slow tests/fuzz``.
"""

from typing import NamedTuple

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Solution, Verdict
from tests.fuzz.judged import worth
from tests.fuzz.sampled import KINDS, Sample, sample

COUNT, LONG_COUNT = 32, 2_000


class Allowed(NamedTuple):
    """Tolerances of one precision."""

    residual: float
    """Part of the load that an answer may miss."""
    roundings: float
    """Of the sum of the forces' sizes, granted beside that."""
    outside: float
    gap: float
    proof: float
    """Loads that a proof reaches at least."""


ALLOWED = {
    "float64": Allowed(2e-8, 32, 1e-13, 1e-8, 4e5),
    "float32": Allowed(5e-4, 64, 4e-6, 3e-3, 20.0),
}


@jax.jit
def solve(grasp: Grasp, wrench: np.ndarray, weights: np.ndarray) -> Solution:
    return jaxgrasp.constrained_optimum(grasp, wrench, weights)


def solved(problem: Sample, weights: np.ndarray) -> Solution:
    return jax.device_get(solve(Grasp(*problem[:4]), problem.wrench, weights))


def cast(problem: Sample, dtype: str) -> Sample:
    """Cast the problem to another precision; normals are of unit length as far as that allows."""
    return Sample(*(array.astype(dtype) for array in problem))


def judge(
    kind: str, problem: Sample, weights: np.ndarray, solution: Solution, exerted: np.ndarray | None = None
) -> None:
    """Assert what every verdict claims; of objects that a guide holds, forces are judged by the wrench they exert."""
    allowed = ALLOWED[problem.wrench.dtype.name]
    loaded = problem if exerted is None else problem._replace(wrench=exerted)
    value = worth(loaded, weights, solution.forces, solution.multiplier, solution.certificate)
    if exerted is not None:
        proven = worth(problem, weights, solution.forces, solution.multiplier, solution.certificate).proven
        value = value._replace(proven=proven)
    # Points metres away are themselves known to a rounding of their distance only.
    apart = np.sqrt(np.mean(np.ptp(problem.points, axis=1) ** 2, -1))
    far = 1 + np.linalg.norm(problem.points.mean(1), axis=-1) / np.maximum(apart, 1e-3)
    granted = allowed.roundings * np.finfo(problem.wrench.dtype).eps * far * (value.size + value.load)
    answered = np.isin(solution.verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.FEASIBLE])
    optimal = solution.verdict <= Verdict.OPTIMAL
    infeasible = solution.verdict == Verdict.INFEASIBLE
    broken = {
        "balance": answered & ~(value.residual <= allowed.residual * value.load + granted),
        "cones": answered & ~(value.outside <= allowed.outside * far),
        "optimality": optimal & ~(value.gap <= allowed.gap + 4 * np.finfo(problem.wrench.dtype).eps * value.rounding),
        "proof": infeasible & ~(value.proven >= solution.force_bound / far),
        "reach of a proof": infeasible
        & ~(solution.force_bound >= allowed.proof * np.sqrt(np.sum(problem.wrench[:, :3] ** 2, -1))),
        "numbers": ~np.isfinite(solution.forces).all((1, 2)),
    }
    for law, where in broken.items():
        assert not where.any(), f"{law} in {kind}, {problem.points.shape[1]} contacts: {np.flatnonzero(where)[:10]}"


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_claimed_holds(kind):
    problem = sample(kind, 4, COUNT, seed=0)
    for weights in (problem.squeeze, np.ones_like(problem.squeeze)):
        solution = solved(problem, weights)
        judge(kind, problem, weights, solution)
        assert np.mean(solution.verdict == Verdict.NOT_CONVERGED) <= 1 / COUNT


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("n", [1, 2, 3, 5, 8, 12])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_claimed_holds_for_many(kind, n):
    problem = sample(kind, n, LONG_COUNT, seed=1)
    for weights in (problem.squeeze, np.ones_like(problem.squeeze)):
        solution = solved(problem, weights)
        judge(kind, problem, weights, solution)
        assert np.mean(solution.verdict == Verdict.NOT_CONVERGED) <= 2e-3


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("n", [3, 5, 8])
@pytest.mark.parametrize("kind", KINDS)
def test_single_precision_claims_no_more_than_it_knows(kind, n):
    problem = cast(sample(kind, n, LONG_COUNT, seed=2), "float32")
    solution = solved(problem, problem.squeeze)
    judge(kind, problem, problem.squeeze, solution)
    wide = cast(problem, "float64")
    double = solved(wide, wide.squeeze)
    total = np.sum(double.forces * wide.normals, (1, 2))
    is_contradicted = (solution.verdict == Verdict.INFEASIBLE) & (double.verdict <= Verdict.OPTIMAL)
    assert np.all(solution.force_bound[is_contradicted] <= 1.01 * total[is_contradicted])


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("k", [1, 3, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_claimed_of_guided_objects_holds(kind, k):
    """Along the free twists the forces do the wrench's work: in all else they are judged by the wrench they exert."""
    problem = sample(kind, 4, LONG_COUNT // 4, seed=3)
    linear, angular = np.random.default_rng(4).normal(size=(2, len(problem.points), k, 3))
    middle = problem.points.mean(1)
    radius = np.sqrt(np.mean(np.ptp(problem.points, axis=1) ** 2, -1))[:, None, None]
    angular = angular / np.where(radius > 0, radius, 1)
    free = np.concatenate([linear - np.cross(angular, middle[:, None]), angular], -1).swapaxes(1, 2)
    grasp = Grasp(*problem[:4])
    solution = jax.device_get(jaxgrasp.constrained_optimum(grasp, problem.wrench, problem.squeeze, free=free))
    points, forces = problem.points.astype(np.longdouble), solution.forces.astype(np.longdouble)
    exerted = np.concatenate([forces.sum(1), np.cross(points, forces).sum(1)], -1)
    # Work is measured by the largest velocity that a twist gives a contact.
    fastest = np.linalg.norm(free[:, None, :3] + np.cross(free[:, None, 3:], points[..., None], axis=2), axis=2).max(1)
    residual, load = (
        np.max(np.abs(np.einsum("bik,bi->bk", free, wrench)) / fastest, -1)
        for wrench in (problem.wrench - exerted, problem.wrench)
    )
    answered = np.isin(solution.verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.FEASIBLE])
    size = np.linalg.norm(solution.forces, axis=-1).sum(-1) + np.linalg.norm(problem.wrench[:, :3], axis=-1)
    far = 1 + np.linalg.norm(middle, axis=-1) / np.maximum(radius[:, 0, 0], 1e-3)
    allowed = ALLOWED["float64"]
    granted = allowed.roundings * np.finfo(float).eps * far * size
    assert not (answered & ~(residual <= allowed.residual * load + granted)).any()
    judge(kind, problem, problem.squeeze, solution, exerted.astype(float))
    assert np.mean(solution.verdict == Verdict.NOT_CONVERGED) <= 2e-3


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize(("n", "open_"), [(3, 1e-3), (5, 0.015), (8, 8e-3), (12, 1e-3)])
def test_torques_that_rest_on_next_to_no_friction_are_decided(n, open_):
    """Normals through the middle of a sphere, friction from 1e-8 to 1e-3: most answers are thousands of loads large."""
    rng = np.random.default_rng(6)
    points = rng.normal(size=(LONG_COUNT, n, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    friction, squeeze = 10 ** rng.uniform(-8, -3, points.shape[:2]), rng.uniform(0.5, 5, points.shape[:2])
    wrench = rng.normal(size=(LONG_COUNT, 6)) * [1, 1, 1, 0.3, 0.3, 0.3]
    problem = Sample(points, -points, friction, squeeze, wrench)
    solution = solved(problem, squeeze)
    judge("friction near nothing", problem, squeeze, solution)
    undecided = solution.verdict == Verdict.NOT_CONVERGED
    assert undecided.mean() <= open_
    # Friction of three contacts decides how large the forces must be.
    enough = np.sort(friction, 1)[:, -3] >= 1e-5
    assert undecided[enough].mean() <= 3e-3
