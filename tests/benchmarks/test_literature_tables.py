"""The page of the literature's methods is that of its committed results."""

import json

from benchmarks.page import literature_tables
from benchmarks.readme import RESULTS


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "literature.json").read_text())
    assert literature_tables.page(report) == (RESULTS / "literature.md").read_text()
