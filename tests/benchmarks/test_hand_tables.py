"""The virtual hand's page is that of its committed results."""

import json

from benchmarks.page import hand_tables
from benchmarks.readme import RESULTS


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "virtual_hand.json").read_text())
    assert hand_tables.page(report) == (RESULTS / "virtual_hand.md").read_text()
