"""The native protocol's frames: what goes in comes out, and nothing else does, whatever happens on the line."""

import random
import struct
import zlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxgrasp.glove.protocol
from jaxgrasp.glove.protocol.frames import (
    BUFFER,
    CHANNELS,
    LINE_SIZE,
    Flag,
    Frame,
    FrameError,
    FrameReader,
    Kind,
    Sequence,
    decode,
    encode,
    stuff,
    unstuff,
)

# Of a frame, which is made in the test: checking its types draws numbers of its own.
PARTS = st.tuples(
    st.sampled_from(Kind),
    st.integers(0, 2**16 - 1),
    st.integers(0, 2**32 - 1),
    st.binary(min_size=2 * CHANNELS, max_size=2 * CHANNELS).map(lambda raw: struct.unpack(f"<{CHANNELS}h", raw)),
    st.integers(0, 15).map(Flag),
    st.integers(0, 2**32 - 1),
    st.integers(0, 15),
)


def numbered(count: int, seed: int = 0) -> list[Frame]:
    rng = random.Random(seed)
    values = lambda: tuple(rng.randrange(-(2**15), 2**15) for _ in range(CHANNELS))  # noqa: E731
    return [Frame(Kind.COMMAND, k % 2**16, 5000 * k % 2**32, values(), Flag.ENABLE) for k in range(count)]


def in_pieces(data: bytes, rng: random.Random) -> list[bytes]:
    pieces = []
    while data:
        size = rng.randrange(1, 100)
        pieces.append(data[:size])
        data = data[size:]
    return pieces


@settings(deadline=None)
@given(st.binary(max_size=1200))
def test_stuffing_is_undone_and_has_no_zeros(data):
    stuffed = stuff(data)
    assert b"\0" not in stuffed
    assert unstuff(stuffed) == data
    assert len(stuffed) <= len(data) + 1 + len(data) // 254


@pytest.mark.parametrize("size", [253, 254, 255, 508, 509])
def test_long_runs(size):
    for data in (b"x" * size, b"x" * size + b"\0", b"\0" + b"x" * size):
        assert unstuff(stuff(data)) == data


@settings(deadline=None)
@given(PARTS)
def test_frames_come_back(parts):
    frame = Frame(*parts)
    line = encode(frame)
    assert len(line) == LINE_SIZE == 46 and line.index(b"\0") == len(line) - 1
    assert FrameReader().feed(line) == [frame]


def test_the_layout_is_that_of_the_page():
    """Byte by byte, as firmware would write it."""
    frame = Frame(Kind.COMMAND, 0x0102, 0x03040506, (1, -2, *range(12)), Flag.ENABLE, 0x0708090A)
    body = bytes([0x23, 1, 0x02, 0x01, 0x06, 0x05, 0x04, 0x03, 0x0A, 0x09, 0x08, 0x07, 1, 0, 0xFE, 0xFF])
    body += b"".join(bytes([k, 0]) for k in range(12))
    check = zlib.crc32(body)
    assert unstuff(encode(frame)[:-1]) == body + bytes(check >> 8 * k & 255 for k in range(4))


def vectors() -> list[tuple[Frame, bytes]]:
    """Return frames and their bytes, as the page has them."""
    page = (Path(jaxgrasp.glove.protocol.__file__).parent / "firmware" / "PROTOCOL.md").read_text()
    cases = []
    for row in page.split("## Test vectors")[1].strip().splitlines()[2:]:
        kind, flags, cause, sequence, clock, echo, values, line = (
            cell.strip(" `") for cell in row.strip("|").split("|")
        )
        numbers = tuple(map(int, values.split()))
        frame = Frame(Kind[kind], int(sequence), int(clock), numbers, Flag(int(flags)), int(echo), int(cause))
        cases.append((frame, bytes.fromhex(line)))
    return cases


def test_the_pages_vectors():
    assert {frame.kind for frame, _ in vectors()} == set(Kind) - {Kind.TENSIONS}
    for frame, line in vectors():
        assert encode(frame) == line
        assert FrameReader().feed(line) == [frame]


@settings(deadline=None)
@given(PARTS, st.data())
def test_no_single_bit_slips_through(parts, data):
    line = bytearray(encode(Frame(*parts)))
    bit = data.draw(st.integers(0, 8 * len(line) - 1))
    line[bit // 8] ^= 1 << bit % 8
    reader = FrameReader()
    assert reader.feed(bytes(line) + b"\0") == []
    assert sum(reader.refused.values()) >= 1


@settings(max_examples=300, deadline=None)
@given(st.lists(st.binary(max_size=700), max_size=8))
def test_any_bytes_are_survived(parts):
    reader = FrameReader()
    for part in parts:
        reader.feed(part)
        assert len(reader._buffer) <= BUFFER
    frame = numbered(1)[0]
    assert reader.feed(b"\0" + encode(frame))[-1:] == [frame]


def test_refusals_say_why():
    good = encode(numbered(1)[0])[:-1]
    data = unstuff(good)
    other_version = bytes([data[0] + 16, *data[1:40]])
    cases = {
        FrameError.STUFFING: good[:-1],
        FrameError.LENGTH: stuff(data[:-1]),
        FrameError.CHECK: stuff(data[:-1] + bytes([data[-1] ^ 1])),
        FrameError.VERSION: stuff(other_version + zlib.crc32(other_version).to_bytes(4, "little")),
    }
    reader = FrameReader()
    for why, line in cases.items():
        assert decode(line) == why
        reader.feed(line + b"\0")
    reader.feed(b"x" * 600 + b"\0")
    assert reader.refused == dict.fromkeys(FrameError, 1) and reader.accepted == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_fault_costs_at_most_one_good_frame(seed):
    """Flipped bits, lost and inserted bytes, bursts, lost frames: none wrong is accepted, and the numbers add up."""
    rng = random.Random(seed)
    frames = numbered(4000, seed)
    line, faults, lost = bytearray(), 0, 0
    for frame in frames:
        sent = bytearray(encode(frame))
        if rng.random() < 0.2:
            faults += 1
            place = rng.randrange(len(sent))
            fault = rng.randrange(5)
            if fault == 0:
                sent[place] ^= 1 << rng.randrange(8)
            elif fault == 1:
                del sent[place]
            elif fault == 2:
                sent[place:place] = rng.randbytes(rng.randrange(1, 20))
            elif fault == 3:
                sent[place : place + 8] = rng.randbytes(min(8, len(sent) - place))
            else:
                sent = bytearray()
                lost += 1
        line += sent
    reader, order = FrameReader(), Sequence(2**16 - 1)
    accepted = [
        frame for piece in in_pieces(bytes(line), rng) for frame in reader.feed(piece) if order.is_new(frame.sequence)
    ]
    by_number = {frame.sequence: frame for frame in frames}
    assert all(by_number[frame.sequence] == frame for frame in accepted)
    assert [frame.sequence for frame in accepted] == sorted(frame.sequence for frame in accepted)
    end = len(frames) - 1 - accepted[-1].sequence
    assert len(accepted) + order.missing + end == len(frames)
    assert len(frames) - len(accepted) <= 2 * faults - lost
    assert len(accepted) > 0.7 * len(frames)


def test_sequences_wrap_and_late_ones_are_stale():
    order = Sequence()
    assert [order.is_new(number) for number in (65534, 65535, 0, 0, 65535, 3, 1)] == [True] * 3 + [False] * 2 + [
        True,
        False,
    ]
    assert (order.missing, order.stale) == (2, 3)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"values": (0,) * 13}, "values has 13 entries: expected 14"),
        ({"values": (2**15,) + (0,) * 13}, "does not fit"),
        ({"sequence": -1}, "does not fit"),
        ({"clock": 2**32}, "does not fit"),
    ],
)
def test_what_cannot_be_sent(change, message):
    good = {"kind": Kind.COMMAND, "sequence": 0, "clock": 0, "values": (0,) * 14}
    with pytest.raises(ValueError, match=message):
        encode(Frame(**{**good, **change}))
