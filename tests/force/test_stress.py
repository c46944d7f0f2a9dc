"""Nothing is silently wrong on nasty problems: what claims to be an answer is one, what claims a proof has one.

Every claim is judged by ``benchmarks.references`` alone: extended precision, nothing of the solver's own. The quick
tests take some problems of every kind, the slow ones a thousand of each at every size.
"""

from typing import NamedTuple

import jax
import numpy as np
import pytest

import jaxgrasp
from benchmarks import problems as P
from benchmarks import references as R
from jaxgrasp import Grasp, Solution, Verdict

SHARINGS = ("squeeze", "uniform")
COUNT, SEED = 64, 3
LONG_COUNT = 1000
LONG = [(kind, n) for n in (1, 2, 3, 5, 10, 20) for kind in P.KINDS if n >= P.LEAST_CONTACTS.get(kind, 1)]
UNDECIDED = {"combined": 0.005, "limit_9999": 0.01, "limit_10001": 0.01}
"""Largest share of NOT_CONVERGED answers; none in the other kinds."""


class Laws(NamedTuple):
    """How good answers and proofs have to be in one precision."""

    gap: float
    balance: float
    """Largest backward error."""
    violation: float
    need: float
    """Least total normal force, in loads, that a certificate proves to be needed."""


DOUBLE = Laws(gap=1e-8, balance=1e-10, violation=1e-13, need=1e6)
SINGLE = Laws(gap=1e-4, balance=1e-4, violation=4e-6, need=1e2)
SPREAD = 64 * np.finfo(np.float32).eps
"""Contacts closer together than this, relative to the frame's distance, count as one: `rank` tells."""


def solve(problem: P.Problems, weights: np.ndarray) -> Solution:
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    return jax.device_get(jaxgrasp.constrained_optimum(grasp, problem.wrench, weights))


def solved(solution: Solution) -> np.ndarray:
    return (solution.verdict == Verdict.OPTIMAL) | (solution.verdict == Verdict.CLOSED_FORM_OPTIMAL)


def share(solution: Solution, verdict: Verdict) -> float:
    return float(np.mean(solution.verdict == verdict))


def nowhere(broken: np.ndarray, law: str, problem: P.Problems, sharing: str) -> None:
    lanes = np.flatnonzero(broken)
    assert not len(lanes), f"{law} in {problem.kind}, {problem.points.shape[1]} contacts, {sharing}: {lanes[:20]}"


def solve_lawfully(problem: P.Problems, sharing: str, laws: Laws) -> Solution:
    """Solve, and assert all that holds whether or not the problem can be solved."""
    weights = problem.weights(sharing)
    solution = solve(problem, weights)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(solution))
    known = {Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED}
    assert set(solution.verdict.tolist()) <= (known if weights.any() else {Verdict.NO_CONTACTS})
    judged = R.judge(problem, weights, solution.forces, solution.multiplier)
    good, hopeless = solved(solution), solution.verdict == Verdict.INFEASIBLE
    gap, balance = laws.gap, laws.balance
    if laws is SINGLE:
        # Rounding of the data alone does as much, in frames hundreds of radii away above all.
        here = R.centred(problem, weights)
        gap = np.maximum(gap, judged.rounding)
        balance = balance + SPREAD * R.norm(here.centre) / here.length
    nowhere(good & ~(judged.gap <= gap), "gap", problem, sharing)
    nowhere(good & ~(judged.backward_error <= balance), "backward error", problem, sharing)
    nowhere(good & ~(judged.violation <= laws.violation), "force outside its cone", problem, sharing)
    need = R.proven_need(problem, weights, solution.certificate)
    nowhere(hopeless & ~(need > laws.need), "proof of nothing", problem, sharing)
    nowhere((solution.certificate != 0).any(-1) & good, "proof against an answer", problem, sharing)
    return solution


def decided_rightly(problem: P.Problems, sharing: str) -> Solution:
    """Solve in double precision, and assert that what is feasible is not called otherwise, nor the reverse."""
    solution = solve_lawfully(problem, sharing, DOUBLE)
    if problem.feasible is True:
        nowhere(solution.verdict == Verdict.INFEASIBLE, "feasible, called infeasible", problem, sharing)
    if problem.feasible is False:
        nowhere(solved(solution), "infeasible, called solved", problem, sharing)
    return solution


def undecided(kind: str, n: int, count: int, seed: int) -> list[float]:
    """The share of NOT_CONVERGED answers by each sharing, all else being decided rightly."""
    problem = P.problems(kind, n, count, seed)
    return [share(decided_rightly(problem, sharing), Verdict.NOT_CONVERGED) for sharing in SHARINGS]


@pytest.mark.parametrize("kind", P.KINDS)
def test_every_problem_is_decided_rightly(kind):
    shares = [undecided(kind, n, COUNT, SEED) for n in (2, 3, 5)]
    assert np.mean(shares) <= UNDECIDED.get(kind, 0)


@pytest.mark.slow
@pytest.mark.parametrize("kind, n", LONG)
def test_every_problem_is_decided_rightly_at_length(kind, n):
    assert max(undecided(kind, n, LONG_COUNT, SEED)) <= UNDECIDED.get(kind, 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 4, 5])
@pytest.mark.parametrize("kind", ["near_collinear", "wide_squeeze", "some_zero_squeeze", "combined"])
def test_three_contacts_are_decided_rightly_whatever_the_seed(kind, seed):
    """The fewest contacts that reach every wrench: rare failures are the least rare here."""
    assert max(undecided(kind, 3, LONG_COUNT, seed)) <= UNDECIDED.get(kind, 0)


SINGLE_SOLVES = ("ordinary", "coincident_some", "coincident_all", "high_friction", "wide_squeeze", "scales")
"""Kinds whose data single precision holds well enough to solve at least 49 of 50."""


def single(kind: str, n: int, count: int) -> P.Problems:
    """Rounded problems: one near its limit may have crossed it, so only the judge tells which are solved."""
    return P.problems(kind, n, count, SEED).cast(np.float32)


def single_is_lawful(problem: P.Problems, sharing: str) -> None:
    solution = solve_lawfully(problem, sharing, SINGLE)
    assert solution.forces.dtype == np.float32
    if problem.kind in SINGLE_SOLVES:
        assert solved(solution).mean() >= 0.98
    if problem.kind == "infeasible":
        assert share(solution, Verdict.INFEASIBLE) == 1


@pytest.mark.parametrize("kind", P.KINDS)
def test_single_precision_is_never_silently_wrong(kind):
    single_is_lawful(single(kind, 3, COUNT), "squeeze")


@pytest.mark.slow
@pytest.mark.parametrize("kind, n", LONG)
def test_single_precision_is_never_silently_wrong_at_length(kind, n):
    for sharing in SHARINGS:
        single_is_lawful(single(kind, n, LONG_COUNT), sharing)
