"""Frames of the native protocol: 14 signed values with a number, a time and a check sum, between zeros.

A frame before stuffing, little-endian, 44 bytes:

======  ========  ===================================================================
offset  type      meaning
======  ========  ===================================================================
0       uint8     version of the protocol in the high four bits, kind in the low four
1       uint8     flags in the low four bits; of a device's frames, its cause in the high four
2       uint16    sequence number, one more for each frame sent, 0 after 65,535
4       uint32    the sender's clock [us], from 0 again after 4,294,967,295
8       uint32    the other side's clock in the newest of its frames that were heard; 0 before any
12      int16 x14 values; what they are depends on the kind
40      uint32    CRC-32 (that of Ethernet and zlib) of the 40 bytes before
======  ========  ===================================================================

Stuffed (``cobs.py``) it has 45 bytes without a zero, and a zero ends it: 46 on the line, which at 115,200 baud
carries 250 of them a second.
"""

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from jaxgrasp.glove.protocol.cobs import stuff, unstuff

VERSION = 2
CHANNELS = 14
_BODY = struct.Struct("<BBHII14h")
_CHECK = struct.Struct("<I")
SIZE = _BODY.size + _CHECK.size
"""Number of bytes of a frame before stuffing."""
LINE_SIZE = SIZE + 2
"""Number of bytes of a frame on the line."""
BUFFER = 512
"""Largest number of bytes of an incomplete frame that a reader keeps."""
SEQUENCES, TICKS = 2**16, 2**32
"""Moduli of sequence numbers and of clocks [us]."""


class Kind(IntEnum):
    """Kind of a frame, which defines its values; unused values are zero."""

    HELLO = 1
    """Host to device: session, a number the host draws. A device gives up all torque at it, and answers."""
    CAPABILITY = 2
    """Device to host: session, channels, watchdog [ms], torque of a count [1e-7 N.m], largest count, largest change
    of a torque [counts/ms], a number that the device draws, which ARM must repeat, and its motors' heating [10 ms]."""
    COMMAND = 3
    """Host to device: torques [counts]."""
    ANGLES = 4
    """Device to host: encoders [counts]."""
    TENSIONS = 5
    """Device to host: strain gauges [counts]."""
    ARM = 6
    """Host to device: session, and the device's number. Only ARM lets torques through and ends a latch."""
    STATUS = 7
    """Device to host: session, state, cause; then four numbers of 32 bits, low half first: commands accepted,
    missing, stale, frames refused; the newest sequence number; and of one channel after the other its index and its
    motor's warmth [1/1000 of what it bears for ever]."""
    STOP = 8
    """Host to device: emergency stop, acted on whatever its age and number."""
    LIMITS = 9
    """Device to host, after CAPABILITY: largest counts, by channel."""
    CONTINUOUS = 10
    """Device to host, after LIMITS: largest counts that the motors bear for ever, by channel."""


class Flag(IntFlag):
    """Flags of a frame."""

    ENABLE = 1
    """In a command: the device may stay armed, without the flag it disarms. In a device's frame: it is armed."""
    LATCHED = 2
    """In a device's frame: it holds zero after a fault, until it is armed anew."""
    SATURATED = 4
    """In a device's frame: a gauge was at the end of its range."""
    PRESSED = 8
    """In a device's frame: its emergency stop is pressed, and it cannot be armed."""


NO_FLAGS = Flag(0)


@dataclass(frozen=True)
class Frame:
    """Content of a frame."""

    kind: Kind
    sequence: int
    clock: int
    """Sender's clock [us], below 2^32."""
    values: tuple[int, ...]
    """14 signed values of 16 bits."""
    flags: Flag = NO_FLAGS
    echo: int = 0
    """Other side's clock in its newest frame that was heard [us]; 0 before any."""
    cause: int = 0
    """Code of the cause for which a device gave up its torque; below 16."""


def encode(frame: Frame) -> bytes:
    """Encode a frame into its bytes on the line, with the zero at the end.

    Raises:
        ValueError: for values that are not 14, and numbers that do not fit.
    """
    if len(frame.values) != CHANNELS:
        raise ValueError(f"values has {len(frame.values)} entries: expected {CHANNELS}")
    try:
        flags = frame.flags | frame.cause << 4
        head = VERSION << 4 | frame.kind, flags, frame.sequence, frame.clock, frame.echo
        body = _BODY.pack(*head, *frame.values)
    except struct.error as error:
        raise ValueError(f"a number of {frame} does not fit its place: {error}") from None
    return stuff(body + _CHECK.pack(zlib.crc32(body))) + b"\0"


class FrameError(IntEnum):
    """Reason why the bytes between two zeros are not a frame."""

    STUFFING = 0
    LENGTH = 1
    CHECK = 2
    VERSION = 3
    """Different version of the protocol, or an unknown kind."""
    OVERFLOW = 4
    """More bytes without a zero than a reader's buffer holds."""


def decode(line: bytes) -> Frame | FrameError:
    """Decode the bytes between two zeros into a frame, or return the reason for their refusal."""
    data = unstuff(line)
    if data is None:
        return FrameError.STUFFING
    if len(data) != SIZE:
        return FrameError.LENGTH
    body = data[: _BODY.size]
    if _CHECK.unpack(data[_BODY.size :])[0] != zlib.crc32(body):
        return FrameError.CHECK
    head, flags, sequence, clock, echo, *values = _BODY.unpack(body)
    if head >> 4 != VERSION or head & 15 not in Kind._value2member_map_:
        return FrameError.VERSION
    return Frame(Kind(head & 15), sequence, clock, tuple(values), Flag(flags & 15), echo, flags >> 4)


class FrameReader:
    """Reader of frames from a stream of bytes in any pieces; it keeps at most 512 bytes and raises nothing."""

    def __init__(self) -> None:
        """Create a reader that has seen nothing."""
        self.refused = dict.fromkeys(FrameError, 0)
        """Number of refusals by reason."""
        self.accepted = 0
        self._buffer = bytearray()
        self._is_overflown = False

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes and return the frames that they complete."""
        *lines, incomplete = data.split(b"\0")
        frames: list[Frame] = []
        for line in lines:
            self._append(line)
            frames += self._finish_line()
        self._append(incomplete)
        return frames

    def _append(self, part: bytes) -> None:
        if len(self._buffer) + len(part) > BUFFER:
            self._buffer.clear()
            self._is_overflown = True
        elif not self._is_overflown:
            self._buffer += part

    def _finish_line(self) -> Iterable[Frame]:
        """Decode the bytes that a zero ends and count the outcome; no bytes between two zeros give no frame."""
        line, is_overflown = bytes(self._buffer), self._is_overflown
        self._buffer.clear()
        self._is_overflown = False
        if not (line or is_overflown):
            return ()
        decoded = FrameError.OVERFLOW if is_overflown else decode(line)
        if isinstance(decoded, FrameError):
            self.refused[decoded] += 1
            return ()
        self.accepted += 1
        return (decoded,)


class Sequence:
    """Tracker of sequence numbers: a number not after the newest is stale, skipped numbers are missing frames."""

    def __init__(self, newest: int | None = None, window: int = SEQUENCES // 2 - 1) -> None:
        """Create a tracker of a sender whose last known frame is ``newest``; with None, any number counts as the first.

        Args:
            newest: number of that frame.
            window: how far after the newest a number may lie; what lies farther is stale.
        """
        self.missing = 0
        """Number of frames that were sent and did not come, as far as the sequence numbers tell."""
        self.stale = 0
        """Number of frames that came again, or late."""
        self.newest = newest
        self._window = window

    def is_new(self, number: int) -> bool:
        """Return True if a frame of this number is new and may be acted on; count missing and stale frames."""
        ahead = 1 if self.newest is None else (number - self.newest) % SEQUENCES
        if not 0 < ahead <= self._window:
            self.stale += 1
            return False
        self.missing += ahead - 1
        self.newest = number
        return True
