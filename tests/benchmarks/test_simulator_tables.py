"""The simulated hands' benchmark: its page is that of the committed results; in short it runs."""

import contextlib
import io
import json

import numpy as np
import pytest

from benchmarks import simulators
from benchmarks.page import simulator_tables
from benchmarks.readme import RESULTS

REPORT = json.loads((RESULTS / "simulators.json").read_text())


def test_the_page_is_that_of_the_committed_results():
    assert simulator_tables.page(REPORT) == (RESULTS / "simulators.md").read_text()


def test_what_is_committed_is_of_every_world():
    times, worlds = REPORT["times"], REPORT["plan"]["worlds"]
    assert worlds == 4096 and sum(times["contacts"]) == worlds and times["dropped"] == 0
    assert 0.2 * worlds < times["held"] < 0.95 * worlds and abs(times["held"] - times["positive_margins"]) <= 4
    assert times["median_s"].keys() == simulator_tables.ROWS.keys()


@pytest.mark.slow
def test_in_short():
    """A small version of what takes long."""
    pytest.importorskip("mujoco")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        pytest.importorskip("mujoco_warp", reason="pip install 'jaxgrasp[warp]'")
    times = simulators.times(simulators.QUICK)
    assert sum(times["contacts"]) == simulators.QUICK.worlds and np.isfinite(list(times["median_s"].values())).all()
    assert times["held"] == times["positive_margins"] > 0
