"""The sphere trees' page is that of its committed results."""

import json

from benchmarks.page import tree_tables
from benchmarks.readme import RESULTS


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "sphere_trees.json").read_text())
    assert tree_tables.page(report) == (RESULTS / "sphere_trees.md").read_text()
