"""OpenGloves' driver: limits go to its force-feedback pipe, joints to its input pipe, from nothing but the formats."""

import ctypes
import math
import os
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.line import LineError, PipeLine
from jaxgrasp.glove.model import FINGERS, FIST, lrp_hand_master, lucidgloves
from jaxgrasp.glove.other_devices.lucidgloves import ACCEPTANCE
from jaxgrasp.glove.other_devices.opengloves import OpenGlovesHost, encode_input, force_pipe, input_pipe
from jaxgrasp.glove.simulated.simulation import MemoryLine
from tests.glove import simulated_openxr as client
from tests.glove.fuzz import fuzz_opengloves

HALF = {
    joint: 0.5 * math.radians(FIST.get(joint, FIST.get(joint.split()[1], 0)))
    for joint in (
        "thumb MP",
        "thumb IP",
        *(f"{finger} {kind}" for finger in FINGERS[1:] for kind in ("MP", "PIP", "DIP")),
    )
}


class Curls(ctypes.LittleEndianStructure):
    """What the driver reads from its force-feedback pipe."""

    _fields_ = [(name, ctypes.c_short) for name in ("thumb", "index", "middle", "ring", "pinky")]


class Input(ctypes.LittleEndianStructure):
    """What the driver reads from its input pipe, version 2."""

    _fields_ = [
        ("flexion", ctypes.c_float * 4 * 5),
        ("splay", ctypes.c_float * 5),
        ("joystick", ctypes.c_float * 2),
        ("buttons", ctypes.c_bool * 8),
        ("trigger", ctypes.c_float),
    ]


class Driver:
    """The driver's end: the glove holds the curls that came last."""

    def __init__(self) -> None:
        self.curls, self.read = [9] * 5, 0

    def take(self, data: bytes) -> None:
        size = ctypes.sizeof(Curls)
        assert len(data) % size == 0
        for start in range(0, len(data), size):
            curls = Curls.from_buffer_copy(data[start : start + size])
            self.curls = [getattr(curls, name) for name, _ in Curls._fields_]
            self.read += 1


class Bench:
    def __init__(self):
        self.pipe, self.records, self.driver, self.now = MemoryLine(115_200), MemoryLine(115_200), Driver(), 0.0
        model = lucidgloves()
        self.host = OpenGlovesHost(model, lambda: self.pipe, lambda: self.records, Guard(model, ramp=0.01))
        self.is_tracked = True

    def turn(self, torque: float, times: int = 1, slope: float = 0.0) -> None:
        for _ in range(times):
            self.now += 0.005
            if self.is_tracked:
                self.records.to_host += client.line(self.now, client.joints(HALF))
            reading = self.host.poll(self.now)
            self.host.send(self.now, np.full(5, torque), reading.angles_at, slope * np.eye(5))
            self.driver.take(bytes(self.pipe.to_device))
            self.pipe.to_device.clear()

    def armed(self) -> "Bench":
        self.turn(0.1, 3)
        assert self.driver.curls == [0] * 5
        self.host.arm(self.now, ACCEPTANCE)
        self.turn(0.1, 20)
        return self


def test_a_half_closed_hand_is_stopped_where_it_is():
    bench = Bench().armed()
    np.testing.assert_allclose(bench.host.reading.angles, 0.5 * np.array(bench.host.model.spans), atol=1e-6)
    np.testing.assert_allclose(bench.driver.curls, 500, atol=1)
    assert bench.host.guard.state == GuardState.ARMED and bench.host.state == LinkState.ARMED
    # A spring of 2 N.m/rad that is 0.1 rad deep stops the finger at its surface, 0.1 rad before.
    bench.turn(0.2, 20, slope=2.0)
    expected = 1000 * (0.5 + 0.1 / np.array(bench.host.model.spans))
    np.testing.assert_allclose(bench.driver.curls, expected, atol=2)


FAULTS = {
    "hand lost": lambda bench: setattr(bench, "is_tracked", False),
    "records gone": lambda bench: setattr(bench.records, "is_plugged", False),
    "stopped": lambda bench: bench.host.stop(bench.now),
    "disarmed": lambda bench: bench.host.disarm(),
    "held up": lambda bench: setattr(bench, "now", bench.now + 0.3),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fingers_are_freed_within_55_ms(fault):
    bench = Bench().armed()
    since = bench.now + (0.3 if fault == "held up" else 0.0)
    FAULTS[fault](bench)
    while any(bench.driver.curls) and bench.now < since + 1.0:
        bench.turn(0.1)
    assert bench.now - since <= 0.055 + 1e-9 and bench.host.is_free
    bench.turn(0.1, 10)
    assert bench.driver.curls == [0] * 5


def test_no_number_frees_and_closing_frees():
    bench = Bench().armed()
    bench.turn(math.nan)
    assert bench.driver.curls == [0] * 5 and bench.host.guard.state == GuardState.LATCHED
    bench = Bench().armed()
    bench.host.close(bench.now)
    bench.driver.take(bytes(bench.pipe.to_device))
    assert bench.driver.curls == [0] * 5 and bench.host.is_free
    with pytest.raises(ValueError, match="repeat the sentence"):
        Bench().host.arm(0.0, "yes")
    with pytest.raises(ValueError, match="cannot be armed: not opened yet"):
        Bench().host.arm(0.0, ACCEPTANCE)
    with pytest.raises(ValueError, match="the model has 14 channels: expected 5"):
        OpenGlovesHost(lrp_hand_master(), lambda: bench.pipe, lambda: bench.pipe, Guard(lrp_hand_master()))


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=8), st.floats(-1e300, 1e300))
def test_what_leaves_is_bounded(torques, slope):
    bench = Bench().armed()
    for torque in torques:
        bench.turn(torque, 2, slope)
        assert all(0 <= curl <= 1000 for curl in bench.driver.curls)
        assert bench.host.guard.state == GuardState.ARMED or bench.driver.curls == [0] * 5


def test_spoilt_records_move_no_limit():
    faults, accepted, wrong = fuzz_opengloves(3_000, 0)
    assert faults > 500 and accepted > 2_200 and wrong == 0


@pytest.mark.slow
def test_of_many_spoilt_records_none_moves_a_limit():
    faults, accepted, wrong = fuzz_opengloves(200_000, 1)
    assert faults > 39_000 and accepted > 150_000 and wrong == 0


def test_the_input_pipes_structure():
    joints = {"index PIP": math.radians(50), "thumb IP": math.radians(80), "ring abduction": 1.0, "middle MP": math.nan}
    data = encode_input(joints)
    assert len(data) == ctypes.sizeof(Input)
    read = Input.from_buffer_copy(data)
    assert [list(finger) for finger in read.flexion] == [
        [0, 0, 1, 0],
        [0, 0, 0.5, 0],
        [0, 0, 0, 0],
        [0, 0, 0, 0],
        [0, 0, 0, 0],
    ]
    assert list(read.splay) == [0, 0, 0, 1, 0] and read.trigger == 0 and not any(read.buttons)
    assert force_pipe() == r"\\.\pipe\vrapplication\ffb\curl\right"
    assert input_pipe("left") == r"\\.\pipe\vrapplication\input\glove\v2\left"


@pytest.mark.skipif(os.name != "posix", reason="named pipes of a file system stand in for those of Windows")
def test_a_pipe_carries_what_is_written(tmp_path):
    path = tmp_path / "pipe"
    with pytest.raises(LineError, match="cannot be opened: No such file"):
        PipeLine(str(path), writes=True)
    os.mkfifo(path)
    with pytest.raises(LineError, match="cannot be opened"):
        PipeLine(str(path), writes=True)
    driver, came = Driver(), threading.Event()

    def read() -> None:
        with open(path, "rb") as stream:
            came.set()
            driver.take(stream.read())

    thread = threading.Thread(target=read)
    thread.start()
    line = None
    while line is None:
        try:
            line = PipeLine(str(path), writes=True)
        except LineError:
            came.wait(0.01)
    assert OpenGlovesHost.free(line)
    line.close()
    thread.join()
    assert driver.curls == [0] * 5 and driver.read == 3
