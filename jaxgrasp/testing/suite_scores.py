"""Tables of scores: counts of outcomes by kind, and a CSV file with a row for each problem."""

import csv
import io
from collections.abc import Sequence

import numpy as np

from jaxgrasp.testing.suite import Outcome, Score

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
