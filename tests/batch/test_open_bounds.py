"""Measures between bounds that stayed apart are counted, in the summary, on the console and in the report."""

import numpy as np
import pytest

from jaxgrasp.batch.qualities import QualitySummary, quality_line, summarise_qualities
from jaxgrasp.quality.measures import measures_named

LOWER, UPPER = np.array([0.1, 0.5, 0.0, 0.0, 0.4]), np.array([0.10005, 0.6, 0.0, 0.1, 0.4])
"""Known to 0.05 %; 17 % apart; not closed; closure not decided; exact."""


@pytest.mark.parametrize("name", ["ferrari-canny-l1", "ferrari-canny-linf"])
def test_bounds_that_stayed_apart_are_counted(name):
    (measure,) = measures = measures_named((name,), None)
    halves = [
        summarise_qualities(measures, {f"{name}.lower": LOWER[part], f"{name}.upper": UPPER[part]})[measure.name]
        for part in (slice(0, 2), slice(2, None))
    ]
    assert [half.undecided for half in halves] == [1, 1]
    whole = QualitySummary.from_json(halves[0].merged(halves[1]).to_json())
    assert quality_line(name, whole).endswith("  40.0 % with bounds more than 0.1 % apart")


def test_of_measures_without_bounds_and_of_bounds_that_met_none_is():
    measures = measures_named(("min-weight", "ferrari-canny-l1", "least-singular-value"), None)
    columns = {"min-weight.value": LOWER, "least-singular-value.value": LOWER}
    columns |= dict.fromkeys(("ferrari-canny-l1.lower", "ferrari-canny-l1.upper"), LOWER)
    for name, summary in summarise_qualities(measures, columns).items():
        assert summary.undecided == 0 and "apart" not in quality_line(name, summary)
