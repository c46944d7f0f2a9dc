"""The teleoperation's benchmark: its page is that of the committed results, which keep what was asked."""

import json

import pytest

from benchmarks import teleop
from benchmarks.page import teleop_tables
from benchmarks.readme import RESULTS

REPORT = json.loads((RESULTS / "teleop.json").read_text())


def test_the_page_is_that_of_the_committed_results():
    assert teleop_tables.page(REPORT) == (RESULTS / "teleop.md").read_text()


def test_what_is_committed_keeps_its_limits():
    rows = REPORT["peg"]
    assert len({row["seed"] for row in rows}) == 100
    assert teleop_tables.peak_reduction(rows, "fingers and wrist") > 0.3
    assert teleop_tables.peak_reduction(rows, "fingers") > 0.15
    done = {felt: sum(row["is_success"] for row in rows if row["felt"] == felt) for felt in teleop.FELT}
    assert min(done["fingers and wrist"], done["fingers"]) >= 95 > done["nothing"]
    assert REPORT["picture"]["seed"] == REPORT["film"]["seed"] == teleop.FILMED_SEED
    trials = [row for section in ("peg", "delayed_peg", "delayed_stack") for row in REPORT.get(section, [])]
    assert min(row["least_net_energy"] for row in trials) >= -1e-3


@pytest.mark.slow
def test_in_short():
    """A small version of what takes long."""
    pytest.importorskip("mujoco")
    facts = teleop.passivity(teleop.QUICK)
    assert -1 <= facts["controlled_mJ"] <= 0 and facts["free_mJ"] < facts["controlled_mJ"]
    rows = teleop.retargeting(teleop.QUICK)
    assert [row["method"] for row in rows[:2]] == ["damped least squares", "dex-retargeting's objective"]
    assert rows[0]["error_mm"] < 12
