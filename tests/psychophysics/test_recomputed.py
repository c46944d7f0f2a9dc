"""The paper's section III-C: which numbers come out, which by another way, and which cannot."""

import itertools

import numpy as np
import pytest

from jaxgrasp.paper import tables
from jaxgrasp.psychophysics.recomputed import RecomputedNumber, recomputed, threshold_range

ROWS = {row.quantity: row for row in recomputed()}


def test_outcomes():
    assert ROWS["F[1, 8] of 1 and 3 N"].outcome is RecomputedNumber.IMPOSSIBLE
    assert ROWS["F[1, 8] of 2 and 3 N"].outcome is RecomputedNumber.REPRODUCED
    assert ROWS["mean Weber fraction at 2 and 3 N"].outcome is RecomputedNumber.REPRODUCED
    assert ROWS["answers behind each hit ratio"].outcome is RecomputedNumber.IMPOSSIBLE
    for reference in tables.REFERENCE_WEIGHTS:
        for name in ("JND", "Weber fraction"):
            assert ROWS[f"{name} at {reference:g} N"].outcome is RecomputedNumber.OTHERWISE
        assert ROWS[f"deviation of the Weber fraction at {reference:g} N"].outcome is RecomputedNumber.UNKNOWN


@pytest.mark.parametrize("row", range(3))
def test_ranges_hold_all_that_rounds_so(row):
    """Table III with its hit ratios moved at random, within their rounding, by NumPy's own lines."""
    levels, ratios = np.array(tables.DIFFERENCES), np.array(tables.HIT_RATIOS[row])
    rng = np.random.default_rng(0)
    for method in ("interpolation", "paper"):
        value, low, high = threshold_range(method, row)
        for moved in ratios + rng.uniform(-0.005, 0.005, (300, 4)):
            if method == "paper":
                slope, begin = np.polyfit([0, *levels], [0.5, *moved], 1)
                thresholds = (0.75 - begin) / slope
            else:
                thresholds = np.interp(0.75, moved, levels)
            assert low - 1e-12 <= thresholds <= high + 1e-12
        assert low < value < high
    literal = threshold_range("interpolation", row)
    assert not literal[1] <= tables.WEBER[row] <= literal[2]


def test_f_cannot_be_reached():
    """No means and deviations that round to the printed ones give F: the largest that a search finds is far below."""
    half = 0.0005
    best = 0.0
    for corner in itertools.product((-half, half), repeat=4):
        difference = 0.244 - 0.135 + corner[0] - corner[1]
        spread = (0.052 + corner[2]) ** 2 + (0.036 + corner[3]) ** 2
        best = max(best, 5 * difference**2 / spread)
    assert best < 15.5 < tables.F_1_AND_3 - 0.05


def test_tables():
    assert np.array(tables.CONTRIBUTIONS).sum(0) == pytest.approx(tables.CONTRIBUTION_TOTALS)
    assert np.shape(tables.HIT_RATIOS) == (len(tables.REFERENCE_WEIGHTS), len(tables.DIFFERENCES))
    assert len(tables.CONTACTS) == len(tables.EXECUTION_TIMES)
