"""Time of every rival on ordinary problems: alone, in batches of 1,000 and of 100,000, and how good its answers are."""

from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks import problems as P
from benchmarks import references as R
from benchmarks.page.clock import interleaved
from benchmarks.page.errors import Best, best, chosen, first, measure, summary
from benchmarks.problem_data import Problems
from benchmarks.rivals.interface import Answers, Prepared, Rival


class Plan(NamedTuple):
    """How much to measure."""

    sizes: tuple[int, ...] = (3, 5, 10, 20)
    batch: int = 1_000
    """Problems that are judged, too."""
    large: int = 100_000
    singles: int = 5
    repeats: int = 15
    budget: float = 5.0
    """Seconds that one call may take, and after which a rival repeats no more than it must."""


QUICK = Plan(sizes=(5,), batch=32, large=32, singles=1, repeats=3, budget=0.5)
BASELINE = "jaxgrasp closed_form float64"


def timings(rivals: list[Rival], plan: Plan) -> list[dict]:
    """Rows of every contact count, rival and batch."""
    rows = []
    for n in plan.sizes:
        rows += _of_size(rivals, n, plan)
        # Compiled programs of all sizes together would take up all the memory maps that a process may have.
        jax.clear_caches()
    return rows


def ordinary(n: int, count: int) -> Problems:
    """Ordinary problems whose data are float32 numbers, so that both precisions solve the same ones."""
    return P.problems("ordinary", n, count, seed=0).cast(np.float32).cast(np.float64)


def needs_cones(problem: Problems, weights: np.ndarray) -> np.ndarray:
    """Where friction holds the closed form back, by extended precision."""
    forces, _ = R.closed_form_reference(problem, weights)
    off = np.abs(forces - R.project(forces, problem.normals, problem.friction)).max((1, 2))
    return off > 1e-9 * np.abs(forces).max((1, 2))


def _of_size(rivals: list[Rival], n: int, plan: Plan) -> list[dict]:
    problem = ordinary(n, plan.large)
    few = first(problem, plan.batch)
    active = needs_cones(few, few.squeeze)
    shared = {"n": n, "sharing": "squeeze", "threads": 1, "active_share": float(active.mean())}
    alone, seconds = _alone(rivals, few, active, plan)
    each = {rival.name: float(np.mean([seconds[kind][rival.name] for kind in seconds])) for rival in rivals}
    answers, per_problem, counts = _together(rivals, few, each, (plan.batch, plan.batch // 10), plan)
    known, names = best(few, few.squeeze, list(answers.values())), list(answers)
    sources = {names[i]: int((known.source == i).sum()) for i in np.unique(known.source)}
    rows = _single_rows(rivals, few, alone, seconds, known)
    rows += _batch_rows(rivals, few, answers, per_problem, counts, known, plan.batch)
    if plan.large > plan.batch:
        many = [rival for rival in rivals if rival.batched and rival.name in per_problem]
        answers, per_problem, counts = _together(many, problem, per_problem, (plan.large, plan.large // 10), plan)
        rows += _batch_rows(many, few, answers, per_problem, counts, known, plan.large)
    shared |= {"worst_reference": float(known.score.max()), "references": sources}
    return [shared | row for row in rows]


def _alone(rivals: list[Rival], problem: Problems, active: np.ndarray, plan: Plan) -> tuple[dict, dict]:
    """Answers and seconds of single problems: some whose closed form is optimal, some with an active cone."""
    answers: dict[str, dict[str, tuple[np.ndarray, list[Answers]]]] = {}
    seconds: dict[str, dict[str, float]] = {}
    for kind, where in {"closed form optimal": ~active, "cones active": active}.items():
        index = np.flatnonzero(where)[: plan.singles]
        ready: dict[Any, Prepared] = {}
        for i in index:
            one = chosen(problem, np.array([i]))
            ready |= {(rival.name, i): rival.prepare(one, one.squeeze) for rival in rivals}
        spent = interleaved({key: prepared.run for key, prepared in ready.items()}, plan.repeats, plan.budget / 10)
        names = [rival.name for rival in rivals]
        seconds[kind] = {name: float(np.median([spent[name, i] for i in index])) for name in names}
        answers[kind] = {name: (index, [ready[name, i].read(ready[name, i].run()) for i in index]) for name in names}
    return answers, seconds


def _together(
    rivals: list[Rival], problem: Problems, guess: dict[str, float], sizes: tuple[int, ...], plan: Plan
) -> tuple[dict[str, Answers], dict[str, float], dict[str, int]]:
    """Answers, seconds a problem and batch of each rival, left out where even the smaller batch takes too long."""
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


def _single_rows(rivals: list[Rival], problem: Problems, alone: dict, seconds: dict, known: Best) -> list[dict]:
    rows = []
    for kind, answers in alone.items():
        for rival in rivals:
            index, single = answers[rival.name]
            joined = _join(single)
            part = chosen(problem, index)
            there = Best(*(array[index] for array in known))
            row = summary(rival, joined, measure(part, part.squeeze, joined, there))
            time = {"microseconds": seconds[kind][rival.name] * 1e6}
            time["to_closed_form"] = seconds[kind][rival.name] / seconds[kind][BASELINE]
            rows.append({"cell": "single", "which": kind, "batch": 1} | time | row)
    return rows


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
    known: Best,
    wanted: int,
) -> list[dict]:
    rows = []
    for rival in [rival for rival in rivals if rival.name in answers]:
        row = summary(rival, answers[rival.name], measure(problem, problem.squeeze, answers[rival.name], known))
        time = {"microseconds": per_problem[rival.name] * 1e6}
        time["to_closed_form"] = per_problem[rival.name] / per_problem[BASELINE]
        rows.append({"cell": f"batch {wanted}", "batch": counts[rival.name]} | time | row)
    return rows
