"""The page of compiling is that of its committed results, and its ratios are those of its figures."""

import json

from benchmarks.page import compile_tables
from benchmarks.readme import RESULTS


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "compile.json").read_text())
    assert compile_tables.page(report) == (RESULTS / "compile.md").read_text()


def test_each_call_stands_beside_what_it_was():
    rows = [
        {"call": "closed_form", "batch": 1, "version": version, "inside": inside, "alone": alone, "fusions": fusions}
        for version, inside, alone, fusions in (("before", 4.0, 5.0, 80), ("after", 3.0, 2.0, 60))
    ]
    machine = json.loads((RESULTS / "compile.json").read_text())["machine"]
    page = compile_tables.page({"machine": machine, "programs": rows})
    assert "| closed_form | 1 | 4.0 | 3.0 | 0.75 | 5.0 | 2.0 | 0.40 | 80 | 60 |" in page
