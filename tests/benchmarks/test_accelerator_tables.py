"""The page of batches on a GPU is that of its committed results."""

import json

from benchmarks.page import accelerator_tables
from benchmarks.readme import RESULTS


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "accelerator.json").read_text())
    assert accelerator_tables.page(report) == (RESULTS / "accelerator.md").read_text()
