"""A device holds no torque without a host that is alive, none above its limit; its two programs do the same."""

import ctypes
import random
import shutil
import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxgrasp.glove.protocol
from jaxgrasp.glove.protocol.device import Cause, Device, DeviceState
from jaxgrasp.glove.protocol.frames import CHANNELS, LINE_SIZE, TICKS, Flag, Frame, FrameReader, Kind, encode
from tests.glove.test_frames import vectors

FIRMWARE = Path(jaxgrasp.glove.protocol.__file__).parent / "firmware"
MS = 1000


class Host:
    """Sender of a host's frames, which numbers and times them."""

    def __init__(self, session: int = 7, number: int = 65_530):
        self.session, self.number = session, number

    def line(
        self,
        timestamp: int,
        kind: Kind,
        values: tuple[int, ...] = (),
        flags: Flag = Flag.ENABLE,
        echo: int | None = None,
    ) -> bytes:
        """Encode a frame that echoes the device's time ``echo``, by default the current one."""
        self.number = (self.number + 1) % 2**16
        echo = (timestamp if echo is None else echo) % TICKS
        return encode(
            Frame(kind, self.number, timestamp % TICKS, values + (0,) * (CHANNELS - len(values)), flags, echo)
        )

    def opening(self, device: Device, timestamp: int) -> None:
        device.receive(timestamp, self.line(timestamp, Kind.HELLO, (self.session,)))
        self.arm(device, timestamp + 1)

    def arm(self, device: Device, timestamp: int, session: int | None = None, nonce: int | None = None) -> None:
        session = self.session if session is None else session
        nonce = device.nonce if nonce is None else nonce
        device.receive(timestamp, self.line(timestamp, Kind.ARM, (session, nonce)))

    def command(self, device: Device, timestamp: int, *values: int) -> None:
        device.receive(timestamp, self.line(timestamp, Kind.COMMAND, values))


def run(device: Device, start: int, end: int) -> list[list[int]]:
    return [list(device.step(timestamp)) for timestamp in range(start, end, MS)]


def test_it_answers_arms_and_goes_where_it_is_told_at_its_rate():
    device, host = Device(), Host()
    device.step(0)
    device.receive(0, host.line(0, Kind.HELLO, (7,)))
    answer = device.answer(0)
    assert answer.kind == Kind.CAPABILITY and answer.values[:6] == (7, 14, 50, 100, 11_999, 120)
    assert answer.values[7] == 3000
    for kind in (Kind.LIMITS, Kind.CONTINUOUS):
        answer = device.answer(0)
        assert answer.kind == kind and answer.values == (11_999,) * 14
    assert device.answer(0) is None
    host.command(device, 1, 5000)
    assert device.state == DeviceState.IDLE
    host.arm(device, 2)
    host.command(device, 3, 1000, -5, 32_000)
    held = run(device, MS, 9 * MS)
    assert held[0][:3] == [120, 0, 120] and held[7][0] == 960
    assert run(device, 9 * MS, 12 * MS)[-1][:3] == [1000, 0, 1320]


@pytest.mark.parametrize("start", [0, TICKS - 20 * MS])
def test_the_watchdog_latches_in_its_time_whatever_the_clock(start):
    device, host = Device(), Host()
    device.step(start)
    host.opening(device, start)
    host.command(device, start + 2, 500)
    held = [device.step((start + t) % TICKS)[0] for t in range(MS, 60 * MS, MS)]
    assert held[:50] == [120, 240, 360, 480] + [500] * 46 and set(held[50:]) == {0}
    assert (device.state, device.cause) == (DeviceState.LATCHED, Cause.WATCHDOG)
    host.command(device, start + 61 * MS, 500)
    assert device.step(start + 62 * MS) == [0] * CHANNELS
    host.arm(device, start + 63 * MS, session=8)
    assert device.state == DeviceState.LATCHED, "another session's"
    host.arm(device, start + 64 * MS, nonce=device.nonce + 1)
    assert device.state == DeviceState.LATCHED, "not the device's own number"
    nonce = device.nonce
    host.arm(device, start + 65 * MS)
    assert device.state == DeviceState.ARMED
    device.receive(start + 66 * MS, host.line(start + 66 * MS, Kind.COMMAND, flags=Flag(0)))
    host.arm(device, start + 67 * MS, nonce=nonce)
    assert device.state == DeviceState.IDLE, "a number that has armed it once"


def test_what_zeroes_at_once():
    for end, state in (
        (lambda device, host: device.trip(Cause.OWN), DeviceState.LATCHED),
        (lambda device, host: device.trip(Cause.WATCHDOG), DeviceState.LATCHED),
        (lambda device, host: device.receive(0, host.line(9 * MS, Kind.HELLO, (9,))), DeviceState.LATCHED),
        (lambda device, host: device.receive(0, host.line(9 * MS, Kind.COMMAND, flags=Flag(0))), DeviceState.IDLE),
    ):
        device, host = Device(), Host()
        host.opening(device, 0)
        host.command(device, 2, 400)
        assert run(device, 2, 8 * MS)[-1][0] == 400
        end(device, host)
        assert device.counts == [0] * CHANNELS and device.state == state
        assert not any(map(any, run(device, 9 * MS, 20 * MS)))


def test_the_emergency_stop_latches_whatever_its_state_and_no_arm_helps_while_it_is_pressed(firmware):
    for device in (Device(seed=77), Compiled(firmware)):
        host, drawn = Host(), Device(seed=77)
        device.press(True)
        assert (device.state, device.cause) == (DeviceState.LATCHED, Cause.STOPPED), "before any host"
        for timestamp, pressed, state in ((0, True, DeviceState.LATCHED), (10 * MS, False, DeviceState.ARMED)):
            device.press(pressed)
            line = host.line(timestamp, Kind.HELLO, (7,))
            for implementation in (device, drawn):
                implementation.receive(timestamp, line)
                implementation.step(timestamp)
            device.receive(timestamp + 1, host.line(timestamp + 1, Kind.ARM, (7, drawn.nonce)))
            device.receive(timestamp + 2, host.line(timestamp + 2, Kind.COMMAND, (500,)))
            assert device.state == state
        assert any(device.step(12 * MS))
        device.press(True)
        assert device.state == DeviceState.LATCHED and not any(device.counts) and not any(device.step(13 * MS))


@pytest.mark.parametrize("late", [0, 3, -2_000_000])
def test_a_hosts_stop_is_obeyed_whatever_its_age_and_number(firmware, late):
    for device in (Device(), Compiled(firmware)):
        old = Host().line(5, Kind.STOP, echo=late)
        device.step(0)
        host = Host(number=20_000)
        device.receive(0, host.line(0, Kind.HELLO, (7,)))
        device.receive(0, old)
        assert (device.state, device.cause) == (DeviceState.LATCHED, Cause.STOPPED)
        assert not any(device.step(MS))


def test_frames_say_what_the_device_gave_up_for(firmware):
    for device in (Device(), Compiled(firmware)):
        device.press(True)
        status = device.status(5)
        frame = status if isinstance(status, Frame) else FrameReader().feed(status)[0]
        assert frame.flags == Flag.LATCHED | Flag.PRESSED and frame.cause == Cause.STOPPED
        assert frame.values[1:3] == (DeviceState.LATCHED, Cause.STOPPED)


def test_a_fault_of_its_own_latches_whatever_its_state():
    device = Device()
    device.trip(Cause.WATCHDOG)
    assert device.state == DeviceState.IDLE
    device.trip(Cause.OWN)
    assert (device.state, device.cause) == (DeviceState.LATCHED, Cause.OWN)
    device.counts = [5] * CHANNELS
    assert device.step(0) == [0] * CHANNELS, "whatever was written meanwhile"


def test_stale_repeated_and_old_sessions_frames_are_ignored():
    device, host = Device(), Host()
    host.opening(device, 0)
    lines = [host.line(10 * k, Kind.COMMAND, (k,), echo=0) for k in range(1, 6)]
    for line in (lines[0], lines[2], lines[1], lines[2], lines[4]):
        device.receive(0, line)
    assert (device.accepted, device.order.missing, device.order.stale) == (4, 2, 2)
    assert device._requested[0] == 5
    late = Host(number=host.number + 10)
    late.command(device, 2_000_000, 9)
    far = Host(number=host.number + 100)
    far.command(device, 100, 9)
    assert device._requested[0] == 5 and device.order.stale == 4
    counts = device.status(0).values
    assert counts[:3] == (7, DeviceState.ARMED, Cause.NONE) and counts[3:9:2] == (4, 2, 4)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 30_000), st.binary(max_size=80) | st.integers(-(2**15), 2**15 - 1))))
def test_bounds_hold_whatever_comes(events):
    device, host = Device(), Host()
    timestamp = 0
    device.step(timestamp)
    host.opening(device, timestamp)
    before, heard = 0, 0
    for elapsed, event in events:
        timestamp += elapsed
        if isinstance(event, bytes):
            device.receive(timestamp, event + b"\0")
        else:
            host.command(device, timestamp, event)
            heard = timestamp if device.order.newest == host.number else heard
        held = device.step(timestamp)
        assert all(0 <= count <= 11_999 for count in held)
        assert held[0] - before <= 120 * min(elapsed, 20 * MS) / 1000 + 1
        if device.state != DeviceState.ARMED or timestamp - heard > 50 * MS:
            assert held == [0] * CHANNELS
        before = held[0]


class Limits(ctypes.Structure):
    _fields_ = (
        ("channels", ctypes.c_uint8),
        ("most", ctypes.c_int16 * CHANNELS),
        ("continuous", ctypes.c_int16 * CHANNELS),
        ("heating", ctypes.c_uint16),
        ("slew", ctypes.c_uint16),
        ("quantum", ctypes.c_uint16),
        ("watchdog", ctypes.c_uint16),
        ("seed", ctypes.c_uint32),
        ("vibrators", ctypes.c_uint8),
        ("heaters", ctypes.c_uint8),
        ("resting", ctypes.c_uint16),
        ("heat_rise", ctypes.c_uint16),
        ("heat_time", ctypes.c_uint16),
    )


class Start(ctypes.Structure):
    """The part of the C device that is read here."""

    _fields_ = (
        ("limits", Limits),
        ("state", ctypes.c_int),
        ("cause", ctypes.c_int),
        ("counts", ctypes.c_int16 * CHANNELS),
        *((name, ctypes.c_uint32) for name in ("accepted", "missing", "stale", "refused")),
        ("amplitudes", ctypes.c_int16 * 5),
        ("heating", ctypes.c_uint8),
        ("sensed", ctypes.c_bool),
    )


def compiled(out: Path, *options: str) -> subprocess.CompletedProcess:
    """Compile the firmware, with warnings as errors."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if not compiler:
        pytest.skip("no C compiler")
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    sources = [str(FIRMWARE / "glove_device.c"), *options]
    command = [compiler, "-std=c99", *warnings, "-I", str(FIRMWARE), "-o", str(out), *sources]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.fixture(scope="module")
def firmware(tmp_path_factory):
    library = tmp_path_factory.mktemp("firmware") / "glove.so"
    compiled(library, "-shared", "-fPIC").check_returncode()
    loaded = ctypes.CDLL(str(library))
    loaded.glove_answer.restype = ctypes.c_bool
    loaded.glove_press.argtypes = (ctypes.c_void_p, ctypes.c_bool)
    return loaded


class Compiled:
    """The C program, with the same calls."""

    def __init__(
        self, library, channels=14, most=(11_999,) * 14, continuous=(0,) * 14, heating=3000, skin=(0, 0, 0, 0, 0)
    ):
        self.library = library
        self.memory = (ctypes.c_uint8 * 4096)()
        self.line = (ctypes.c_uint8 * LINE_SIZE)()
        bounds = ((ctypes.c_int16 * CHANNELS)(*counts) for counts in (most, continuous))
        library.glove_init(self.memory, Limits(channels, *bounds, heating, 120, 100, 50, 77, *skin))

    def __getattr__(self, name):
        return getattr(Start.from_buffer(self.memory), name)

    def receive(self, timestamp: int, data: bytes) -> None:
        for byte in data:
            self.library.glove_receive(self.memory, ctypes.c_uint32(timestamp), byte)

    def step(self, timestamp: int) -> list[int]:
        self.library.glove_step(self.memory, ctypes.c_uint32(timestamp))
        return list(self.counts)

    def press(self, is_pressed: bool) -> None:
        self.library.glove_press(self.memory, is_pressed)

    def answer(self, timestamp: int) -> bytes | None:
        return (
            bytes(self.line) if self.library.glove_answer(self.memory, ctypes.c_uint32(timestamp), self.line) else None
        )

    def status(self, timestamp: int) -> bytes:
        self.library.glove_status(self.memory, ctypes.c_uint32(timestamp), self.line)
        return bytes(self.line)

    def skin(self, timestamp: int) -> bytes:
        self.library.glove_skin(self.memory, ctypes.c_uint32(timestamp), self.line)
        return bytes(self.line)

    def measure_skin(self, channel: int, temperature: int) -> None:
        self.library.glove_feel(self.memory, channel, ctypes.c_int16(temperature))

    def angles(self, timestamp: int, values: tuple[int, ...]) -> bytes:
        counts = (ctypes.c_int16 * CHANNELS)(*values)
        self.library.glove_frame(self.memory, ctypes.c_uint32(timestamp), int(Kind.ANGLES), counts, 0, self.line)
        return bytes(self.line)


def spoilt(line: bytes, rng: random.Random) -> bytes:
    sent = bytearray(line)
    place = rng.randrange(len(sent))
    match rng.randrange(6):
        case 0:
            sent[place] ^= 1 << rng.randrange(8)
        case 1:
            del sent[place]
        case 2:
            sent[place:place] = rng.randbytes(rng.randrange(1, 60))
        case 3:
            sent *= 2
        case 4:
            sent = sent[:place]
        case 5:
            sent[:0] = rng.randbytes(600) + b"\0"
    return bytes(sent)


@pytest.mark.parametrize("seed", range(12))
def test_the_c_program_does_the_same(firmware, seed):
    """Byte for byte and count for count, over random hosts, faults, pauses and clocks that wrap."""
    rng = random.Random(seed)
    channels, heating = rng.randrange(1, 15), rng.choice((0, 1, 20, 20, 200, 65_535))
    most = [rng.choice((0, 300, 11_999, 32_767)) for _ in range(channels)]
    continuous = [rng.choice((0, 200, 3000, 20_000)) for _ in range(channels)]
    skin = (rng.randrange(6), rng.randrange(6), rng.choice((0, 3400, 4100)), rng.choice((1, 3000, 20_000)))
    skin = (*skin, rng.choice((1, 30, 800, 65_535)))
    names = ("vibrators", "heaters", "resting", "heat_rise", "heat_time")
    sensations = dict(zip(names, skin, strict=True))
    ours = Device(channels=channels, most=most, continuous=continuous, heating=heating, seed=77, **sensations)
    theirs, host = Compiled(firmware, channels, most, continuous, heating, skin), Host(number=rng.randrange(2**16))
    timestamp = rng.randrange(TICKS)
    for program in (ours, theirs):
        program.step(timestamp)
    armed, pressed = 0, False
    for _ in range(1500):
        elapsed = rng.choice((300, MS, MS, MS, 5 * MS, rng.randrange(60 * MS)))
        timestamp = (timestamp + elapsed) % TICKS
        values = tuple(rng.randrange(-2000, 14_000) for _ in range(CHANNELS))
        kinds = (Kind.COMMAND, Kind.ARM, Kind.HELLO, Kind.ANGLES, Kind.STOP, Kind.VIBRATE, Kind.HEAT)
        kind = rng.choices(kinds, (200, 22, 9, 9, 1, 60, 60))[0]
        if kind in (Kind.HELLO, Kind.ARM):
            nonce = ours.nonce if rng.random() < 0.9 else rng.randrange(2**15)
            values = (host.session if rng.random() < 0.9 else 3, nonce)
        answers = timestamp - rng.choice((0, MS, 5 * MS, rng.randrange(70 * MS), -MS, rng.randrange(TICKS)))
        line = host.line(timestamp, kind, values, Flag(rng.choice((1, 1, 1, 0))), answers)
        if rng.random() < 0.2:
            line = spoilt(line, rng)
        pressed = rng.random() < (0.8 if pressed else 0.005)
        measured = rng.choice((0, 3500, 4199, 4200, 5000, -7)) if rng.random() < 0.1 and skin[1] else None
        for program in (ours, theirs):
            program.receive(timestamp, line)
            program.press(pressed)
            if measured is not None:
                program.measure_skin(0, measured)
        assert ours.step(timestamp) == theirs.step(timestamp)
        assert (ours.state, ours.cause) == (theirs.state, theirs.cause)
        answer = ours.answer(timestamp)
        assert theirs.answer(timestamp) == (answer and encode(answer))
        assert encode(ours.status(timestamp)) == theirs.status(timestamp)
        assert encode(ours.skin(timestamp)) == theirs.skin(timestamp) and ours.is_sensed == theirs.sensed
        encoders = struct.unpack("<14h", rng.randbytes(28))
        assert encode(ours.frame(timestamp, Kind.ANGLES, encoders)) == theirs.angles(timestamp, encoders)
        armed += ours.state == DeviceState.ARMED
    assert armed > 100 and ours.order.missing + ours.order.stale + sum(ours.reader.refused.values()) > 0


def held_for_long(device, commands, seconds: float) -> np.ndarray:
    """Return the counts ``(ms, 14)`` that the device holds at each millisecond of a constant command."""
    host, drawn, held = Host(), Device(seed=77), []
    line = host.line(0, Kind.HELLO, (7,))
    for program in (device, drawn):
        program.receive(0, line)
    device.receive(1, host.line(1, Kind.ARM, (7, drawn.nonce)))
    for timestamp in range(MS, int(1e6 * seconds), MS):
        if timestamp % (20 * MS) == MS:
            device.receive(timestamp, host.line(timestamp, Kind.COMMAND, commands))
        held.append(list(device.step(timestamp)))
    return np.array(held)


PEAKS = (11_999, 6000, 300, *(2000,) * 11)
LASTING = (5000, 6000, 100, *(1500,) * 11)
HEATING = 50


def warm_devices(firmware):
    return (
        Device(most=PEAKS, continuous=LASTING, heating=HEATING, seed=77),
        Compiled(firmware, 14, PEAKS, LASTING, HEATING),
    )


@pytest.mark.parametrize("torques", [(32_000,) * 14, (7000, 3000, 200, *(1700,) * 11), LASTING])
def test_no_motor_gets_warmer_than_it_bears_whatever_the_host_says(firmware, torques):
    """Against an exact integral of what it held: T s' = counts^2 - s, from cold."""
    for device in warm_devices(firmware):
        held = held_for_long(device, torques, 4.0)
        assert np.all(held <= PEAKS)
        share, squares = -np.expm1(-1 / (10 * HEATING)), np.zeros(14)
        for counts in held:
            squares += share * (counts.astype(float) ** 2 - squares)
            assert np.all(squares <= np.array(LASTING) ** 2 * 1.0001)
        np.testing.assert_allclose(held[-1], np.minimum(torques, LASTING), rtol=5e-3)
        assert np.all(held.max(0) == np.minimum(torques, PEAKS)), "and for a moment all of it"


def test_warmth_outlives_hosts_and_latches(firmware):
    for device in warm_devices(firmware):
        held_for_long(device, (32_000,) * 14, 3.0)
        host = Host(session=9)
        device.receive(3_000_000, host.line(3_000_000, Kind.HELLO, (9,)))
        frames = [device.answer(3_000_000) for _ in range(3)]
        first = frames[0] if isinstance(frames[0], Frame) else FrameReader().feed(frames[0])[0]
        device.receive(3_000_001, host.line(3_000_001, Kind.ARM, (9, first.values[6])))
        device.receive(3_000_002, host.line(3_000_002, Kind.COMMAND, (32_000,) * 14))
        held = [device.step(3_000_000 + timestamp)[0] for timestamp in range(MS, 50 * MS, MS)]
        assert max(held) < 6500, "no peak again before it has cooled"
        warmth = {}
        for _ in range(14):
            status = device.status(3_050_000)
            status = status if isinstance(status, Frame) else FrameReader().feed(status)[0]
            warmth[status.values[12]] = status.values[13]
        assert warmth.keys() == set(range(14)) and 850 < warmth[0] <= 1000


def test_a_pause_of_any_length_cools_and_never_warms(firmware):
    for pause in (9_000, 5_000_000, 2**32 - 5_000_000):
        for device in warm_devices(firmware):
            before = held_for_long(device, (32_000,) * 14, 2.0)[-1]
            statuses = []
            for timestamp in (2_000_000, 2_000_000 + pause):
                device.step(timestamp % TICKS)
                device.press(True)
                statuses.append([device.status(timestamp % TICKS) for _ in range(14)])
            answers = [
                [
                    (answer if isinstance(answer, Frame) else FrameReader().feed(answer)[0]).values[13]
                    for answer in sorted_by_channel
                ]
                for sorted_by_channel in statuses
            ]
            expected = np.array(answers[0]) * np.exp(-min(pause, 8_000_000) / 1e6 / (HEATING / 100))
            assert before.any() and np.all(np.array(answers[1]) <= answers[0])
            assert np.all(np.array(answers[1]) >= expected - 2), "never faster than it does"


def test_the_pages_vectors_arm_and_move_both_programs(firmware):
    """The page's HELLO, ARM and COMMAND arm and move both programs, with the number that each has drawn."""
    by_kind = {frame.kind: (frame, line) for frame, line in vectors()}
    for device in (Device(), Compiled(firmware)):
        device.step(60_000)
        device.receive(65_000, by_kind[Kind.HELLO][1])
        answer = device.answer(70_000)
        answer = answer if isinstance(answer, Frame) else FrameReader().feed(answer)[0]
        page = by_kind[Kind.CAPABILITY][0]
        assert answer.values[:6] == page.values[:6] and answer.echo == page.echo and answer.clock == page.clock
        arm = by_kind[Kind.ARM][0]
        device.receive(75_000, by_kind[Kind.ARM][1])
        assert device.state == DeviceState.IDLE, "another device's number"
        values = (answer.values[0], answer.values[6], *arm.values[2:])
        device.receive(75_000, encode(replace(arm, sequence=3, clock=arm.clock + 1, values=values)))
        assert device.state == DeviceState.ARMED
        command, _ = by_kind[Kind.COMMAND]
        device.step(80_000)
        device.receive(80_000, encode(replace(command, sequence=4)))
        for timestamp in range(81_000, 124_000, 1000):
            held = device.step(timestamp)
        assert held == [min(value, 11_999, 120 * 43) for value in command.values]
        assert not any(device.step(74_000 + 50_000 + 1001)) and device.state == DeviceState.LATCHED


def test_the_c_program_under_the_sanitizers(tmp_path):
    """Any limits, clocks, bytes and frames: no byte is read or written out of place, and no number overflows."""
    program = tmp_path / "sanitized"
    sanitizers = "-fsanitize=address,undefined", "-fno-sanitize-recover=all"
    built = compiled(program, "-g", "-O1", *sanitizers, str(Path(__file__).parent / "firmware_sanitized.c"))
    if built.returncode:
        assert "sanitize" in built.stderr or "asan" in built.stderr, built.stderr
        pytest.skip("no sanitizers")
    for seed in range(6):
        rng = random.Random(seed)
        host, script = Host(number=rng.randrange(2**16)), bytearray(rng.randbytes(4 * (1 + 28 + 5 + 5 + 1)))
        if seed % 2:
            # Limits of a glove, and a clock that frames can be about.
            counts = b"".join(rng.choice((11_999, 5000, 0, 32_767)).to_bytes(4) for _ in range(28))
            script[:] = (
                (14).to_bytes(4)
                + counts
                + b"".join(n.to_bytes(4) for n in (30, 120, 100, 50, 77, 5, 5, 3400, 3000, 800, 0))
            )
        model, timestamp = Device(seed=77), 0
        for _ in range(600):
            kinds = (Kind.COMMAND, Kind.ARM, Kind.HELLO, Kind.STOP, Kind.VIBRATE, Kind.HEAT)
            kind = rng.choices(kinds, (30, 6, 1, 1, 5, 5))[0]
            values = tuple(rng.randrange(-(2**15), 2**15) for _ in range(14))
            values = (7, model.nonce, *values[2:]) if kind in (Kind.ARM, Kind.HELLO) else values
            line = host.line(timestamp, kind, values, Flag(rng.choice((1, 1, 1, 0))))
            line = spoilt(line, rng)[:63] if rng.random() < 0.2 else line
            model.receive(timestamp, line)
            script += (
                bytes([6, len(line)]) + line + bytes([rng.choice((4, 5, 4, 5, 2, 3, 11)) if rng.random() < 0.1 else 4])
            )
            elapsed = rng.randrange(32)
            timestamp += 1000 * elapsed
            script.append(8 * elapsed)
            model.step(timestamp)
        script += rng.randbytes(20_000)
        done = subprocess.run([program], input=bytes(script), capture_output=True)
        assert done.returncode == 0, done.stderr.decode()
        assert int(done.stdout) > 100


def test_the_c_program_keeps_within_its_channels(firmware):
    theirs = Compiled(firmware, channels=200)
    assert theirs.limits.channels == CHANNELS
    theirs = Compiled(firmware, channels=2, most=(500, -1, *(500,) * 12), continuous=(900, 0, *(9,) * 12))
    assert list(theirs.limits.most)[:3] == [500, 0, 0] and list(theirs.limits.continuous)[:3] == [500, 0, 0]
    for options, message in (
        ({"heating": 65_536}, "heating is 65536: expected 0 to 65535"),
        ({"most": [5] * 13}, "most has 13 entries: expected one for each of 14 channels"),
        ({"continuous": [5] * 13 + [-1]}, r"continuous\[13\] is -1: expected 0 to 32767"),
    ):
        with pytest.raises(ValueError, match=message):
            Device(**options)
    for channels in (0, 15, 200):
        with pytest.raises(ValueError, match=f"channels is {channels}: expected 1 to 14"):
            Device(channels=channels)


def test_the_c_programs_frames_are_read_by_ours(firmware):
    theirs = Compiled(firmware)
    frames = FrameReader().feed(theirs.angles(5, tuple(range(-7, 7))) + theirs.status(6))
    assert [frame.kind for frame in frames] == [Kind.ANGLES, Kind.STATUS]
    assert frames[0].values == tuple(range(-7, 7)) and [frame.clock for frame in frames] == [5, 6]
