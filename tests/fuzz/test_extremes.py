"""Numbers hundreds of orders of magnitude apart, NaN, infinities and zeros: every claim holds, or none is made.

The quick share has both precisions and all fields; all shapes are long.
"""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Limits, Solution, Verdict
from tests.fuzz.extreme import ANSWERS, ExtremeProblem, Judgement, extreme_problem, judge

COUNT = 1000
SHAPES = [(3, True, True), (5, False, False), (5, True, False), (3, False, True), (1, True, False), (1, False, True)]
"""Number of contacts, whether fingers are soft, and whether normal forces are bounded."""


def solve(problem: ExtremeProblem) -> Solution:
    limits = (
        None if problem.normal_min is None else Limits(normal_min=problem.normal_min, normal_max=problem.normal_max)
    )
    return jax.device_get(jaxgrasp.constrained_optimum(_grasp(problem), problem.wrench, problem.weights, limits=limits))


def _grasp(problem: ExtremeProblem) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze, torsion=problem.torsion)


def check(seed: int, shape: tuple[int, bool, bool], dtype: str) -> None:
    n, is_soft, is_bounded = shape
    problem = extreme_problem(seed, n, COUNT, dtype, is_soft, is_bounded)
    solution = solve(problem)
    judge(problem, solution).check(f"optimum of {shape} in {dtype}, seed {seed}")
    # The laws say nothing where nothing is claimed.
    assert np.isin(solution.verdict, ANSWERS).mean() > 0.2 and (solution.verdict == Verdict.INFEASIBLE).mean() > 0.05
    if not is_bounded:
        closed = jax.device_get(jaxgrasp.closed_form(_grasp(problem), problem.wrench, problem.weights))
        judge(problem, closed).check(f"closed form of {shape} in {dtype}, seed {seed}")


@pytest.mark.parametrize("dtype", [pytest.param("float64", marks=pytest.mark.slow), "float32"])
def test_every_claim_about_extreme_data_holds(dtype):
    for seed in range(4):
        check(seed, SHAPES[0], dtype)


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("shape", SHAPES)
def test_claims_about_many_extreme_data_hold(shape, dtype):
    """Of 20,000 problems, at most three balance is claimed that the laws deny, where forces hide the whole load.

    Their contacts coincide within 1e-200 m beside loads of 1e-140 N, or their weights lie 1e155 apart.
    """
    n, is_soft, is_bounded = shape
    n_unbalanced = 0
    for seed in range(20):
        problem = extreme_problem(seed, n, COUNT, dtype, is_soft, is_bounded)
        solutions = [solve(problem)]
        if not is_bounded:
            closed = jaxgrasp.closed_form(_grasp(problem), problem.wrench, problem.weights)
            solutions.append(jax.device_get(closed))
        broken = [judge(problem, solution).broken for solution in solutions]
        n_unbalanced += int(np.any([laws.pop("balance") for laws in broken], 0).sum())
        for laws in broken:
            Judgement(laws).check(f"{shape} in {dtype}, seed {seed}")
    assert n_unbalanced <= 3
