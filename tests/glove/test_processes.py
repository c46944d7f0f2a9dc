"""The real processes, lines and clocks: torque at the device is gone in time whoever stops, dies or stalls.

These run on shared machines: what is judged is what holds torque by the device's own clock, never how fast a test is.
"""

import itertools
import os
import signal
import time

import numpy as np
import pytest

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState, read_latches
from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.simulated.simulator import Simulator, read_record

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.skipif(os.name != "posix", reason="the simulated glove needs pseudo-terminals"),
]


class Engine:
    """A spring, computed a hundred times a second for as long as it is told to."""

    def __init__(self, glove: GloveProcess):
        self.glove = glove

    def run(self, seconds: float, until=lambda state: False) -> GloveState:
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            state = self.glove.state()
            if state is not None and np.all(np.isfinite(state.angles)):
                angles = state.angles
                torques = np.maximum(0.25 * (angles - 0.2), 0)
                self.glove.write(TorqueLaw(time.perf_counter(), True, angles, torques, 0.25 * np.diag(angles > 0.2)))
                if until(state):
                    return state
            time.sleep(0.005)
        return state

    def hold(self) -> None:
        """Arm until torque flows: a busy machine may latch it on the way, which is right."""
        for _ in range(20):
            self.run(5.0, lambda state: state.link == LinkState.LINKED)
            try:
                self.glove.arm()
            except ValueError:
                continue
            state = self.run(3.0, lambda state: state.torques.min() > 0.02)
            if state.torques.min() > 0.02:
                return
        raise AssertionError(f"never armed: {self.glove.events()[-4:]}")


@pytest.fixture
def simulator(tmp_path):
    with Simulator(record=str(tmp_path / "record"), record_every=0.001) as simulator:
        simulator.order(bend=[0.6] * 14, lasts=0.3)
        yield simulator


def last_torque(path) -> float:
    """Return the time at which the device held its last torque [s]."""
    record = read_record(path)
    return float(record["time"][record["counts"].any(axis=1)][-1])


@pytest.mark.parametrize("end", ["SIGSTOP", "SIGKILL", "SIGTERM", "engine", "cut", "unplug"])
def test_torque_is_gone_in_time(simulator, tmp_path, end):
    with GloveProcess(simulator.port, 14, scale=1.0, ramp=0.2) as glove:
        engine = Engine(glove)
        engine.hold()
        since = time.perf_counter()
        if end.startswith("SIG"):
            glove.child.process.send_signal(getattr(signal, end))
        elif end != "engine":
            simulator.order(**{end: 0.3})
        time.sleep(0.3)
        assert last_torque(tmp_path / "record") - since <= 0.055 + 0.02, "20 ms for a simulator that must wait its turn"
        if end == "SIGSTOP":
            glove.child.process.send_signal(signal.SIGCONT)
        if end in ("SIGKILL", "SIGTERM"):
            return
        engine.run(3.0, lambda state: state.link == LinkState.LINKED)
        latched = time.perf_counter()
        assert engine.run(0.5).guard == GuardState.LATCHED
        assert last_torque(tmp_path / "record") < latched
        engine.hold()
    assert last_torque(tmp_path / "record") > latched
    assert glove.summary["turns"] > 100


def test_each_latch_is_on_record(simulator, tmp_path):
    path = tmp_path / "latches.jsonl"
    with GloveProcess(simulator.port, 14, scale=1.0, ramp=0.2, log=str(path)) as glove:
        engine = Engine(glove)
        for _ in range(5):
            engine.hold()
            simulator.order(press=True)
            engine.run(0.5)
            simulator.order(press=False)
            engine.run(0.2)
            # A busy machine may have let go in between, which is another cause.
            if "its emergency stop was pressed" in read_latches(path)[-1]["cause"]:
                break
        pressed = len(read_latches(path))
        engine.hold()
        glove.stop()
        engine.run(0.3)
    records, states = read_latches(path), [(event["guard"], event["cause"]) for event in glove.events()]
    assert "its emergency stop was pressed" in records[pressed - 1]["cause"]
    assert "requested at the host" in records[-1]["cause"] and len(records) > pressed
    latches = [state for before, state in itertools.pairwise(states) if state[0] == "LATCHED" and state != before]
    assert [("LATCHED", record["cause"]) for record in records] == latches
    for record in records:
        assert (
            record["turns"] > 0
            and record["overruns"] >= 0
            and record["counts"]["heard"] > 0
            and len(record["frames"]) > 10
        )
        assert record["frames"][-1]["at"] <= record["at"] + 1e-6


def test_what_cannot_be_done_is_said(simulator):
    with GloveProcess(simulator.port, 14) as glove:
        with pytest.raises(ValueError, match="the glove cannot be armed: no torque law was given"):
            glove.arm()
        with pytest.raises(ValueError, match="scale is 2"):
            glove.rescale(2.0)
    with pytest.raises(OSError, match="simulator_process ended with 1"):
        Simulator(port="/nowhere/at/all")
