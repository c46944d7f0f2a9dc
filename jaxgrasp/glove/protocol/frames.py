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

Stuffed it has 45 bytes without a zero, and a zero ends it: 46 on the line, which at 115,200 baud
carries 250 of them a second.

Consistent overhead byte stuffing: any bytes without a zero among them, so that a zero can end a frame.

Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999.

Estimate of the other side's clock from its frames and the frames that they answer, to know the age of data.
"""

import math
import struct
import zlib
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum, IntFlag

import numpy as np

LONGEST_RUN = 254
"""Largest number of bytes without a zero after a code byte."""


def stuff(data: bytes) -> bytes:
    """Encode bytes without zeros; the result is longer by a byte for every 254 begun."""
    out = bytearray()
    for run in data.split(b"\0"):
        while len(run) >= LONGEST_RUN:
            out.append(LONGEST_RUN + 1)
            out += run[:LONGEST_RUN]
            run = run[LONGEST_RUN:]
        out.append(len(run) + 1)
        out += run
    return bytes(out)


def unstuff(data: bytes) -> bytes | None:
    """Decode stuffed bytes; return None if they are not a valid encoding."""
    out = bytearray()
    position, size = 0, len(data)
    while position < size:
        code = data[position]
        end = position + code
        if code == 0 or end > size:
            return None
        out += data[position + 1 : end]
        position = end
        if code <= LONGEST_RUN and position < size:
            out.append(0)
    return None if b"\0" in data or not data else bytes(out)


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
    of a torque [counts/ms], a number that the device draws, which ARM must repeat, its motors' heating [10 ms], and of
    the vibration and then of the heat channels their number and watchdog [ms], and the bound of the temperature
    [1/100 deg C]; the last five are 0 of devices without these channels."""
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
    VIBRATE = 11
    """Host to device: amplitudes of the vibration channels [1/1000], thumb first."""
    HEAT = 12
    """Host to device: target temperatures of the heat channels [1/100 deg C], thumb first; 0 for off."""
    SKIN = 13
    """Device to host: five amplitudes that the device drives [1/1000], five temperatures [1/100 deg C], and the heaters
    that are on, a bit each. Only devices with these channels send it, to hosts that use them."""


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


DRIFT = 6e-3
"""Largest relative drift of two clocks, with a margin: half a per cent, as for ceramic resonators [1]."""
WINDOW = 0.25
"""Length of a window, of which the frame with the least lag counts [s]."""
MIN_WINDOWS, MAX_WINDOWS = 4, 32
"""Smallest number of windows for a fit of the clock rate, and largest number of windows in the fit."""
SLACK = 1e-3
"""Largest excess of a round trip over the shortest that does not count as waiting [s]."""
RELAXATION = 1e-5
"""Rate at which the shortest round trip is relaxed [s/s]: a slower growth of delay is attributed to the clock."""


class PeerClock:
    """Conversion of the other side's clock to the local clock.

    No frame arrives before it is sent: the least difference seen between arrival and its clock is the offset, and what
    a frame is later than that it has waited somewhere. Clocks that run apart and a delay that grows look alike in that
    difference, but not in the round trip, which a clock does not lengthen. So rate and offset are fitted to frames of
    short round trips alone, and go on by their rate while there are none.
    """

    def __init__(self, min_transfer: float = 0.0) -> None:
        """Create a clock of which nothing is known.

        Args:
            min_transfer: time that a frame takes at least, on an empty line [s].
        """
        self._min_transfer = min_transfer
        self._ticks: int | None = None
        self._unwrapped = 0
        self._offset, self._rate, self._last_arrival = 0.0, 0.0, 0.0
        self._anchors: deque[tuple[float, float]] = deque(maxlen=MAX_WINDOWS)
        self._shortest = math.inf
        self._window_start = self._window_end = 0.0
        self._least_lag, self._trip = (math.inf, 0.0, 0.0), math.inf

    def sent_at(self, ticks: int, arrived: float, trip: float = 0.0) -> float:
        """Estimate the time at which a frame was sent, on the local clock [s].

        Args:
            ticks: its clock [us], modulo 2^32.
            arrived: when it came [s].
            trip: how long ago the frame of ours was sent that it answers [s].
        """
        if self._ticks is None:
            self._unwrapped = ticks
            self._offset = arrived - ticks * 1e-6
            self._open_window(ticks * 1e-6)
        else:
            # A late frame's clock is before the last one's.
            self._unwrapped += (ticks - self._ticks + TICKS // 2) % TICKS - TICKS // 2
        at = self._unwrapped * 1e-6
        lag = arrived - at
        if at >= self._window_end:
            self._close_window(at)
        self._extrapolate(at, lag, arrived)
        self._least_lag = min(self._least_lag, (lag - self._rate * at, at, lag))
        self._trip = min(self._trip, trip)
        self._ticks, self._last_arrival = ticks, arrived
        return at + self._expected(at) - self._min_transfer

    def _expected(self, at: float) -> float:
        """Compute the least lag [s] of a frame sent at a time on the other side's clock [s]."""
        return self._offset + self._rate * at

    def _extrapolate(self, at: float, lag: float, arrived: float) -> None:
        if len(self._anchors) < MIN_WINDOWS:
            # Nothing is known of its rate: the offset is let go as fast as clocks may run apart.
            self._offset += DRIFT * max(arrived - self._last_arrival, 0.0) if self._ticks is not None else 0.0
        self._offset = min(self._offset, lag - self._rate * at)

    def _open_window(self, at: float) -> None:
        self._window_start, self._window_end = at, at + WINDOW
        self._least_lag, self._trip = (math.inf, at, 0.0), math.inf

    def _close_window(self, at: float) -> None:
        self._shortest = min(self._shortest + RELAXATION * (at - self._window_start), self._trip)
        if self._trip <= self._shortest + SLACK:
            self._anchors.append(self._least_lag[1:])
            if len(self._anchors) >= MIN_WINDOWS:
                self._fit()
        self._open_window(at)

    def _fit(self) -> None:
        times, lags = np.array(self._anchors).T
        mean_time = times.mean()
        centred = times - mean_time
        # Least squares: rate = cov(t, lag) / var(t); the offset puts all lags above the line.
        rate = float(centred @ (lags - lags.mean()) / (centred @ centred))
        self._rate = min(max(rate, -DRIFT), DRIFT)
        self._offset = float(np.min(lags - self._rate * times))


class RoundTrip:
    """Shortest recent round trip, from a local frame to the frame that answers it.

    The minimum counts, since a busy program reads frames late that came in time.
    """

    def __init__(self, duration: float = 0.1) -> None:
        """Create an estimator without frames; ``duration`` is the time for which a frame counts [s]."""
        self._duration = duration
        self._minima: deque[tuple[float, float]] = deque()

    def add(self, timestamp: float, trip: float) -> None:
        """Record the round trip [s] of a frame that came at a time [s]."""
        while self._minima and self._minima[-1][1] >= trip:
            self._minima.pop()
        self._minima.append((timestamp, trip))

    def shortest(self, timestamp: float) -> float:
        """Return the shortest recent round trip [s]; infinite if no frame came."""
        while self._minima and self._minima[0][0] < timestamp - self._duration:
            self._minima.popleft()
        return self._minima[0][1] if self._minima else math.inf
