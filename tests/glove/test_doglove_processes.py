"""DOGlove's servos let go whoever dies: real processes, on two pseudo-terminals, with servos of either kind."""

import contextlib
import os
import signal
import time

import numpy as np
import pytest

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import TorqueLaw
from jaxgrasp.glove.loop.glove_process import GloveProcess
from jaxgrasp.glove.other_devices.doglove import ACCEPTANCE, doglove
from jaxgrasp.glove.substitution import Sensations

if os.name != "posix":
    pytest.skip("the simulated glove needs pseudo-terminals", allow_module_level=True)
from tests.glove.doglove_hardware import Hardware

pytestmark = [pytest.mark.slow, pytest.mark.always, pytest.mark.realtime]
CHANNELS = len(doglove().joints)
BUZZES = Sensations(np.full(5, 0.6), np.zeros(5))


@pytest.fixture(params=["limp", "holds"])
def hardware(tmp_path, request):
    made = Hardware(tmp_path, request.param)
    made.start()
    yield made
    made.is_over = True
    made.join()


@pytest.fixture
def glove(hardware):
    options = {"device": "doglove", "joints_from": str(hardware.board.link), "scale": 1.0, "ramp": 0.2}
    with GloveProcess(str(hardware.servos.link), CHANNELS, **options) as made:
        yield made


def push(glove, until, seconds=10.0, say=""):
    """Send fresh forces until something is so; with ``say``, arm the glove again each time it lets go."""
    give_up = time.perf_counter() + seconds
    while not until(glove.state()) and time.perf_counter() < give_up:
        state = glove.state()
        if state is not None and np.all(np.isfinite(state.angles)):
            torques, slope = np.full(CHANNELS, 0.1), np.zeros((CHANNELS, CHANNELS))
            glove.write(TorqueLaw(time.perf_counter(), True, state.angles, torques, slope, BUZZES))
            if say and state.guard != GuardState.ARMED and state.link == LinkState.LINKED:
                with contextlib.suppress(ValueError):
                    glove.arm(say)
        time.sleep(0.005)
    return until(glove.state())


def vibrating(hardware) -> list[int]:
    """Waveform that the board plays on each channel."""
    return [wave for wave, _ in hardware.glove.board.waves]


@pytest.mark.parametrize("end", ["SIGKILL", "SIGTERM", "SIGSTOP", "engine", "close"])
def test_torque_ends_whoever_ends(hardware, glove, end):
    assert push(glove, lambda state: state is not None and state.link == LinkState.LINKED)
    assert push(glove, lambda _: hardware.glove.held() > 200, say=ACCEPTANCE)
    assert push(glove, lambda _: vibrating(hardware) == [49] * 5)
    since = time.perf_counter()
    if end.startswith("SIG"):
        glove.child.process.send_signal(getattr(signal, end))
    elif end == "close":
        glove.close()
    time.sleep(0.8)
    assert hardware.glove.held() == 0
    assert vibrating(hardware) == [0] * 5, "whoever ends, somebody silences the board"
    # A servo that holds its position after its watchdog waits for the release program, which takes 0.1 s of silence.
    holds = hardware.glove.chain.servos[0].stops == "holds"
    allowed = 0.055 + (0.1 if end == "SIGSTOP" and holds else 0.0)
    assert hardware.held_at - since < allowed + 0.1, "a tenth of a second for processes that must wait their turn"
    if end == "SIGSTOP":
        glove.child.process.send_signal(signal.SIGCONT)
        push(glove, lambda _: False, 0.5)
        assert hardware.glove.held() == 0 and glove.state().guard == GuardState.LATCHED
