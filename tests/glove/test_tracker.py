"""Trackers: what their formats say comes out as poses, and nothing else does, however bytes are cut or spoilt."""

import random
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.other_devices.polhemus import (
    INCH,
    FastrakAscii,
    FastrakBinary,
    IsotrakBinary,
    JumpFilter,
    Tracker,
    TrackerSample,
)
from jaxgrasp.glove.simulated.simulation import FaultInjector, MemoryLine


def isotrak(position, quaternion, station=1) -> bytes:
    """Encode a record by the tracker's manual: seven bytes, then their high bits; the first high bit marks a record."""
    numbers = np.rint(np.concatenate([np.array(position) / 1.6632, quaternion]) * 32767).astype(int)
    plain = b"0" + str(station).encode() + b" " + struct.pack("<7h", *numbers)
    out = bytearray()
    for k in range(0, len(plain), 7):
        group = plain[k : k + 7]
        out += bytes(byte & 127 for byte in group)
        out.append(sum((byte >> 7) << j for j, byte in enumerate(group)))
    out[0] |= 128
    return bytes(out)


def ascii_record(position, quaternion, station=1) -> bytes:
    fields = "".join(f"{100 * x:7.2f}" for x in position) + "".join(f"{x:7.4f}" for x in quaternion)
    return f"0{station} {fields}\r\n".encode()


def binary_record(position, quaternion, station=1) -> bytes:
    return f"0{station} ".encode() + struct.pack("<7f", *(100 * np.array(position)), *quaternion) + b" "


FORMATS = {
    "isotrak-binary": (isotrak, IsotrakBinary, 6e-5, 4e-5),
    "fastrak-ascii": (ascii_record, FastrakAscii, 6e-5, 1e-4),
    "fastrak-binary": (binary_record, FastrakBinary, 1e-6, 1e-6),
}


def poses(count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    turned = rng.normal(size=(count, 4))
    return list(zip(rng.uniform(-1.5, 1.5, (count, 3)), turned / np.linalg.norm(turned, axis=1, keepdims=True)))


@pytest.mark.parametrize("name", FORMATS)
def test_records_cut_anywhere(name):
    encode, decoder, off, off_turn = FORMATS[name]
    reader, rng = decoder(), random.Random(1)
    given_poses = poses(300, 2)
    data = b"\x00\x13rubbish0" + b"".join(encode(*pose) for pose in given_poses)
    samples = []
    while data:
        size = rng.randrange(1, 90)
        samples += reader.feed(data[:size])
        data = data[size:]
    assert len(samples) == 300
    for sample, (position, quaternion) in zip(samples, given_poses):
        np.testing.assert_allclose(sample.position, position, atol=off)
        np.testing.assert_allclose(sample.quaternion, quaternion, atol=off_turn)
        assert sample.station == 1 and sample.flag == " "


def test_known_records():
    """Records computed by hand are read: 80 cm along x, a quarter turn about z; in inches too."""
    record = b"01   80.00-100.00   0.00 0.7071 0.0000 0.0000 0.7071\r\n"
    (sample,) = FastrakAscii().feed(record)
    np.testing.assert_allclose(sample.position, [0.8, -1.0, 0])
    np.testing.assert_allclose(sample.quaternion, np.sqrt([0.5, 0, 0, 0.5]))
    (sample,) = FastrakAscii(INCH).feed(record)
    np.testing.assert_allclose(sample.position, [80 * 0.0254, -2.54, 0])
    raw = bytes(
        [0x80 | 0x30, 0x31, 0x20, 0x7F, 0x7F, 0, 0, 0b0001000, 0, 0, 0x7F, 0x7F, 0, 0, 0, 0b0000100, 0, 0, 0, 0]
    )
    (sample,) = IsotrakBinary().feed(raw)
    np.testing.assert_allclose(sample.position, [1.6632, 0, 0])
    np.testing.assert_allclose(sample.quaternion, [1, 0, 0, 0])


@pytest.mark.parametrize("name", FORMATS)
@settings(max_examples=150, deadline=None)
@given(st.lists(st.binary(max_size=700), max_size=6))
def test_any_bytes_are_survived(name, parts):
    encode, decoder, _, _ = FORMATS[name]
    reader = decoder()
    for part in parts:
        for sample in reader.feed(part):
            assert np.all(np.abs(sample.position) <= 5) and abs(np.linalg.norm(sample.quaternion) - 1) < 1e-9
        assert len(reader.buffer) < 512
    # Half a record of rubbish may swallow the first good one, and no more.
    assert len(reader.feed(encode(np.zeros(3), np.array([1.0, 0, 0, 0])) * 4)) >= 2


@pytest.mark.parametrize("name", FORMATS)
def test_faults_cost_few_records_and_the_filter_refuses_what_is_wrong(name):
    encode, decoder, off, _ = FORMATS[name]
    injector, reader, jumps = FaultInjector(0.2, 3), decoder(), JumpFilter()
    good = wrong = 0
    for k in range(2000):
        position = np.array([0.3 * np.sin(k / 100), 0.2, 0.1])
        for sample in reader.feed(injector.inject(encode(position, np.array([1.0, 0, 0, 0])))):
            if not jumps.passes(k / 60, sample):
                continue
            near = np.linalg.norm(sample.position - position) < 0.1
            good, wrong = good + near, wrong + (not near)
    assert good > 1500 and wrong == 0


def test_jumps():
    jumps = JumpFilter()
    at = lambda x, turn=0.0: TrackerSample(1, np.array([x, 0, 0]), np.array([np.cos(turn), np.sin(turn), 0, 0]), " ")  # noqa: E731
    assert jumps.passes(0.0, at(0.0)) and jumps.passes(0.01, at(0.04))
    assert not jumps.passes(0.02, at(1.0)) and not jumps.passes(0.03, at(0.04, 1.0))
    assert jumps.passes(0.04, at(0.05))
    taken = [jumps.passes(0.05 + 0.01 * k, at(1.0 + 0.01 * k)) for k in range(6)]
    assert taken == [False] * 4 + [True] * 2
    assert jumps.refused == 6


@pytest.mark.parametrize("streams", [True, False])
@pytest.mark.parametrize("name", FORMATS)
def test_a_tracker_on_a_line(name, streams):
    encode, _, off, _ = FORMATS[name]
    line = MemoryLine(19_200)
    tracker = Tracker(line, name, streams=streams)
    assert bytes(line.to_device).startswith(b"cO") and line.to_device.endswith(b"C") == streams
    line.to_device.clear()
    turned = np.array([0.6, 0.8, 0, 0])
    assert tracker.poll(0.0) is None and bytes(line.to_device) == (b"" if streams else b"P")
    line.to_host += encode([0.1, 0.2, 0.3], turned) + encode([0.9, 0.2, 0.3], turned, station=2)
    sample = tracker.poll(0.1)
    np.testing.assert_allclose(sample.position, [0.1, 0.2, 0.3], atol=off)
    line.to_host += encode([0.1, 0.2, 0.31], -turned)
    np.testing.assert_allclose(tracker.poll(0.2).quaternion, turned, atol=2e-4)
    assert line.to_device.count(b"P") == (0 if streams else 3)
    assert tracker.poll(0.21) is tracker.sample and tracker.sampled_at == 0.2
    tracker.poll(0.5)
    assert line.to_device.count(b"P") == (0 if streams else 4), "asked again when no answer comes"
    tracker.close()
    assert line.to_device.endswith(b"c")


def test_bad_settings(unchecked):
    for change, message in (({"protocol": "Fastrak"}, "expected isotrak-binary"), ({"station": 5}, "station is 5")):
        with pytest.raises(ValueError, match=message):
            Tracker(**{"line": MemoryLine(9600), "protocol": "fastrak-ascii", **change})
