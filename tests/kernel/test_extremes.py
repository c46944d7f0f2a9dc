"""The laws of ``tests/fuzz`` for extreme data, held against the C++ kernel; and that it never contradicts JAX there."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxgrasp import Verdict
from tests.fuzz.extreme import ANSWERS, ExtremeProblem, extreme_problem, judge
from tests.fuzz.test_extremes import COUNT, SHAPES, solve


def solve_by_kernel(kernel, problem: ExtremeProblem) -> SimpleNamespace:
    """Return the kernel's answers by the names of a Solution."""
    answers = kernel.solve(**{name: array for name, array in problem._asdict().items() if array is not None})
    fields = {name: answers.answer[name] for name in ("multiplier", "certificate", "force_bound")}
    return SimpleNamespace(forces=answers.forces, moments=answers.moments, verdict=answers.verdict, **fields)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_claim_about_extreme_data_holds(kernel, shape):
    for seed in range(4):
        n, is_soft, is_bounded = shape
        problem = extreme_problem(seed, n, COUNT, "float64", is_soft, is_bounded)
        judge(problem, solve_by_kernel(kernel, problem)).check(f"{shape}, seed {seed}")


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_verdicts_about_extreme_data_never_contradict_those_of_jax(kernel, shape):
    n, is_soft, is_bounded = shape
    for seed in range(5):
        problem = extreme_problem(seed, n, COUNT, "float64", is_soft, is_bounded)
        reference, verdict = solve(problem).verdict, solve_by_kernel(kernel, problem).verdict
        # XLA takes subnormal numbers for zero in most places, and the kernel does not.
        assert np.mean((reference == Verdict.INVALID_DATA) != (verdict == Verdict.INVALID_DATA)) <= 0.005
        for answer, proof in ((reference, verdict), (verdict, reference)):
            assert not np.any(np.isin(answer, ANSWERS) & (proof == Verdict.INFEASIBLE))
        assert np.mean(reference != verdict) <= 0.05
