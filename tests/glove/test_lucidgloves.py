"""LucidGloves: what they say is read or refused, and what they are told is within bounds, and zero after a fault."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.model import FIST, lrp_hand_master, lucidgloves
from jaxgrasp.glove.other_devices.lucidgloves import ACCEPTANCE, LucidHost, read_line, stops_at
from jaxgrasp.glove.simulated.simulation import MemoryLine
from jaxgrasp.hand import human_hand

LINE = b"A0B1023C2047D3071E4095F2047G2048P0IL(AB)100(BB)200(CB)300(DB)400(EB)4095(BAA)10(EAD)4095"


def host(**options) -> tuple[LucidHost, MemoryLine]:
    line = MemoryLine(115_200)
    model = lucidgloves()
    return LucidHost(model, lambda: line, Guard(model, ramp=0.01), **options), line


def turn(glove: LucidHost, timestamp: float, torque: float, slope: float = 0.0):
    """Return the limits after a turn in which all fingers are to resist by a torque."""
    reading = glove.poll(timestamp)
    glove.send(timestamp, np.full(5, torque), reading.angles_at, slope * np.eye(5))
    return glove.limits


def firmware(line: bytes, servos: list[int]) -> None:
    """Apply a line as the firmware does: the first value of each letter, 0 for missing ones, no check of anything."""
    if len(line) < 5:
        return
    for k, name in enumerate(b"ABCDE"):
        at = line.find(bytes([name]))
        digits = b""
        while at >= 0 and (digits_left := line[at + 1 + len(digits) :])[:1].isdigit():
            digits += digits_left[:1]
        servos[k] = int(digits or b"0")


def test_what_it_says():
    reading = read_line(LINE, 4095)
    np.testing.assert_allclose(reading.curls, np.array([0, 1023, 2047, 3071, 4095]) / 4095)
    np.testing.assert_allclose(reading.splays, np.array([100, 200, 300, 400, 4095]) / 4095)
    assert reading.joints == {"index 1": 10 / 4095, "little 4": 1.0}
    assert reading.joystick == (2047 / 4095, 2048 / 4095) and reading.trigger == 0
    assert reading.buttons == {"trigger", "grab"}
    for full_scale in (1023, 4095):
        line = f"A0B{full_scale}C0D0E0P{full_scale + 1}".encode()
        assert read_line(line, full_scale).trigger == 1
        assert read_line(f"A0B{full_scale + 1}C0D0E0P0".encode(), full_scale) is None
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
        turn(glove, 1.0, 0.0)
        assert len(glove._buffer) <= 512
    line.to_host += b"\n" + LINE + b"\n"
    assert np.all(np.isfinite(glove.poll(1.0).angles)) and glove.state == LinkState.LINKED


def legacy_firmware(line: bytes, servos: list[int]) -> None:
    """Apply a line as the firmware of legacy encoding does: up to five numbers between ``&``, 0 for what is none."""
    for k, part in enumerate(line.split(b"&")[:5]):
        digits = part[: len(part) - len(part.lstrip(b"0123456789"))]
        servos[k] = int(digits or b"0")


def test_the_legacy_encoding_is_read_and_answered():
    reading = read_line(b"0&1023&2047&3071&4095&2047&2048&1&0&0&1&0&1", 4095)
    np.testing.assert_allclose(reading.curls, np.array([0, 1023, 2047, 3071, 4095]) / 4095)
    assert reading.joystick == (2047 / 4095, 2048 / 4095) and reading.is_legacy
    assert reading.buttons == {"joystick", "B", "pinch"}
    for bad in ("1&2&3", "4096&0&0&0&0&0&0&0&0&0&0&0&0", "0&0&0&0&0&0&0&2&0&0&0&0&0", "0&0&0&0&0&0&0&0&0&0&0&0&0&0"):
        assert read_line(bad.encode(), 4095) is None
    for bad in (b"&" * 12, b"0&0&0&0&0&0&0&0&0&0&0&0&A", b"-1&0&0&0&0&0&0&0&0&0&0&0&0"):
        assert read_line(bad, 4095) is None
    glove, line = host()
    for k in range(20):
        line.to_host += b"0&1000&2000&3000&4000&2047&2048&0&0&0&0&0&0\n"
        if k == 1:
            glove.arm(0.005 * k, ACCEPTANCE)
        limits = turn(glove, 0.005 * k, 0.1)
    servos = [7] * 5
    legacy_firmware(bytes(line.to_device).splitlines()[-1], servos)
    assert tuple(servos) == limits and any(limits)
    line.to_device.clear()
    glove.close(1.0)
    for answer in bytes(line.to_device).split(b"\n"):
        if answer:
            legacy_firmware(answer, servos)
    assert servos == [0] * 5


def test_a_glove_that_sends_joints_without_curls_is_as_curled_as_they_are():
    parts = [f"({name}A{joint}){value}" for name in "ABCDE" for joint, value in zip("ABC", (1000, 2000, 3000))]
    reading = read_line("".join(parts).encode(), 4000)
    np.testing.assert_allclose(reading.curls, 0.5)
    assert reading.joints["ring 2"] == 0.5 and len(reading.joints) == 15
    # What has both is as curled as it says.
    assert read_line(("A4000" + "".join(parts)).encode(), 4000).curls[0] == 1.0
    assert read_line("".join(parts[:-3]).encode(), 4000) is None, "the little finger says nothing"


def test_a_finger_is_stopped_where_resistance_begins():
    curls, no = np.array([0.0, 0.5, 0.5, 0.5, 1.0]), np.zeros(5)
    assert stops_at(curls, no, np.array([1.0, 1.0, 0.5, 0.0, 1.0]), 0.2) == (1000, 500, 400, 0, 0)
    limits = [stops_at(curls, no, np.full(5, let), 0.3)[1] for let in np.linspace(0.01, 1, 50)]
    assert limits == sorted(limits)
    assert stops_at(curls, np.full(5, 0.1), np.ones(5), 0.3) == (1000, 600, 600, 600, 99)


@pytest.mark.parametrize("bent", [0.5, 0.55, 0.57])
def test_the_stop_stays_at_the_surface_however_deep_the_finger_is(bent):
    """A spring of 2 N.m/rad from half a curl on: what is asked for grows with the depth, and the stop stays."""
    glove, line = host()
    surface, stiffness = 0.45, 2.0
    depth = (bent - surface) * np.array(glove.model.spans)
    bent_line = "".join(f"{name}{round(4095 * bent)}" for name in "ABCDE").encode() + b"\n"
    for k in range(100):
        line.to_host += bent_line
        reading = glove.poll(0.01 * k)
        if k == 1:
            glove.arm(0.01 * k, ACCEPTANCE)
        glove.send(0.01 * k, stiffness * depth, reading.angles_at, stiffness * np.eye(5))
    np.testing.assert_allclose(reading.angles, bent * np.array(glove.model.spans), rtol=1e-3)
    # Torques beyond the limit of what may leave let a finger go on.
    let = np.minimum(1, np.array(glove.model.limits) / (stiffness * depth))
    expected = 1000 * (1 - surface - 0.3 * (1 - let))
    np.testing.assert_allclose(glove.limits, expected, atol=3)


def test_it_is_armed_only_in_so_many_words():
    glove, line = host()
    with pytest.raises(ValueError, match="repeat the sentence 'I accept"):
        glove.arm(0.0, "yes")
    for trouble in ("not opened yet", "the glove sends nothing"):
        with pytest.raises(ValueError, match=f"cannot be armed: {trouble}"):
            glove.arm(0.0, ACCEPTANCE)
        glove.poll(0.0)
    line.to_host += LINE + b"\n"
    assert turn(glove, 0.0, 0.1) == (0, 0, 0, 0, 0)
    glove.arm(0.0, ACCEPTANCE)
    assert glove.guard.state == GuardState.ARMED and glove.state == LinkState.ARMED
    glove.disarm()
    assert turn(glove, 0.001, 0.1) == (0, 0, 0, 0, 0) and glove.state == LinkState.LINKED


def test_the_emergency_stop_frees_all_fingers_until_it_is_armed_anew():
    glove, line = host()
    line.to_host += LINE + b"\n"
    glove.poll(0.0)
    glove.arm(0.0, ACCEPTANCE)
    for k in range(1, 20):
        line.to_host += LINE + b"\n"
        held = turn(glove, 0.01 * k, 0.1)
    assert any(held)
    line.to_device.clear()
    glove.stop(0.2)
    assert turn(glove, 0.2, 0.1) == (0, 0, 0, 0, 0) and bytes(line.to_device).startswith(b"\nA0B0C0D0E0\n")
    assert glove.guard.state == GuardState.LATCHED and "emergency stop" in glove.guard.cause
    line.to_host += LINE + b"\n"
    assert turn(glove, 0.21, 0.1) == (0, 0, 0, 0, 0)
    glove.arm(0.22, ACCEPTANCE)
    assert glove.guard.state == GuardState.ARMED


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=20),
    st.floats(0.01, 1),
    st.floats(-1e300, 1e300),
)
@example([1.0, 2e-311], 1.0, 0.0)  # less is wanted than any number can be divided by, before the guard has come down
def test_what_leaves_is_bounded_and_free_after_a_fault(torques, give, slope):
    glove, line = host(give=give)
    line.to_host += LINE + b"\n"
    glove.poll(0.0)
    glove.arm(0.0, ACCEPTANCE)
    for k, torque in enumerate(torques, 1):
        timestamp, servos = 0.004 * k, [7] * 5
        line.to_host += LINE + b"\n"
        limits = turn(glove, timestamp, torque, slope)
        firmware(bytes(line.to_device).strip(b"\n"), servos)
        line.to_device.clear()
        assert tuple(servos) == limits and all(0 <= limit <= 1000 for limit in limits)
        if glove.guard.state != GuardState.ARMED:
            assert limits == (0,) * 5
    assert (glove.guard.state == GuardState.ARMED) == bool(np.all(np.isfinite(torques)))


def test_each_line_is_answered_once_and_closing_frees():
    glove, line = host()
    for _ in range(3):
        line.to_host += LINE + b"\n" + LINE + b"\n"
        turn(glove, 0.0, 0.0)
        glove.send(0.0, np.zeros(5), 0.0)
    assert bytes(line.to_device) == b"A0B0C0D0E0\n" * 3
    line.to_device.clear()
    glove.close(0.0)
    assert bytes(line.to_device) == b"\n0&0&0&0&0\n\nA0B0C0D0E0\n" * 3, "in both encodings"


def test_a_line_that_goes_is_opened_again_and_freed_at_once():
    glove, line = host()
    line.to_host += LINE + b"\n"
    glove.poll(0.0)
    glove.arm(0.0, ACCEPTANCE)
    line.is_plugged = False
    assert turn(glove, 0.01, 0.1) == (0, 0, 0, 0, 0)
    assert glove.guard.state == GuardState.LATCHED and glove.state == LinkState.CLOSED
    assert glove.guard.cause == glove.trouble == "the line is unplugged"
    line.is_plugged = True
    assert turn(glove, 0.02, 0.1) == (0, 0, 0, 0, 0) and not line.to_device, "not yet"
    turn(glove, 0.5, 0.1)
    assert bytes(line.to_device) == b"\nA0B0C0D0E0\n" and glove.state == LinkState.GREETING
    line.to_host += LINE + b"\n"
    turn(glove, 0.6, 0.1)
    assert glove.state == LinkState.LINKED and glove.report() == {"links": 2, "refused": 0}


def test_silence_frees_it():
    glove, line = host()
    line.to_host += LINE + b"\n"
    glove.poll(0.0)
    glove.arm(0.0, ACCEPTANCE)
    for k in range(60):
        limits = turn(glove, 0.005 * k, 0.1)
    assert limits == (0, 0, 0, 0, 0) and glove.state == LinkState.GREETING and glove.trouble == "the glove fell silent"


def test_limits_end_though_the_last_answer_was_lost():
    """The firmware waits for an answer that never comes; what frees it comes without being asked for."""
    glove, line = host()
    servos = [7] * 5
    for k in range(20):
        line.to_host += LINE + b"\n"
        if k == 1:
            glove.arm(0.005 * k, ACCEPTANCE)
        limits = turn(glove, 0.005 * k, 0.1)
    line.to_device.clear()
    assert any(limits), "and this answer is lost"
    for k in range(20, 60):
        limits = turn(glove, 0.005 * k, 0.1)
        for answer in bytes(line.to_device).split(b"\n"):
            firmware(answer, servos)
        line.to_device.clear()
    assert glove.guard.state == GuardState.LATCHED and limits == (0,) * 5 and servos == [0] * 5
    line.to_host += LINE + b"\n"
    turn(glove, 1.0, 0.0)
    line.to_device.clear()
    glove.send(1.0, np.zeros(5), 1.0)
    assert not line.to_device, "once it has answered, all is said"


def test_its_channels_are_joints_of_the_hand(unchecked):
    model, hand = lucidgloves(), human_hand()
    assert set(model.joints) | {coupled_joint.joint for coupled_joint in model.coupled} == {
        joint for joint in hand.joints if "abduction" not in joint
    }
    curled = np.degrees(np.array(model.spans) @ model.transmission(hand.joints))
    for joint, angle in zip(hand.joints, curled, strict=True):
        assert angle == pytest.approx(FIST.get(joint, FIST.get(joint.split()[1], 0))), joint
    with pytest.raises(ValueError, match="the model has 14 channels: expected 5"):
        LucidHost(lrp_hand_master(), lambda: MemoryLine(9600), Guard(lrp_hand_master()))
    with pytest.raises(ValueError, match="has no spans"):
        LucidHost(replace(model, spans=None), lambda: MemoryLine(9600), Guard(model))
    for change, message in (({"full_scale": 0}, "full_scale is 0"), ({"give": 2.0}, "give is 2.0: expected 0 to 1")):
        with pytest.raises(ValueError, match=message):
            host(**change)
