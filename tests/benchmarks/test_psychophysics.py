"""The psychophysics' benchmark: its page is that of the committed results, and its coverage is what was asked."""

import json

import pytest

from benchmarks import psychophysics
from benchmarks.page import psychophysics_tables
from benchmarks.readme import RESULTS

REPORT = json.loads((RESULTS / "psychophysics.json").read_text())


def test_the_page_is_that_of_the_committed_results():
    assert psychophysics_tables.page(REPORT) == (RESULTS / "psychophysics.md").read_text()


def test_what_is_committed_keeps_its_limits():
    """At ten times the paper's answers: coverage of 93 to 97 %, and a bias of 3 % at most."""
    precise_rows = [row for row in REPORT["recovery"] if row["answers"] >= 100 and row["method"] == "likelihood"]
    assert len(precise_rows) == 2 * 4 * 2 * 3 and REPORT["effort"]["experiments"] == 1000
    assert all(abs(row["bias"]) < 0.03 for row in precise_rows)
    assert all(0.93 <= row["coverage"] <= 0.97 for row in precise_rows if not row["free"])


@pytest.mark.slow
def test_in_short():
    """A small version: every section runs, and finds what is there within what so few experiments allow."""
    rows = [row for row in psychophysics.misfit(psychophysics.QUICK) if row["answers"] == 500]
    likelihood_row = next(row for row in rows if row["method"] == "likelihood, difference")
    assert abs(likelihood_row["bias"]) < 0.04 and likelihood_row["coverage"] > 0.85
    assert next(row for row in rows if row["method"] == "paper")["bias"] > 0.05
    by_name = {(row["procedure"], row["trials"]): row for row in psychophysics.procedures(psychophysics.QUICK)}
    assert all(abs(row["bias"]) < 0.3 for (_, trials), row in by_name.items() if trials == 120)
