"""Distances of answers from the best one known, which no single method is trusted to give."""

from typing import NamedTuple

import numpy as np

from benchmarks.rivals.interface import Answers, Rival
from jaxgrasp.testing import references as R
from jaxgrasp.testing.references import Problems


class Best(NamedTuple):
    """For each problem the forces and multiplier, of any method, that prove themselves best in extended precision."""

    forces: np.ndarray
    primal: np.ndarray
    dual: np.ndarray
    scale: np.ndarray
    """What objective errors are relative to: the larger of the optimum and the price of no forces at all."""
    score: np.ndarray
    """The larger of gap, backward error and violation; infinite where no method answered."""
    source: np.ndarray
    """Index of the method, in the order given."""


def first(problem: Problems, count: int) -> Problems:
    return chosen(problem, np.arange(min(count, len(problem.squeeze))))


def chosen(problem: Problems, index: np.ndarray) -> Problems:
    arrays = {name: getattr(problem, name)[index] for name in R.ARRAYS}
    return problem._replace(**arrays, witness=None)


def best(problem: Problems, weights: np.ndarray, answers: list[Answers]) -> Best:
    """Return the best pair of each problem; each method may have answered only the first few."""
    size, contacts = weights.shape
    scales = np.sum(np.where(weights > 0, problem.squeeze**2 / np.where(weights > 0, 2 * weights, 1), 0), -1)
    zeros, unproven, no_source = np.zeros(size), np.full(size, np.inf), np.full(size, -1)
    best_known = Best(np.zeros((size, contacts, 3)), zeros, zeros.copy(), scales.copy(), unproven, no_source)
    for source, answer in enumerate(answers):
        if answer.multiplier is None:
            continue
        count = len(answer.solved)
        judgement = R.judge(first(problem, count), weights[:count], answer.forces, answer.multiplier)
        score = _rounded(np.maximum(np.maximum(judgement.gap, judgement.backward_error), judgement.violation))
        better = np.flatnonzero(score < best_known.score[:count])
        best_known.forces[better] = answer.forces[better]
        best_known.primal[better], best_known.dual[better] = judgement.primal[better], judgement.dual[better]
        best_known.scale[better] = np.maximum(scales[better], judgement.primal[better])
        best_known.score[better], best_known.source[better] = score[better], source
    return best_known


class Measured(NamedTuple):
    """Errors of one method's answers, one entry a problem."""

    force: np.ndarray
    """Largest error of a force relative to the problem's largest force."""
    excess: np.ndarray
    """|objective - the best one| on the scale of the best."""
    gap: np.ndarray | None
    """The method's own duality gap."""
    backward_error: np.ndarray
    violation: np.ndarray


def measure(problem: Problems, weights: np.ndarray, answers: Answers, best_known: Best) -> Measured:
    """Return the errors of the first answers, as many as there are of both."""
    count = min(len(answers.solved), len(best_known.primal))
    problem, weights = first(problem, count), weights[:count]
    multiplier = np.zeros((count, 6)) if answers.multiplier is None else answers.multiplier[:count]
    forces = answers.forces[:count]
    judgement = R.judge(problem, weights, forces, multiplier)
    distances = np.sqrt(np.sum((forces - best_known.forces[:count]) ** 2, -1)).max(-1)
    largest = np.sqrt(np.sum(best_known.forces[:count] ** 2, -1)).max(-1)
    scale = best_known.scale[:count]
    return Measured(
        distances / np.where(largest > 0, largest, 1),
        _rounded(np.abs(judgement.primal - best_known.primal[:count]) / np.where(scale > 0, scale, 1)),
        None if answers.multiplier is None else _rounded(judgement.gap),
        _rounded(judgement.backward_error),
        _rounded(judgement.violation),
    )


def _rounded(wide: np.ndarray) -> np.ndarray:
    """Round extended precision to float64, whose range is smaller."""
    return np.minimum(wide, np.finfo(float).max).astype(float)


def summary(rival: Rival, answers: Answers, measured: Measured) -> dict:
    """Summarise the errors over the problems that the method claims to have solved, and their number."""
    solved = answers.solved[: len(measured.force)]

    def worst(errors: np.ndarray | None) -> float | None:
        return float(errors[solved].max()) if errors is not None and solved.any() else None

    return {
        "method": rival.name,
        "package": rival.package,
        "licence": rival.licence,
        "dtype": rival.dtype,
        "tolerance": rival.tolerance,
        "cones": rival.cones,
        "judged": len(solved),
        "solved": int(solved.sum()),
        "median_force_error": float(np.median(measured.force[solved])) if solved.any() else None,
        "max_force_error": worst(measured.force),
        "max_excess": worst(measured.excess),
        "max_gap": worst(measured.gap),
        "max_backward_error": worst(measured.backward_error),
        "max_violation": worst(measured.violation),
    }
