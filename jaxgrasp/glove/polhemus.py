"""Polhemus trackers: decoders of their bytes, the tracker on its line, and its alignment with hand and world.

Decoders go from bytes to poses of the wrist: Isotrak II binary, Fastrak ASCII and binary.

Formats as VRPN reads them (``vrpn_Tracker_Isotrak.C``, ``vrpn_Tracker_Fastrak.C``), with the output list "position,
quaternion" (``O2,11`` and ``O1,2,11``). A decoder takes bytes however they are cut, keeps fewer than 512 of them, and
raises nothing; what it refuses it counts, and tries again one byte on.

Alignment of a tracker's transmitter with the world and of its receiver with the wrist: samples to hand poses.

A tracker says where its receiver is in the frame of its transmitter. Both are strapped on as it comes, so that neither
its axes nor its zero mean anything until three places have been shown: the hand at home, moved forward, and moved up.

Tracker on a line, polled for each pose or streaming; it keeps the newest plausible sample.
"""

import json
import math
import struct
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxgrasp.files.printable import shortened
from jaxgrasp.files.replace import replace_file
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


MIN_MOVE = 0.05
"""Shortest move that gives a direction to about a degree, with a tracker accurate to a millimetre [m]."""
MIN_ANGLE = 60.0
"""Smallest angle between the moves forward and up, which are meant to be square [deg]."""
OFF_ROTATION = 1e-6
"""Largest deviation of a stored rotation matrix from orthonormality."""
MAX_COORDINATE = 1e3
"""Largest coordinate in a stored alignment [m], beyond the reach of any tracker."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Rotations and zero position that map a tracker's samples to poses of the wrist."""

    transmitter: Float[np.ndarray, "3 3"]
    """Rotation from the transmitter's axes to the world's."""
    receiver: Float[np.ndarray, "3 3"]
    """Rotation from the wrist's axes to the receiver's."""
    zero: Float[np.ndarray, "3"]
    """Position of the receiver in the transmitter's frame when the wrist is at the world's origin [m]."""

    def pose(self, sample: TrackerSample) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Compute the wrist's origin ``(3,)`` [m] and rotation ``(3, 3)`` in the world from a sample."""
        rotation = self.transmitter @ rotation_of(sample.quaternion) @ self.receiver
        return self.transmitter @ (sample.position - self.zero), rotation


def at_home(home: TrackerSample, transmitter: Float[np.ndarray, "3 3"] | None = None) -> Alignment:
    """Compute the alignment that maps the home sample to the wrist at the origin, along the world's axes.

    Args:
        home: the sample.
        transmitter: turns the transmitter's axes into the world's; as they are where not given.
    """
    turn = np.eye(3) if transmitter is None else transmitter
    return Alignment(turn, (turn @ rotation_of(home.quaternion)).T, home.position)


def aligned(home: TrackerSample, forward: TrackerSample, up: TrackerSample) -> Alignment:
    """Compute the alignment from samples at home, moved from there along the world's x axis, and along its z axis.

    Raises:
        ValueError: for a move that is too short to tell a direction, or moves that are not nearly square.
    """
    moves = {"forward": forward.position - home.position, "up": up.position - home.position}
    for name, move in moves.items():
        length = float(np.linalg.norm(move))
        if not length >= MIN_MOVE:
            raise ValueError(f"{name} is {100 * length:.1f} cm from home: expected {100 * MIN_MOVE:.0f} cm or more")
    x, z = (move / np.linalg.norm(move) for move in moves.values())
    angle = math.degrees(math.acos(float(np.clip(x @ z, -1, 1))))
    if not MIN_ANGLE <= angle <= 180 - MIN_ANGLE:
        raise ValueError(f"up is {angle:.0f} degrees from forward: expected about 90")
    # What is up counts whole; forward is made square to it.
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return at_home(home, np.stack([x, np.cross(z, x), z]))


def rotation_of(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Convert a unit quaternion, real part first, to its rotation matrix."""
    w, v = quaternion[0], quaternion[1:]
    # NumPy alone, as all of the glove's side: a bench needs no SciPy. R = 1 + 2 w [v] + 2 [v][v].
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def save_alignment(alignment: Alignment, path: Path) -> None:
    """Write an alignment to a JSON file; an interrupted write leaves the old file unchanged."""
    fields = {name: getattr(alignment, name).tolist() for name in ("transmitter", "receiver", "zero")}
    text = json.dumps({"alignment": 1} | fields, indent=1) + "\n"
    replace_file(path, lambda stream: stream.write(text.encode()))


def load_alignment(path: Path) -> Alignment:
    """Read an alignment from a file that ``save_alignment`` wrote.

    Raises:
        ValueError: for a file that is none; the message names the entry, what stands there and what was expected.
    """
    try:
        contents = json.loads(path.read_text())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not JSON ({error})") from error
    if not isinstance(contents, dict) or contents.get("alignment") != 1:
        raise ValueError(f"{path} is not an alignment of a tracker: expected the entry 'alignment' to be 1")
    arrays = {name: _numbers(path, contents, name, shape) for name, shape in _SHAPES.items()}
    for name in ("transmitter", "receiver"):
        turn = arrays[name]
        if np.abs(turn @ turn.T - np.eye(3)).max() > OFF_ROTATION or np.linalg.det(turn) < 0:
            raise ValueError(f"{path}: {name} is not a rotation: expected orthonormal rows of determinant 1")
    return Alignment(**arrays)


_SHAPES = {"transmitter": (3, 3), "receiver": (3, 3), "zero": (3,)}


def _numbers(path: Path, contents: dict, name: str, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.array(contents.get(name), float)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape != shape or not np.all(np.abs(array) <= MAX_COORDINATE):
        raise ValueError(
            f"{path}: {name} is {shortened(contents.get(name))}: "
            f"expected numbers of shape {shape}, up to {MAX_COORDINATE:g}"
        )
    return array


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
