"""The page of the measures of quality is that of its committed results."""

import json

from benchmarks.page import quality_tables
from benchmarks.readme import RESULTS


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "quality.json").read_text())
    assert quality_tables.page(report) == (RESULTS / "quality.md").read_text()
