"""The pages of limited hands and of other objectives are those of their committed results."""

import json

import pytest

from benchmarks.page import limited_tables, objective_tables
from benchmarks.readme import RESULTS


@pytest.mark.parametrize(("name", "tables"), [("limited_hands", limited_tables), ("objectives", objective_tables)])
def test_the_page_is_that_of_the_committed_results(name, tables):
    report = json.loads((RESULTS / f"{name}.json").read_text())
    assert tables.page(report) == (RESULTS / f"{name}.md").read_text()
