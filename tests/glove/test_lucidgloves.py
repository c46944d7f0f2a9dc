"""LucidGloves: what they say is read or refused, and what they are told is within bounds, and zero after a fault."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.line import LineError
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.other_devices.lucidgloves import ACCEPTANCE, LucidHost, limits_for, lucidgloves, read_line
from jaxgrasp.glove.simulated.slow_line import MemoryLine
from jaxgrasp.hand import human_hand

SAID = b"A0B1023C2047D3071E4095F2047G2048P0IL(AB)100(BB)200(CB)300(DB)400(EB)4095(BAA)10(EAD)4095"


def host(**options) -> tuple[LucidHost, MemoryLine]:
    line = MemoryLine(115_200)
    return LucidHost(line, Guard(lucidgloves(), ramp=0.01), **options), line


def firmware(line: bytes, servos: list[int]) -> None:
    """What the firmware does with an answer: the first of each letter, missing ones for 0, no check of anything."""
    if len(line) < 5:
        return
    for k, name in enumerate(b"ABCDE"):
        at = line.find(bytes([name]))
        digits = b""
        while at >= 0 and (rest := line[at + 1 + len(digits) :])[:1].isdigit():
            digits += rest[:1]
        servos[k] = int(digits or b"0")


def test_what_it_says():
    found = read_line(SAID, 4095)
    np.testing.assert_allclose(found.curls, np.array([0, 1023, 2047, 3071, 4095]) / 4095)
    np.testing.assert_allclose(found.splays, np.array([100, 200, 300, 400, 4095]) / 4095)
    assert found.joints == {"index 1": 10 / 4095, "little 4": 1.0}
    assert found.joystick == (2047 / 4095, 2048 / 4095) and found.trigger == 0
    assert found.buttons == {"trigger", "grab"}
    plain = read_line(b"A0B0C0D0E1023", 1023)
    assert plain.curls[4] == 1 and np.all(np.isnan(plain.splays)) and not plain.buttons


@pytest.mark.parametrize(
    "line", [b"", b"A1B2C3D4", b"A1B2C3D4E", b"A1B2C3D4E4096", b"A1B2C3D4E5Q", b"A1 B2C3D4E5", b"A1B2C3D4E-5", b"x"]
)
def test_what_says_nothing(line):
    assert read_line(line, 4095) is None


@settings(max_examples=300, deadline=None)
@given(st.lists(st.binary(max_size=700), max_size=6))
def test_any_bytes_are_survived(parts):
    glove, line = host()
    for part in parts:
        line.to_host += part
        glove.poll(1.0)
        assert len(glove._kept) <= 512
        glove.send(1.0, np.zeros(5))
    line.to_host += b"\n" + SAID + b"\n"
    assert np.all(np.isfinite(glove.poll(1.0).curls))


def test_the_limit_follows_torque_and_curl():
    curls = np.array([0.0, 0.5, 0.5, 0.5, 1.0])
    assert limits_for(np.array([1.0, 1.0, 0.5, 0.0, 1.0]), curls, 0.2) == (1000, 500, 400, 0, 0)
    shares = np.linspace(0.01, 1, 50)
    limits = [limits_for(np.full(5, share), curls, 0.3)[1] for share in shares]
    assert limits == sorted(limits)


def test_it_is_armed_only_in_so_many_words():
    glove, line = host()
    with pytest.raises(ValueError, match="its user says: 'I accept"):
        glove.arm(0.0, "yes")
    with pytest.raises(ValueError, match="says nothing"):
        glove.arm(0.0, ACCEPTANCE)
    line.to_host += SAID + b"\n"
    glove.poll(0.0)
    assert glove.send(0.0, np.full(5, 0.1)) == (0, 0, 0, 0, 0)
    glove.arm(0.0, ACCEPTANCE)
    assert glove.guard.state == GuardState.ARMED


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=20), st.floats(0.01, 1))
def test_what_leaves_is_bounded_and_free_after_a_fault(wanted, give):
    glove, line = host(give=give)
    line.to_host += SAID + b"\n"
    glove.poll(0.0)
    glove.arm(0.0, ACCEPTANCE)
    for k, torque in enumerate(wanted, 1):
        now, servos = 0.004 * k, [7] * 5
        line.to_host += SAID + b"\n"
        glove.poll(now)
        limits = glove.send(now, np.full(5, torque))
        firmware(bytes(line.to_device).strip(b"\n"), servos)
        line.to_device.clear()
        assert tuple(servos) == limits and all(0 <= limit <= 1000 for limit in limits)
        if glove.guard.state != GuardState.ARMED:
            assert limits == (0,) * 5
    assert (glove.guard.state == GuardState.ARMED) == bool(np.all(np.isfinite(wanted)))


def test_each_line_is_answered_once_and_closing_frees():
    glove, line = host()
    for _ in range(3):
        line.to_host += SAID + b"\n" + SAID + b"\n"
        glove.poll(0.0)
        glove.send(0.0, np.zeros(5))
        glove.send(0.0, np.zeros(5))
    assert bytes(line.to_device) == b"A0B0C0D0E0\n" * 3
    line.to_device.clear()
    glove.close()
    assert bytes(line.to_device) == b"\nA0B0C0D0E0\n" * 3
    gone, line = host()
    line.is_plugged = False
    with pytest.raises(LineError):
        gone.poll(0.0)
    gone.close()


def test_limits_end_though_the_last_answer_was_lost():
    """The firmware waits for an answer that never comes; what frees it comes without being asked for."""
    glove, line = host()
    servos = [7] * 5
    for k in range(20):
        line.to_host += SAID + b"\n"
        glove.poll(0.005 * k)
        if k == 1:
            glove.arm(0.005 * k, ACCEPTANCE)
        limits = glove.send(0.005 * k, np.full(5, 0.1))
    line.to_device.clear()
    assert any(limits), "and this answer is lost"
    for k in range(20, 60):
        glove.poll(0.005 * k)
        limits = glove.send(0.005 * k, np.full(5, 0.1))
        for one in bytes(line.to_device).split(b"\n"):
            firmware(one, servos)
        line.to_device.clear()
    assert glove.guard.state == GuardState.LATCHED and limits == (0,) * 5 and servos == [0] * 5
    line.to_host += SAID + b"\n"
    glove.poll(1.0)
    glove.send(1.0, np.zeros(5))
    line.to_device.clear()
    glove.send(1.0, np.zeros(5))
    assert not line.to_device, "once it has answered, all is said"


def test_its_channels_are_joints_of_the_hand(unchecked):
    assert set(lucidgloves().joints) <= set(human_hand().joints)
    with pytest.raises(ValueError, match="the model has 14 channels: expected 5"):
        LucidHost(MemoryLine(9600), Guard(lrp_hand_master()))
    for change, message in (({"full_scale": 0}, "full_scale is 0"), ({"give": 2.0}, "give is 2.0: expected 0 to 1")):
        with pytest.raises(ValueError, match=message):
            host(**change)
