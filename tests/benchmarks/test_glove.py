"""The glove's benchmark: its page is that of the committed results, and a small version of it holds every promise."""

import json
import os

import pytest

from benchmarks import glove
from benchmarks.page import glove_tables
from benchmarks.readme import RESULTS


def test_the_page_is_that_of_the_committed_results():
    report = json.loads((RESULTS / "glove.json").read_text())
    assert glove_tables.page(report) == (RESULTS / "glove.md").read_text()


def test_a_bad_line_in_short():
    counts = glove.frames(glove.QUICK)
    assert counts["wrong"] == 0 and counts["adds_up"] and counts["stale"] == 0
    assert counts["faults"] > 3000 and 0 <= counts["lost_of_good"] <= counts["faults"]


def test_rubbish_in_short():
    rows = glove.rubbish(glove.QUICK)
    assert len(rows) == 6 and all(row["most_kept"] <= 512 for row in rows)


@pytest.mark.slow
def test_faults_while_delays_drift_in_short():
    rows = glove.drifting_faults(glove.QUICK)
    assert len(rows) >= 10 and all(0 <= max(row["milliseconds"]) <= 55 for row in rows)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals")
def test_the_rest_in_short():
    """On whatever machine this runs: frames are all accounted for, and what latched stays so; times are not judged."""
    relinks = glove.relinks(glove.QUICK)
    assert relinks["latched"] and max(relinks["milliseconds"]) < 2000
    long = glove.long_run(glove.QUICK)
    assert long["grown_megabytes"]["host"] < 5
    assert long["device"]["missing"] == long["device"]["stale"] == long["device"]["refused"] == 0
    assert long["device_frames"]["missing"] == 0
