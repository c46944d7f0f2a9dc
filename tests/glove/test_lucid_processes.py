"""A device without a watchdog is freed whoever dies: real processes, on a pseudo-terminal, with the firmware's ways."""

import contextlib
import os
import re
import signal
import subprocess
import threading
import time

import numpy as np
import pytest

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.model import lucidgloves
from jaxgrasp.glove.other_devices.lucidgloves import ACCEPTANCE

if os.name != "posix":
    pytest.skip("the simulated firmware needs pseudo-terminals", allow_module_level=True)
from jaxgrasp.glove.simulated.simulator_process import PseudoTerminal

pytestmark = [pytest.mark.slow, pytest.mark.always, pytest.mark.realtime]


class Firmware(threading.Thread):
    """Says its curls, waits for an answer, and does what it says until there is another."""

    def __init__(self, path):
        super().__init__(daemon=True)
        self.terminal = PseudoTerminal(path, 115_200)
        self.terminal.plug()
        self.servos, self.over, self.plugged = [0] * 5, False, True
        self.held_at = 0.0

    def run(self) -> None:
        buffer, waits = b"", False
        while not self.over:
            timestamp = time.perf_counter()
            if not self.plugged:
                self.terminal.unplug()
                while not self.plugged and not self.over:
                    time.sleep(0.001)
                self.terminal.plug()
                buffer, waits = b"", True
            if not waits:
                self.terminal.queue(b"A2047B2047C2047D2047E2047\n")
                waits = True
            self.terminal.write(timestamp)
            *lines, buffer = (buffer + self.terminal.read(timestamp)).split(b"\n")
            for line in lines:
                if len(line) >= 5:
                    # A line without letters, as of legacy encoding, names no finger.
                    self.servos = [int(part) for part in re.split(b"[A-E]", line)[1:]] or [0] * 5
                    waits = False
            if any(self.servos):
                self.held_at = timestamp
            time.sleep(0.001)
        self.terminal.unplug()


@pytest.fixture
def firmware(tmp_path):
    made = Firmware(tmp_path / "port")
    made.start()
    yield made
    made.over = True
    made.join()


@pytest.fixture
def glove(firmware):
    with GloveProcess(str(firmware.terminal.link), 5, device="lucidgloves", scale=1.0, ramp=0.2) as made:
        yield made


def push(glove, until, seconds=10.0, say=""):
    """Send fresh forces until something is so.

    With ``say``, the glove is armed again each time it lets go, as it does on a machine that is busy for 30 ms.
    """
    give_up = time.perf_counter() + seconds
    while not until(glove.state()) and time.perf_counter() < give_up:
        state = glove.state()
        if state is not None and np.all(np.isfinite(state.angles)):
            glove.write(TorqueLaw(time.perf_counter(), True, state.angles, np.full(5, 0.1), np.eye(5)))
            if say and state.guard != GuardState.ARMED:
                with contextlib.suppress(ValueError):
                    glove.arm(say)
        time.sleep(0.005)
    return until(glove.state())


@pytest.mark.parametrize("end", ["SIGKILL", "SIGTERM", "SIGSTOP", "engine", "close", "release", "release and SIGKILL"])
def test_it_is_freed_whoever_ends(firmware, glove, end):
    model = lucidgloves()
    assert push(glove, lambda state: state is not None and state.link == LinkState.LINKED)
    np.testing.assert_allclose(glove.state().angles, 2047 / 4095 * np.array(model.spans))
    push(glove, lambda _: False, 0.1)
    with pytest.raises(ValueError, match="to arm it, repeat the sentence"):
        glove.arm()
    assert push(glove, lambda _: min(firmware.servos) > 0, say=ACCEPTANCE)
    since = time.perf_counter()
    if end.startswith("release"):
        subprocess.run(["pkill", "-9", "-f", f"loop.release.*{firmware.terminal.link}"], check=True)
        push(glove, lambda _: False, 0.3)
    if "SIG" in end:
        glove.child.process.send_signal(getattr(signal, end.split()[-1]))
    elif end == "close":
        glove.close()
    time.sleep(1.0)
    assert firmware.servos == [0] * 5
    allowed = 0.055 + (0.1 if end == "SIGSTOP" else 0.0)
    assert firmware.held_at - since < allowed + 0.1, "a tenth of a second for processes that must wait their turn"
    if end == "SIGSTOP":
        glove.child.process.send_signal(signal.SIGCONT)
        push(glove, lambda _: False, 0.5)
        assert firmware.servos == [0] * 5 and glove.state().guard == GuardState.LATCHED


@pytest.mark.parametrize("end", ["SIGTERM", "SIGHUP", "SIGKILL", "close"])
def test_what_ends_while_the_cable_is_out_is_freed_once_it_is_back(firmware, glove, end):
    assert push(glove, lambda _: min(firmware.servos) > 0, say=ACCEPTANCE)
    firmware.plugged = False
    time.sleep(0.3)
    if end == "close":
        glove.close()
    else:
        glove.child.process.send_signal(getattr(signal, end))
    time.sleep(0.3)
    assert min(firmware.servos) > 0, "nobody can reach it"
    firmware.plugged = True
    give_up = time.perf_counter() + 5
    while any(firmware.servos) and time.perf_counter() < give_up:
        time.sleep(0.05)
    assert firmware.servos == [0] * 5
