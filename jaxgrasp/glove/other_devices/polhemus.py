"""Polhemus trackers: decoders of their bytes, and the tracker on its line.

Decoders go from bytes to poses of the wrist: Isotrak II binary, Fastrak ASCII and binary.

Formats as VRPN reads them (``vrpn_Tracker_Isotrak.C``, ``vrpn_Tracker_Fastrak.C``), with the output list "position,
quaternion" (``O2,11`` and ``O1,2,11``). A decoder takes bytes however they are cut, keeps fewer than 512 of them, and
raises nothing; what it refuses it counts, and tries again one byte on.

Tracker on a line, polled for each pose or streaming; it keeps the newest plausible sample.
"""

import math
import struct
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.line import Line, LineError

INCH = 0.0254
CENTIMETRE = 0.01
LARGEST_ISOTRAK = 1.6632
"""Coordinate that the largest binary number stands for [m]."""
MAX_RANGE = 5.0
"""Largest coordinate that a magnetic tracker can measure [m]."""
OFF_UNIT = 0.05
"""Largest deviation of a quaternion's length from 1, due to rounding."""


@dataclass(frozen=True, eq=False)
class TrackerSample:
    """Pose of a receiver in the frame of its transmitter."""

    station: int
    """Number of the receiver, 1 to 4."""
    position: Float[np.ndarray, "3"]
    """Position of the receiver [m]."""
    quaternion: Float[np.ndarray, "4"]
    """Orientation of the receiver's axes, of length 1, real part first."""
    flag: str
    """Status character: a space without an error, an error's letter, or a stylus's button."""


class Decoder(ABC):
    """Decoder from bytes to samples; each format defines the start, length and content of a record."""

    size: int
    """Number of bytes of a record."""

    def __init__(self) -> None:
        """Create a decoder that has seen nothing."""
        self.accepted = 0
        self.refused = 0
        """Number of byte sequences that began like a record and were not valid."""
        self.buffer = bytearray()

    def feed(self, data: bytes) -> list[TrackerSample]:
        """Take bytes and return the samples that they complete."""
        samples: list[TrackerSample] = []
        for start in range(0, len(data), 256):
            self.buffer += data[start : start + 256]
            samples += self._drain()
        return samples

    def _drain(self) -> list[TrackerSample]:
        samples: list[TrackerSample] = []
        while True:
            start = next((k for k, byte in enumerate(self.buffer) if self.begins(byte)), len(self.buffer))
            del self.buffer[:start]
            if len(self.buffer) < self.size:
                return samples
            sample = self.read(bytes(self.buffer[: self.size]))
            self.refused += sample is None
            self.accepted += sample is not None
            # A false start costs one byte, or a record that began within it would be lost too.
            del self.buffer[: 1 if sample is None else self.size]
            if sample is not None:
                samples.append(sample)

    @abstractmethod
    def begins(self, byte: int) -> bool:
        """Return True if a record may begin with this byte."""

    @abstractmethod
    def read(self, record: bytes) -> TrackerSample | None:
        """Decode a record of ``size`` bytes into a sample; return None if it is invalid."""


class IsotrakBinary(Decoder):
    """Isotrak II, binary: 20 bytes of which only the first has its high bit set; the others' come in every eighth."""

    size = 20

    def begins(self, byte: int) -> bool:
        return byte >= 128

    def read(self, record: bytes) -> TrackerSample | None:
        if any(byte >= 128 for byte in record[1:]):
            return None
        plain = bytearray()
        for group in (record[:8], record[8:16], record[16:]):
            plain += bytes(byte & 127 | (group[-1] >> k & 1) << 7 for k, byte in enumerate(group[:-1]))
        if plain[0] != ord("0"):
            return None
        numbers = np.array(struct.unpack("<7h", plain[3:])) / 32767
        return _sample(plain[1], plain[2], LARGEST_ISOTRAK * numbers[:3], numbers[3:])


class FastrakAscii(Decoder):
    """Fastrak and Isotrak, ASCII: a header of three characters, seven fields of seven, and an end of line.

    Fields are read by their columns, since numbers of seven characters leave no space between them.
    """

    size = 3 + 7 * 7 + 2

    def __init__(self, unit: float = CENTIMETRE) -> None:
        """Create a decoder.

        Args:
            unit: of positions [m]: centimetres after ``u``, inches after ``U``.
        """
        super().__init__()
        self._unit = unit

    def begins(self, byte: int) -> bool:
        return byte == ord("0")

    def read(self, record: bytes) -> TrackerSample | None:
        if record[-2:] != b"\r\n":
            return None
        try:
            numbers = np.array([float(record[k : k + 7]) for k in range(3, 52, 7)])
        except ValueError:
            return None
        return _sample(record[1], record[2], self._unit * numbers[:3], numbers[3:])


class FastrakBinary(Decoder):
    """Fastrak, binary: a header of three characters, seven float32 little-endian, and what was asked to end it."""

    def __init__(self, unit: float = CENTIMETRE, end: bytes = b" ") -> None:
        """Create a decoder.

        Args:
            unit: of positions [m]: centimetres after ``u``, inches after ``U``.
            end: of a record: a space for the output list ``2,11,0``, an end of line for ``2,11,1``.
        """
        super().__init__()
        self._unit, self._end = unit, end
        self.size = 3 + 28 + len(end)

    def begins(self, byte: int) -> bool:
        return byte == ord("0")

    def read(self, record: bytes) -> TrackerSample | None:
        if not record.endswith(self._end):
            return None
        numbers = np.array(struct.unpack_from("<7f", record, 3))
        return _sample(record[1], record[2], self._unit * numbers[:3], numbers[3:])


def _sample(station: int, flag: int, position: np.ndarray, quaternion: np.ndarray) -> TrackerSample | None:
    """Create a sample, or return None for implausible values: no format has a check sum."""
    if not (ord("1") <= station <= ord("4") and 32 <= flag < 127):
        return None
    # Not by hypot: a number that overflows when squared is refused all the same, and warns of nothing.
    if not (np.all(np.isfinite(position)) and np.all(np.abs(position) <= MAX_RANGE)):
        return None
    if not (np.all(np.isfinite(quaternion)) and np.all(np.abs(quaternion) <= 2)):
        return None
    length = math.sqrt(float(quaternion @ quaternion))
    if abs(length - 1) > OFF_UNIT:
        return None
    return TrackerSample(station - ord("0"), position, quaternion / length, chr(flag))


class JumpFilter:
    """Filter that refuses jumps faster than a hand, until enough samples in a row agree on the new place."""

    def __init__(self, *, speed: float = 5.0, turning: float = 50.0, enough: int = 5) -> None:
        """Create a filter that has seen nothing.

        Args:
            speed: largest of a hand [m/s].
            turning: largest of a hand [rad/s].
            enough: how many refused samples in a row, each near the one before, make a new place.
        """
        self.refused = 0
        self._speed, self._turning, self._enough = speed, turning, enough
        self._last: tuple[float, TrackerSample] | None = None
        self._candidates: list[tuple[float, TrackerSample]] = []

    def passes(self, timestamp: float, sample: TrackerSample) -> bool:
        """Take a sample that came at a time [s]; return True if it is plausible."""
        if self._last is None or self._is_near(self._last, timestamp, sample):
            self._accept(timestamp, sample)
            return True
        if self._candidates and not self._is_near(self._candidates[-1], timestamp, sample):
            self._candidates.clear()
        self._candidates.append((timestamp, sample))
        if len(self._candidates) >= self._enough:
            self._accept(timestamp, sample)
            return True
        self.refused += 1
        return False

    def _accept(self, timestamp: float, sample: TrackerSample) -> None:
        self._last = timestamp, sample
        self._candidates.clear()

    def _is_near(self, last: tuple[float, TrackerSample], timestamp: float, sample: TrackerSample) -> bool:
        # A sample of its own time at least, however many come at once.
        dt, last_sample = max(timestamp - last[0], 1e-3), last[1]
        cosine = min(abs(float(sample.quaternion @ last_sample.quaternion)), 1.0)
        distance = float(np.linalg.norm(sample.position - last_sample.position))
        return distance <= self._speed * dt and 2 * math.acos(cosine) <= self._turning * dt


Protocol = Literal["isotrak-binary", "fastrak-ascii", "fastrak-binary"]
PROTOCOLS: dict[str, tuple[type[Decoder], tuple[bytes, ...]]] = {
    "isotrak-binary": (IsotrakBinary, (b"O2,11\r", b"u", b"f")),
    "fastrak-ascii": (FastrakAscii, (b"O1,2,11,1\r", b"u", b"F")),
    "fastrak-binary": (FastrakBinary, (b"O1,2,11,0\r", b"u", b"f")),
}
"""Decoder and setup commands of each protocol: output list, metric units, ASCII (``F``) or binary (``f``)."""
STREAM, STOP, ASK = b"C", b"c", b"P"
RETRY_AFTER = 0.2
"""Time without an answer after which the tracker is asked again [s]."""


class Tracker:
    """Reader of the wrist's pose from a Polhemus tracker; no call waits."""

    def __init__(
        self,
        line: Line,
        protocol: Protocol,
        *,
        streams: bool = True,
        station: int = 1,
        jumps: JumpFilter | None = None,
    ) -> None:
        """Send the setup commands of the protocol to a tracker, which does not answer them.

        Args:
            line: an open port, at the baud rate that the tracker's switches say.
            protocol: which tracker and format; set to centimetres, metres come out.
            streams: whether it sends by itself, or is asked each time.
            station: of the receiver on the wrist.
            jumps: what refuses samples that no hand can make; the usual one if None.

        Raises:
            ValueError: for another protocol or station.
            LineError: if the line is gone.
        """
        if protocol not in PROTOCOLS:
            raise ValueError(f"protocol is {protocol!r}: expected {', '.join(PROTOCOLS)}")
        if not 1 <= station <= 4:
            raise ValueError(f"station is {station}: expected 1 to 4")
        decoder_type, setup_commands = PROTOCOLS[protocol]
        self.decoder = decoder_type()
        self.jumps = jumps or JumpFilter()
        self.sample: TrackerSample | None = None
        self.sampled_at = -math.inf
        """Arrival time of the sample [s]."""
        self._line, self._streams, self._station = line, streams, station
        self._asked_at, self._is_waiting = -math.inf, False
        line.write(STOP + b"".join(setup_commands) + (STREAM if streams else b""))

    def poll(self, timestamp: float) -> TrackerSample | None:
        """Decode the bytes that came and ask for the next sample if it does not stream; return the newest sample.

        Raises:
            LineError: if the line is gone.
        """
        for sample in self.decoder.feed(self._line.read()):
            self._is_waiting = False
            if sample.station == self._station and self.jumps.passes(timestamp, sample):
                self.sample, self.sampled_at = _continued(sample, self.sample), timestamp
        if not self._streams and (not self._is_waiting or timestamp - self._asked_at > RETRY_AFTER):
            self._is_waiting, self._asked_at = True, timestamp
            self._line.write(ASK)
        return self.sample

    def close(self) -> None:
        """Stop the stream, if the line is still there, and close it."""
        try:
            self._line.write(STOP)
        except LineError:
            self._is_waiting = False
        self._line.close()


def _continued(sample: TrackerSample, previous: TrackerSample | None) -> TrackerSample:
    """Choose the sign of a sample's quaternion that is nearer to the quaternion of the sample before."""
    if previous is None or np.dot(sample.quaternion, previous.quaternion) >= 0:
        return sample
    return TrackerSample(sample.station, sample.position, -sample.quaternion, sample.flag)
