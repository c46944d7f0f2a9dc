"""Nothing is silently wrong on nasty problems: what claims to be an answer is one, what claims a proof has one.

Every claim is judged by ``jaxgrasp.testing.references`` alone: extended precision, nothing of the solver's own. The
quick tests take some problems of every kind, the slow ones a thousand of each at every size.
"""

import jax
import numpy as np
import pytest

import jaxgrasp
from benchmarks.laws import Held, hold
from jaxgrasp import Grasp, Solution, Verdict
from jaxgrasp.testing import problems as P

SHARINGS = ("squeeze", "uniform")
COUNT, SEED = 64, 3
LONG_COUNT = 1000
LONG = [(kind, n) for n in (1, 2, 3, 5, 10, 20) for kind in P.KINDS if n >= P.LEAST_CONTACTS.get(kind, 1)]
UNDECIDED = {"combined": 0.005, "limit_9999": 0.01, "limit_10001": 0.01}
"""Largest share of NOT_CONVERGED answers; none in the other kinds."""


def solve(problem: P.Problems, weights: np.ndarray, few: int | None = None) -> Solution:
    """Solve all problems at once, or ``few`` at a time, where none are gathered."""
    arrays = (problem.points, problem.normals, problem.friction, problem.squeeze, problem.wrench, weights)
    if few is None:
        return jax.device_get(solve_batch(arrays))
    parts = tuple(x.reshape(-1, few, *x.shape[1:]) for x in arrays)
    solution = solve_parts(parts)
    return jax.device_get(jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), solution))


@jax.jit
def solve_parts(parts: tuple) -> Solution:
    return jax.lax.map(solve_batch, parts)


def solve_batch(arrays: tuple) -> Solution:
    *contacts, wrench, weights = arrays
    return jaxgrasp.constrained_optimum(Grasp(*contacts), wrench, weights)


def share(solution: Solution, verdict: Verdict) -> float:
    return float(np.mean(solution.verdict == verdict))


def nowhere(broken: np.ndarray, law: str, problem: P.Problems, sharing: str) -> None:
    lanes = np.flatnonzero(broken)
    assert not len(lanes), f"{law} in {problem.kind}, {problem.points.shape[1]} contacts, {sharing}: {lanes[:20]}"


def solve_lawfully(problem: P.Problems, sharing: str, few: int | None = None) -> tuple[Solution, Held]:
    """Solve, and assert all that holds whether or not the problem can be solved."""
    weights = problem.weights(sharing)
    solution = solve(problem, weights, few)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(solution))
    lawful_verdicts = {
        Verdict.CLOSED_FORM_OPTIMAL,
        Verdict.OPTIMAL,
        Verdict.INFEASIBLE,
        Verdict.NOT_CONVERGED,
        Verdict.FEASIBLE,
    }
    assert set(solution.verdict.tolist()) <= (lawful_verdicts if weights.any() else {Verdict.NO_CONTACTS})
    held = hold(problem, weights, solution)
    for law, broken in held.broken.items():
        nowhere(broken, law, problem, sharing)
    nowhere((solution.certificate != 0).any(-1) & held.solved, "proof against an answer", problem, sharing)
    return solution, held


def decided_rightly(problem: P.Problems, sharing: str, few: int | None = None) -> Solution:
    """Solve in double precision, and assert that what is feasible is not called otherwise, nor the reverse."""
    solution, held = solve_lawfully(problem, sharing, few)
    if problem.feasible is True:
        nowhere(held.hopeless, "feasible, called infeasible", problem, sharing)
    if problem.feasible is False:
        nowhere(held.solved, "infeasible, called solved", problem, sharing)
    return solution


def undecided(kind: str, n: int, count: int, seed: int, few: int | None = None) -> list[float]:
    """Return the share of NOT_CONVERGED answers by each sharing, after checking all other verdicts."""
    problem = P.problems(kind, n, count, seed)
    return [share(decided_rightly(problem, sharing, few), Verdict.NOT_CONVERGED) for sharing in SHARINGS]


@pytest.mark.optimized
@pytest.mark.parametrize("kind", P.KINDS)
def test_every_problem_is_decided_rightly(kind):
    shares = [undecided(kind, n, COUNT, SEED) for n in (2, 3, 5)]
    assert np.mean(shares) <= UNDECIDED.get(kind, 0)


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("kind, n", LONG)
def test_every_problem_is_decided_rightly_at_length(kind, n):
    assert max(undecided(kind, n, LONG_COUNT, SEED)) <= UNDECIDED.get(kind, 0)


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("few", [1, 4])
@pytest.mark.parametrize("kind", P.KINDS)
def test_a_few_at_a_time_are_decided_as_rightly(kind, few):
    for n in (3, 5):
        assert max(undecided(kind, n, LONG_COUNT, SEED, few)) <= UNDECIDED.get(kind, 0)


KNOWN_GAP = pytest.mark.xfail(reason="one problem by method B: a duality gap of 3e-8 passes for one below 1e-8")
WITH_GAP = {("combined", 2), ("near_collinear", 0)}
"""The latter under some compilers only."""
SEEDS = [
    pytest.param(kind, seed, marks=[KNOWN_GAP] if (kind, seed) in WITH_GAP else [])
    for kind in ("near_collinear", "wide_squeeze", "some_zero_squeeze", "combined")
    for seed in (0, 1, 2, 4, 5)
]


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("kind, seed", SEEDS)
def test_three_contacts_are_decided_rightly_whatever_the_seed(kind, seed):
    """The fewest contacts that reach every wrench: rare failures are the least rare here."""
    assert max(undecided(kind, 3, LONG_COUNT, seed)) <= UNDECIDED.get(kind, 0)


SINGLE_SOLVES = ("ordinary", "coincident_some", "coincident_all", "high_friction", "wide_squeeze", "scales")
"""Kinds whose data single precision holds well enough to solve at least 49 of 50."""


def single(kind: str, n: int, count: int) -> P.Problems:
    """Return problems rounded to float32; one near its limit may have crossed it, so only the judge tells."""
    return P.problems(kind, n, count, SEED).cast(np.float32)


def single_is_lawful(problem: P.Problems, sharing: str) -> None:
    solution, held = solve_lawfully(problem, sharing)
    assert solution.forces.dtype == np.float32
    if problem.kind in SINGLE_SOLVES:
        assert held.solved.mean() >= 0.98
    if problem.kind == "infeasible":
        assert share(solution, Verdict.INFEASIBLE) == 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", P.KINDS)
def test_single_precision_is_never_silently_wrong(kind):
    single_is_lawful(single(kind, 3, COUNT), "squeeze")


NEAR_LIMIT = {("limit_101", n) for n in (1, 2, 3)} | {("limit_10001", n) for n in (1, 2, 3)}
NEAR_LIMIT |= {("limit_9999", n) for n in (2, 3, 5)} | {("limit_99", 3)}
SINGLE_MARKS = {("near_collinear", 3): pytest.mark.optimized} | {
    case: pytest.mark.xfail(
        reason="single precision near the limit: up to 15 of 1,000 leave gaps of 1e-4 to 8e-4, where 1e-4 is asked, or "
        "prove that 30 to 65 loads are needed, where 100 are asked"
    )
    for case in NEAR_LIMIT
}
"""One gap of the first is a little too wide without optimisation."""
SINGLE_LONG = [pytest.param(*case, marks=SINGLE_MARKS.get(case, ())) for case in LONG]


@pytest.mark.slow
@pytest.mark.repeats
@pytest.mark.parametrize("kind, n", SINGLE_LONG)
def test_single_precision_is_never_silently_wrong_at_length(kind, n):
    for sharing in SHARINGS:
        single_is_lawful(single(kind, n, LONG_COUNT), sharing)
