"""The pages of limited hands, of mixed batches and of other objectives are those of their committed results."""

import json

import pytest

from benchmarks.page import limited_tables, mixed_tables, objective_tables
from benchmarks.readme import RESULTS

PAGES = [("limited_hands", limited_tables), ("mixed", mixed_tables), ("objectives", objective_tables)]


@pytest.mark.parametrize(("name", "tables"), PAGES)
def test_the_page_is_that_of_the_committed_results(name, tables):
    report = json.loads((RESULTS / f"{name}.json").read_text())
    assert tables.page(report) == (RESULTS / f"{name}.md").read_text()
