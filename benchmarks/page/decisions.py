"""Decisions of every rival on nasty problems: right, silently wrong, or an honest failure."""

from typing import NamedTuple

import numpy as np

from benchmarks.page.errors import Best, best, measure
from benchmarks.rivals.interface import Answers, Rival
from jaxgrasp.testing import problems as P
from jaxgrasp.testing.references import Problems

SLACK, LEAST = 100, 1e-6
"""An answer may miss by this many of its own tolerances, and always by the least."""


class Plan(NamedTuple):
    contacts: int = 5
    number: int = 100
    kinds: tuple[str, ...] = tuple(P.KINDS)


QUICK = Plan(number=8, kinds=("ordinary", "near_collinear", "infeasible"))


def limit(rival: Rival) -> float:
    return max(SLACK * rival.tolerance, LEAST)


def decisions(rivals: list[Rival], plan: Plan) -> list[dict]:
    """Return a row for each kind and rival that imposes friction; the weights are method B's.

    In float64 alone: rounded to float32, the nastiest of these are other problems.
    """
    deciding = [rival for rival in rivals if rival.cones != "none" and rival.dtype == "float64" and limit(rival) < 0.1]
    rows = []
    for kind in plan.kinds:
        problem = P.problems(kind, plan.contacts, plan.number, seed=0)
        answers, raised = _all_answers(deciding, problem)
        best_known = best(problem, problem.squeeze, list(answers.values()))
        feasible = _feasible(problem, best_known)
        shared = {"kind": kind, "n": plan.contacts, "count": plan.number, "feasible": int(feasible.sum())}
        for rival in deciding:
            decided = {"raised": raised[rival.name]} if rival.name in raised else {}
            if rival.name in answers:
                decided = _decided(rival, problem, answers[rival.name], best_known, feasible)
            rows.append(shared | {"method": rival.name, "cones": rival.cones, "limit": limit(rival)} | decided)
    return rows


def _all_answers(rivals: list[Rival], problem: Problems) -> tuple[dict[str, Answers], dict[str, str]]:
    answers, raised = {}, {}
    for rival in rivals:
        try:
            answers[rival.name] = rival.solve(problem, problem.squeeze)
        except Exception as error:
            # A package that gives up with an exception has failed on this kind, and the page says so.
            raised[rival.name] = f"{type(error).__name__}: {error}"
    return answers, raised


def _feasible(problem: Problems, best_known: Best) -> np.ndarray:
    """Return True where forces exist: by construction, or else where any method's answer proves itself."""
    if problem.feasible is not None:
        return np.full(len(problem.wrench), problem.feasible)
    return best_known.score < LEAST


def _decided(rival: Rival, problem: Problems, answers: Answers, best_known: Best, feasible: np.ndarray) -> dict:
    measured = measure(problem, problem.squeeze, answers, best_known)
    allowed = (measured.backward_error <= limit(rival)) & (measured.violation <= limit(rival))
    # Pyramids solve another problem: their forces have to be allowed, and what they cost is shown.
    good = allowed & ((measured.excess <= limit(rival)) | (rival.cones == "pyramids"))
    claims = answers.solved & ~answers.infeasible
    right = np.where(feasible, claims & good, answers.infeasible)
    wrong = np.where(feasible, claims & ~good | answers.infeasible, claims)
    price = measured.excess[claims & feasible & allowed]
    return {
        "right": int(right.sum()),
        "wrong": int(wrong.sum()),
        "failed": int((~right.astype(bool) & ~wrong.astype(bool)).sum()),
        "infeasible_detected": int((answers.infeasible & ~feasible).sum()),
        "infeasible_claimed_though_feasible": int((answers.infeasible & feasible).sum()),
        "median_excess": float(np.median(price)) if price.size else None,
        "max_excess": float(price.max()) if price.size else None,
    }
