"""Numbers hundreds of orders of magnitude apart, NaN, infinities and zeros: every claim holds, or none is made.

The quick share has both precisions and all fields; all shapes are long.
"""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Limits, Solution, Verdict
from tests.fuzz.extreme import ANSWERS, ExtremeProblem, extreme_problem, judge

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


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_every_claim_about_extreme_data_holds(dtype):
    for seed in range(4):
        check(seed, SHAPES[0], dtype)


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_claim_about_many_extreme_data_holds(shape, dtype):
    for seed in range(20):
        check(seed, shape, dtype)
