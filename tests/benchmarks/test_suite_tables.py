"""The page of the suite is that of its committed results, and these are of the suite that the package has."""

import json

from benchmarks.page import suite_tables
from benchmarks.readme import RESULTS
from jaxgrasp.testing.suite import VERSION, load_suite


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "suite.json").read_text())
    assert suite_tables.page(report) == (RESULTS / "suite.md").read_text()


def test_the_results_are_of_this_suite():
    scores = json.loads((RESULTS / "suite.json").read_text())["scores"]
    assert (scores["version"], scores["problems"]) == (VERSION, len(load_suite()))
    outcomes = suite_tables.OUTCOMES
    assert all(sum(row["counts"][outcome] for outcome in outcomes) == scores["problems"] for row in scores["rows"])
