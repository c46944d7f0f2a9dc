"""Suite of hard grasp problems: a fixed, versioned collection with references in extended precision, and its scoring.

For people who write cone solvers: ``load_suite()`` returns the problems, ``score`` compares an answer with the
reference, and ``counts`` and ``csv_text`` sum scores up. Each problem is a second-order cone program,

    minimise the sum of |f_i - s_i a_i|^2 / (2 k_i)   subject to   G f = w,   f_i in its friction cone,

with moments about the normals for soft fingers and bounds of joint torques in some. Normals are used as directions:
a_i stands for the stored vector over its length. A contact with k_i = 0 exerts s_i a_i. NumPy alone: no solver is
imported. ``benchmarks.make_suite`` made the file, ``suite_judge`` checks its references.
"""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxgrasp.testing.references import Wide
from jaxgrasp.testing.suite_files import read_npz
from jaxgrasp.testing.suite_problem import (
    KINDS,
    VERSION,
    Answer,
    Claim,
    Outcome,
    SuiteProblem,
    frame,
    norm,
    objective,
    or_one,
    spin_radius,
)

__all__ = [
    "KINDS",
    "VERSION",
    "Answer",
    "Claim",
    "Errors",
    "Outcome",
    "Score",
    "SuiteProblem",
    "load_suite",
    "measure",
    "proven_need",
    "score",
]

FILE = Path(__file__).parents[1] / "data" / "suite.npz"


class Errors(NamedTuple):
    """Errors of an answer, relative to the problem's own sizes."""

    balance: float
    """|w - G f| over the sum of the magnitudes of its terms, about the contacts' centroid, in contacts' radii."""
    violation: float
    """Largest distance of a force from its cone over the largest force; excess torques over the sums of their terms."""
    objective: float
    """|objective - reference| over the larger of the reference and that of no force; infinite where infeasible."""
    forces: float
    """Largest error of a force over the largest reference force; infinite where infeasible."""


class Score(NamedTuple):
    """Outcome of one answer."""

    problem: str
    kind: str
    outcome: Outcome
    is_nearby: bool
    """The outcome is wrong or infeasible called solved, but forces balance and obey the cones within tolerance: the
    answer to a problem nearby."""
    errors: Errors | None
    need: float
    """Total normal force, in loads, that a certificate proves to be needed; NaN without one."""
    seconds: float
    text: str


NEEDED = 1e6
"""Total normal force, in loads, that a certificate must prove to be needed at least."""


def load_suite(kinds: Sequence[str] = (), *, path: Path = FILE) -> tuple[SuiteProblem, ...]:
    """Return the problems of the suite, or those of some kinds, in their fixed order.

    Raises:
        ValueError: for a kind that does not exist.
    """
    for kind in kinds:
        if kind not in KINDS:
            raise ValueError(f"kind is {kind!r}: expected one of {', '.join(KINDS)}")
    return tuple(problem for problem in read_npz(path) if not kinds or problem.kind in kinds)


def score(problem: SuiteProblem, answer: Answer, tolerance: float = 1e-6) -> Score:
    """Judge an answer: errors of balance, cones and objective must all be at most ``tolerance``."""
    errors, need, is_nearby = None, float("nan"), False
    outcome = Outcome.SAID_SO
    if answer.claim is Claim.SOLVED:
        errors = measure(problem, answer)
        is_allowed = max(errors.balance, errors.violation) <= tolerance
        if problem.feasible and is_allowed and errors.objective <= tolerance:
            outcome = Outcome.RIGHT
        else:
            outcome = Outcome.WRONG if problem.feasible else Outcome.INFEASIBLE_SOLVED
            is_nearby = is_allowed
    elif answer.claim is Claim.INFEASIBLE:
        if answer.certificate is not None:
            need = proven_need(problem, answer.certificate)
        outcome = Outcome.WRONG if problem.feasible else Outcome.PROVEN if need >= NEEDED else Outcome.CLAIMED
    return Score(
        problem.name, problem.kind, outcome, is_nearby, errors, need, float(answer.seconds), answer.text
    )  # fmt: skip


def measure(problem: SuiteProblem, answer: Answer) -> Errors:
    """Compute the errors of forces in long double; infinite where they are not finite."""
    n = len(problem.friction)
    forces = np.asarray(answer.forces, Wide)
    moments = np.zeros(n, Wide) if answer.moments is None else np.asarray(answer.moments, Wide)
    if not (np.isfinite(forces).all() and np.isfinite(moments).all()):
        return Errors(*[float("inf")] * 4)
    coordinates = frame(problem)
    normals, arms = coordinates.normals, coordinates.arms
    sizes = np.maximum(norm(forces), np.asarray(problem.squeeze, Wide))
    turning = moments[:, None] / coordinates.length * normals
    exerted = np.concatenate([forces.sum(0), (np.cross(arms, forces) + turning).sum(0)])
    terms = norm(coordinates.wrench) + np.sum(np.sqrt(1 + np.sum(arms**2, -1)) * sizes + norm(turning))
    largest = or_one(sizes.max())
    pressed = np.sum(forces * normals, -1)
    radii = np.asarray(spin_radius(problem), Wide)
    spins = np.where(radii > 0, moments / or_one(radii), 0)
    dragged = np.sqrt(np.sum((forces - pressed[:, None] * normals) ** 2, -1) + spins**2)
    mu = np.asarray(problem.friction, Wide)
    outside = np.maximum(dragged - mu * pressed, 0) / np.sqrt(1 + mu**2)
    # The nearest force of the cone is its apex where the force lies in the polar cone.
    outside = np.where(mu * dragged <= -pressed, np.sqrt(pressed**2 + dragged**2), outside)
    # Contacts that cannot move must hold their squeezing forces; hard fingers exert no moment.
    held = norm(forces - np.asarray(problem.squeeze, Wide)[:, None] * normals)
    outside = np.where(problem.weights > 0, outside, held)
    stray = np.max(np.where(radii > 0, 0, np.abs(moments))) / coordinates.length
    violation = max(np.max(outside), stray) / largest
    if problem.torque_map is not None and problem.torque_max is not None:
        torque_map = np.asarray(problem.torque_map, Wide)
        torque = np.abs(np.einsum("nc,ncj->j", forces, torque_map))
        size = np.einsum("nc,ncj->j", np.abs(forces), np.abs(torque_map)) + np.asarray(problem.torque_max, Wide)
        violation = max(violation, np.max((torque - problem.torque_max) / or_one(size)))
    balance = norm(coordinates.wrench - exerted) / or_one(terms)
    if not problem.feasible:
        return Errors(float(balance), float(violation), float("inf"), float("inf"))
    reference = problem.wide("forces")
    idle = objective(problem, np.where((problem.weights > 0)[:, None], 0, reference), 0 * moments)
    best = problem.optimum
    excess = np.abs(objective(problem, forces, moments) - best) / or_one(np.maximum(best, idle))
    apart = np.max(norm(forces - reference)) / or_one(np.max(norm(reference)))
    return Errors(float(balance), float(violation), float(excess), float(apart))


def proven_need(problem: SuiteProblem, certificate: np.ndarray) -> float:
    """Compute the total normal force, in loads, that a twist proves any allowed forces to need.

    The wrench does the work w.d along it, and a contact at most its normal force times the largest work of a unit of
    it. Infinite where no contact can do any, zero where the twist proves nothing. Without torque limits, which only
    make forces fewer.
    """
    coordinates = frame(problem)
    d = np.asarray(certificate, Wide)
    if d.shape != (6,) or not np.isfinite(d).all():
        return 0.0
    linear, angular = d[:3] + np.cross(d[3:], coordinates.centre), d[3:] * coordinates.length
    velocity = linear + np.cross(angular, coordinates.arms)
    along = np.sum(velocity * coordinates.normals, -1)
    spin = np.asarray(spin_radius(problem), Wide) / coordinates.length * (coordinates.normals @ angular)
    across = np.sqrt(np.sum((velocity - along[:, None] * coordinates.normals) ** 2, -1) + spin**2)
    is_movable = problem.weights > 0
    work = coordinates.wrench @ np.concatenate([linear, angular])
    work -= np.sum(np.where(is_movable, 0, np.asarray(problem.squeeze, Wide) * along))
    largest = np.max(np.where(is_movable, along + np.asarray(problem.friction, Wide) * across, -np.inf))
    if not work > 0:
        return 0.0
    return float(work / largest / coordinates.load) if largest > 0 else float("inf")


OUTCOMES = tuple(Outcome)
LEAST_TOLERANCE, SLACK = 1e-6, 100
"""An answer may miss by ``SLACK`` of its solver's own tolerances, and always by the least."""
COLUMNS = (
    *("problem", "kind", "outcome", "is_nearby", "balance", "violation", "objective", "forces", "need", "seconds"),
    "status",
)


def judged_tolerance(tolerance: float) -> float:
    """Return the largest error of a right answer, for a solver that was asked for a tolerance."""
    return max(LEAST_TOLERANCE, SLACK * tolerance)


def counts(scores: Sequence[Score]) -> dict[str, int]:
    """Count the outcomes, and those that are wrong of which the forces solve a problem nearby."""
    result = {outcome.value: sum(score.outcome is outcome for score in scores) for outcome in OUTCOMES}
    return result | {
        "wrong, nearby": sum(score.is_nearby and score.outcome is Outcome.WRONG for score in scores),
        "infeasible solved, nearby": sum(
            score.is_nearby and score.outcome is Outcome.INFEASIBLE_SOLVED for score in scores
        ),
    }


def median_seconds(scores: Sequence[Score]) -> float:
    """Return the median time of a problem [s]."""
    return float(np.median([score.seconds for score in scores])) if scores else float("nan")


def csv_text(scores: Sequence[Score]) -> str:
    """Return a table of the scores as text with commas."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for score in scores:
        errors = ("", "", "", "") if score.errors is None else tuple(f"{x:.3g}" for x in score.errors)
        need = "" if np.isnan(score.need) else f"{score.need:.3g}"
        writer.writerow(
            [
                *(score.problem, score.kind, score.outcome.value, int(score.is_nearby), *errors, need),
                *(f"{score.seconds:.3g}", score.text),
            ]
        )
    return stream.getvalue()
