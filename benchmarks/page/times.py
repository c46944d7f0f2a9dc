"""Time of every rival on ordinary problems: alone, in batches of 1,000 and of 100,000, and how good its answers are."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from benchmarks.page.clock import interleaved
from benchmarks.page.errors import Best, best, chosen, first, measure, summary
from benchmarks.rivals.interface import Answers, Prepared, Rival
from jaxgrasp.testing import problems as P
from jaxgrasp.testing import references as R
from jaxgrasp.testing.references import Problems


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    sizes: tuple[int, ...] = (3, 5, 10, 20)
    batch: int = 1_000
    """Problems that are judged, too."""
    large: int = 100_000
    singles: int = 5
    repeats: int = 15
    budget: float = 5.0
    """Seconds that one call may take, and after which a rival repeats no more than it must."""
    burst: float = 2e-3
    """Seconds that a rival calls again and again on a single problem before it is another's turn."""


QUICK = Plan(sizes=(5,), batch=32, large=32, singles=1, repeats=3, budget=0.5)
SHARED = {"sharing": "squeeze", "threads": 1}
BASELINE = "jaxgrasp closed_form float64"


def singles(rivals: list[Rival], plan: Plan) -> list[dict]:
    """Return rows of every contact count and rival for one call on one problem."""
    return _by_size(_of_singles, rivals, plan)


def batches(rivals: list[Rival], plan: Plan) -> list[dict]:
    """Return rows of every contact count, rival and batch."""
    return _by_size(_of_batches, rivals, plan)


def _by_size(measured: Callable[[list[Rival], int, Plan], list[dict]], rivals: list[Rival], plan: Plan) -> list[dict]:
    rows = []
    for n in plan.sizes:
        rows += measured(rivals, n, plan)
        # Compiled programs of all sizes together would take up all the memory maps that a process may have.
        jax.clear_caches()
    return rows


def ordinary(n: int, count: int) -> Problems:
    """Return ordinary problems whose data are float32 numbers, so that both precisions solve the same ones."""
    return P.problems("ordinary", n, count, seed=0).cast(np.float32).cast(np.float64)


def needs_cones(problem: Problems, weights: np.ndarray) -> np.ndarray:
    """Return True where friction rules the closed form out, by extended precision."""
    forces, _ = R.closed_form_reference(problem, weights)
    off = np.abs(forces - R.project(forces, problem.normals, problem.friction)).max((1, 2))
    return off > 1e-9 * np.abs(forces).max((1, 2))


def _of_batches(rivals: list[Rival], n: int, plan: Plan) -> list[dict]:
    problem = ordinary(n, plan.large)
    few = first(problem, plan.batch)
    guess = {rival.name: _quickly(rival, few) for rival in rivals}
    answers, per_problem, counts = _together(rivals, few, guess, (plan.batch, plan.batch // 10), plan)
    best_known, names = best(few, few.squeeze, list(answers.values())), list(answers)
    sources = {names[i]: int((best_known.source == i).sum()) for i in np.unique(best_known.source)}
    rows = _batch_rows(rivals, few, answers, per_problem, counts, best_known, plan.batch)
    if plan.large > plan.batch:
        many = [rival for rival in rivals if rival.batched and rival.name in per_problem]
        answers, per_problem, counts = _together(many, problem, per_problem, (plan.large, plan.large // 10), plan)
        rows += _batch_rows(many, few, answers, per_problem, counts, best_known, plan.large)
    share = float(needs_cones(few, few.squeeze).mean())
    shared = SHARED | {
        "n": n,
        "active_share": share,
        "references": sources,
        "worst_reference": float(best_known.score.max()),
    }
    return [shared | row for row in rows]


def _quickly(rival: Rival, problem: Problems) -> float:
    """Estimate the seconds of a single problem."""
    single = first(problem, 1)
    return interleaved({0: rival.prepare(single, single.squeeze).run}, repeats=1, budget=1.0)[0]


def _of_singles(rivals: list[Rival], n: int, plan: Plan) -> list[dict]:
    """Measure single problems whose closed form is optimal, and single problems with an active cone."""
    few = ordinary(n, plan.batch)
    active = needs_cones(few, few.squeeze)
    rows = []
    for kind, where in {"closed form optimal": ~active, "cones active": active}.items():
        index = np.flatnonzero(where)[: plan.singles]
        answers, seconds = _alone(rivals, [chosen(few, np.array([i])) for i in index], plan)
        part = chosen(few, index)
        best_known = best(part, part.squeeze, list(answers.values()))
        for rival in rivals:
            row = summary(rival, answers[rival.name], measure(part, part.squeeze, answers[rival.name], best_known))
            time = {"microseconds": seconds[rival.name] * 1e6}
            time["to_closed_form"] = seconds[rival.name] / seconds[BASELINE]
            rows.append(SHARED | {"n": n, "cell": "single", "which": kind, "batch": 1} | time | row)
    return rows


def _alone(rivals: list[Rival], problems: list[Problems], plan: Plan) -> tuple[dict[str, Answers], dict[str, float]]:
    """Return the answers of each rival to each of the problems, and its seconds a call."""
    ready = {
        (rival.name, i): rival.prepare(problem, problem.squeeze)
        for i, problem in enumerate(problems)
        for rival in rivals
    }
    runs = {key: prepared.run for key, prepared in ready.items()}
    spent = interleaved(runs, plan.repeats, plan.budget / 10, plan.burst)
    indices = range(len(problems))
    seconds = {rival.name: float(np.median([spent[rival.name, i] for i in indices])) for rival in rivals}
    single = {name: [ready[name, i].read(ready[name, i].run()) for i in indices] for name in seconds}
    return {name: _join(answers) for name, answers in single.items()}, seconds


def _together(
    rivals: list[Rival], problem: Problems, guess: dict[str, float], sizes: tuple[int, ...], plan: Plan
) -> tuple[dict[str, Answers], dict[str, float], dict[str, int]]:
    """Return answers, seconds a problem and batch of each rival, without those too slow even for the smaller batch."""
    ready: dict[str, Prepared] = {}
    counts: dict[str, int] = {}
    for rival in rivals:
        fitting = [size for size in sizes if size * guess[rival.name] <= plan.budget]
        if fitting:
            counts[rival.name] = fitting[0]
            part = first(problem, fitting[0])
            ready[rival.name] = rival.prepare(part, part.squeeze)
    spent = interleaved({name: prepared.run for name, prepared in ready.items()}, plan.repeats, plan.budget)
    answers = {name: prepared.read(prepared.run()) for name, prepared in ready.items()}
    return answers, {name: seconds / counts[name] for name, seconds in spent.items()}, counts


def _join(single: list[Answers]) -> Answers:
    multipliers = [answers.multiplier for answers in single if answers.multiplier is not None]
    return Answers(
        np.concatenate([answers.forces for answers in single]),
        np.concatenate(multipliers) if multipliers else None,
        np.concatenate([answers.solved for answers in single]),
        np.concatenate([answers.infeasible for answers in single]),
    )


def _batch_rows(
    rivals: list[Rival],
    problem: Problems,
    answers: dict[str, Answers],
    per_problem: dict[str, float],
    counts: dict[str, int],
    best_known: Best,
    batch: int,
) -> list[dict]:
    rows = []
    for rival in [rival for rival in rivals if rival.name in answers]:
        row = summary(rival, answers[rival.name], measure(problem, problem.squeeze, answers[rival.name], best_known))
        time = {"microseconds": per_problem[rival.name] * 1e6}
        time["to_closed_form"] = per_problem[rival.name] / per_problem[BASELINE]
        rows.append({"cell": f"batch {batch}", "batch": counts[rival.name]} | time | row)
    return rows
