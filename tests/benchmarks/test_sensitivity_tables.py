"""The page of sensitivities is that of its committed results."""

import json

from benchmarks.page import sensitivity_tables
from benchmarks.readme import RESULTS


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "sensitivity.json").read_text())
    assert sensitivity_tables.page(report) == (RESULTS / "sensitivity.md").read_text()
