"""No claim of the C++ kernel about hard problems is wrong, by a judge in extended precision and by the JAX solver."""

from functools import cache
from types import SimpleNamespace

import pytest

from benchmarks.kernel_calls import arrays_of
from benchmarks.laws import decision_counts
from jaxgrasp.testing.problems import KINDS, LIMIT_KINDS, problems
from jaxgrasp.testing.references import Problems
from tests.force import test_stress

SIZES, COUNT = (3, 5), 1000
# Of the problems whose limit is 1e-4 away, three of 1,000 are left open, by both solvers.
UNDECIDED = {"limit_10001": 0.003}


@cache
def _problem(kind: str, n: int) -> Problems:
    return problems(kind, n, COUNT, seed=0)


@cache
def _reference(kind: str, n: int, sharing: str) -> SimpleNamespace:
    problem = _problem(kind, n)
    return SimpleNamespace(verdict=test_stress.solve(problem, problem.weights(sharing)).verdict)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_no_claim_about_76_000_hard_problems_is_wrong(kernel, kind):
    if kind in LIMIT_KINDS:
        pytest.importorskip("clarabel")
    for n in SIZES:
        for sharing in ("squeeze", "uniform"):
            problem, reference = _problem(kind, n), _reference(kind, n, sharing)
            weights = problem.weights(sharing)
            answers = kernel.solve(**arrays_of(problem), weights=weights)
            fields = {name: answers.answer[name] for name in ("verdict", "multiplier", "certificate")}
            counts = decision_counts(problem, weights, SimpleNamespace(forces=answers.forces, **fields), reference)
            assert counts["wrong"] == counts["contradict"] == 0, (n, sharing, counts)
            assert counts["undecided"] <= UNDECIDED.get(kind, 0) * COUNT, (n, sharing, counts)
            assert counts["verdicts_differ"] <= 0.001 * COUNT, (n, sharing, counts)
