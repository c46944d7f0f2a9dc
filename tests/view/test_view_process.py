"""The page beside a loop: it may die, and no tick is late; it ends with whoever started it."""

import os
import signal
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest

from jaxgrasp.glove.loop.rendering import TickTimes
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.lab.felt_objects import felt_object
from jaxgrasp.psychophysics.plan import StimulusPlan
from jaxgrasp.view.view_slots import TRIAL, TrialState, ViewFeed, ViewFrame
from jaxgrasp.view.viewed_person import Phase

pytest.importorskip("viser", reason="the live scene needs viser")
pytestmark = pytest.mark.slow
MODEL = lrp_hand_master()
CHANNELS = len(MODEL.joints)
LATE = 0.03
"""What a glove waits for a law at most [s]."""


def feed_of(kind: str = "weight") -> ViewFeed:
    shown = {"felt": felt_object(StimulusPlan(kind), MODEL), "model": MODEL, "kind": kind}
    return ViewFeed(CHANNELS, TRIAL, shown, (0, 0))


def frame(timestamp: float) -> ViewFrame:
    bent = np.full(CHANNELS, 0.3 * (1 + np.sin(3 * timestamp)))
    trial = TrialState(float(Phase.FEELS), 2.0, 30.0, 1.0, 1.5, 1.0)
    return ViewFrame(timestamp, 3, 1, bent, 0.1 * bent, 0.1 * bent, trial.vector())


def ticks(feed: ViewFeed, seconds: float, rate: float = 100.0) -> TickTimes:
    """Run a loop that only sends frames to the page; return its tick times."""
    times, worst = TickTimes(1 / rate), 0.0
    due, end = time.perf_counter(), time.perf_counter() + seconds
    while (start := time.perf_counter()) < end:
        feed.write(frame(start))
        over = time.perf_counter()
        worst = max(worst, over - start)
        times.add(start - due, over - start)
        due = max(due + times.period, over)
        time.sleep(max(0.0, due - time.perf_counter()))
    assert worst < LATE, f"a frame took {1e3 * worst:.1f} ms to write"
    return times


@pytest.mark.realtime
def test_a_page_that_stops_or_is_killed_holds_nothing_up():
    with feed_of() as feed:
        assert len(feed.addresses) == 2
        ticks(feed, 1.0)
        for address in feed.addresses:
            assert urllib.request.urlopen(address, timeout=10).status == 200
        # One that hangs is no better than one that is dead.
        os.kill(feed.process_id, signal.SIGSTOP)
        ticks(feed, 2.0)
        os.kill(feed.process_id, signal.SIGKILL)
        counted = ticks(feed, 2.0)
        assert counted.summary()["turns"] > 100


STARTS = """
import sys, time
from tests.view.test_view_process import feed_of
feed = feed_of("torque")
print(feed.process_id, *feed.addresses, flush=True)
time.sleep(600)
"""


def test_it_ends_with_whoever_started_it_and_a_port_in_use_is_said():
    parent = subprocess.Popen([sys.executable, "-c", STARTS], stdout=subprocess.PIPE, text=True)
    try:
        process, person, _ = parent.stdout.readline().split()
        port = int(person.rpartition(":")[2])
        with pytest.raises(OSError, match=f"port {port} of 127.0.0.1 is in use"):
            ViewFeed(CHANNELS, TRIAL, {}, (port,))
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()
    for _ in range(200):
        if not alive(int(process)):
            return
        time.sleep(0.05)
    raise AssertionError("the page outlives its loop")


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{process}/stat") as file:
        return file.read().rpartition(")")[2].split()[0] != "Z"
