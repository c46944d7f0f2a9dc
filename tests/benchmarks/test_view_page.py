"""The live scene's page is that of its committed results, and what was asked for is there."""

import json

from benchmarks.page import view_tables
from benchmarks.readme import RESULTS

REPORT = json.loads((RESULTS / "view.json").read_text())


def test_the_page_is_that_of_the_committed_results():
    assert view_tables.page(REPORT) == (RESULTS / "view.md").read_text()


def test_a_thousand_grasps_leave_nothing_behind():
    steps = REPORT["steps"]
    assert steps["grasps"] == 1000
    assert len(set(steps["messages"])) == 1
    assert steps["megabytes"][-1] - steps["megabytes"][0] < 5
