"""Criteria for right answers and proofs, by the judgement of ``references`` alone.

Shared by the stress tests and the page, so that both mean the same by *wrong*.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxgrasp import Verdict
from jaxgrasp.testing import references as R
from jaxgrasp.testing.references import Problems


class Laws(NamedTuple):
    """Limits of the errors of answers and proofs in one precision."""

    gap: float
    balance: float
    """Largest backward error."""
    violation: float
    need: float
    """Least total normal force, in loads, that a certificate proves to be needed."""
    spread: float
    """Contacts closer together than this, relative to the frame's distance, count as one, as ``rank`` tells.

    Where it is not 0, what one rounding of the data does to the optimum is granted too.
    """


LAWS = {
    "float64": Laws(gap=1e-8, balance=1e-10, violation=1e-13, need=1e6, spread=0.0),
    "float32": Laws(gap=1e-4, balance=1e-4, violation=4e-6, need=1e2, spread=64 * float(np.finfo(np.float32).eps)),
}
"""In float32 what the solver's last level may leave, sqrt(eps) / 4, for the gap, eps^0.6 for the backward error, and
thirty roundings for the cones."""


class Held(NamedTuple):
    """Answers and proofs held against the laws, ``(B,)`` each."""

    solved: np.ndarray
    hopeless: np.ndarray
    """Called infeasible."""
    broken: dict[str, np.ndarray]
    """Claims that break a law, by its name."""
    granted: np.ndarray
    """Answers that stand only because the rounding of their data is granted."""
    judgement: R.Judgement
    need: np.ndarray
    """Total normal force, in loads, that the certificate proves to be needed."""


def hold(problem: Problems, weights: np.ndarray, solution: Any) -> Held:
    """Judge the claims of a solution whose precision is that of the problem's data."""
    laws = LAWS[problem.wrench.dtype.name]
    verdict = solution.verdict
    solved = (verdict == Verdict.OPTIMAL) | (verdict == Verdict.CLOSED_FORM_OPTIMAL)
    hopeless = verdict == Verdict.INFEASIBLE
    judgement = R.judge(problem, weights, solution.forces, solution.multiplier)
    need = R.proven_need(problem, weights, solution.certificate)
    gap, balance = _allowed(problem, weights, judgement, laws)
    broken = {
        "gap": solved & ~(judgement.gap <= gap),
        "backward error": solved & ~(judgement.backward_error <= balance),
        "force outside its cone": solved & ~(judgement.violation <= laws.violation),
        "proof of nothing": hopeless & ~(need >= laws.need),
    }
    strict = (judgement.gap <= laws.gap) & (judgement.backward_error <= laws.balance)
    granted = solved & ~strict & ~any_of(broken)
    return Held(solved, hopeless, broken, granted, judgement, need)


def decision_counts(problem: Problems, weights: np.ndarray, claims: Any, reference: Any) -> dict[str, int]:
    """Count wrong claims of a solution, and how its verdicts differ from those of another solver."""
    held = hold(problem, weights, claims)
    wrong = any_of(held.broken)
    if problem.feasible is not None:
        wrong = wrong | (held.hopeless if problem.feasible else held.solved)
    solved, hopeless = reference.verdict <= Verdict.OPTIMAL, reference.verdict == Verdict.INFEASIBLE
    return {
        "wrong": int(wrong.sum()),
        "undecided": int((claims.verdict == Verdict.NOT_CONVERGED).sum()),
        "undecided_by_reference": int((reference.verdict == Verdict.NOT_CONVERGED).sum()),
        "contradict": int(((held.solved & hopeless) | (held.hopeless & solved)).sum()),
        "verdicts_differ": int((claims.verdict != reference.verdict).sum()),
    }


def verdict_counts(verdict: np.ndarray) -> dict[str, int]:
    """Count each verdict, by name."""
    return {verdict_code.name: count for verdict_code in Verdict if (count := int((verdict == verdict_code).sum()))}


def any_of(broken: dict[str, np.ndarray]) -> np.ndarray:
    return np.any(list(broken.values()), axis=0)


def _allowed(
    problem: Problems, weights: np.ndarray, judgement: R.Judgement, laws: Laws
) -> tuple[np.ndarray | float, np.ndarray | float]:
    """Return the largest allowed gap and backward error of each problem."""
    if not laws.spread:
        return laws.gap, laws.balance
    centred = R.centred(problem, weights)
    far = R.norm(centred.centre) / centred.length
    return np.maximum(laws.gap, judgement.rounding), laws.balance + laws.spread * far
