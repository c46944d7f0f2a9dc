r"""Hand tracking of an OpenXR runtime as input: joints and wrist from lines of JSON, over UDP or a pipe; no forces.

A record is one line, and one datagram where it comes by UDP: the CRC-32 of the JSON text as eight hexadecimal digits,
a space, and the text. The text is an object of

=========  =================================================================================================
key        what it holds
=========  =================================================================================================
hand       ``"right"`` or ``"left"``
time       a clock of the sender that never runs backwards [s]
joints     26 rows, in the order of ``XrHandJointEXT``: position x, y, z [m] and orientation x, y, z, w, as the
           runtime's ``xrLocateHandJointsEXT`` gives them
=========  =================================================================================================

Only poses that the runtime marks as valid and tracked are to be sent. With ``joints`` from the runtime, a client is

    text = json.dumps({"hand": "right", "time": time.perf_counter(), "joints": joints}).encode()
    socket.sendto(b"%08x %s\n" % (zlib.crc32(text), text), ("127.0.0.1", 9110))

Each joint's frame has z towards the wrist and y out of the back of the hand (OpenXR 1.0, ``XR_EXT_hand_tracking``).
"""

import json
import math
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.files.file_values import is_number
from jaxgrasp.glove.glove_device import REOPEN, SILENCE, Capability, GloveDevice, LinkState, Reading
from jaxgrasp.glove.guard import Guard, GuardOutput
from jaxgrasp.glove.line import Line, LineError
from jaxgrasp.glove.model import FINGERS, FLEXIONS, GloveModel
from jaxgrasp.glove.other_devices.alignment import rotation_of
from jaxgrasp.glove.other_devices.polhemus import JumpFilter, TrackerSample
from jaxgrasp.validation.checked import checked

NO_FORCES = "hand tracking resists nothing: forces are shown instead of felt"
JOINTS = 26
WRIST = 1
MAX_LINE = 16_384
"""Largest number of bytes of a line."""
MAX_TIME, MAX_POSITION = 1e12, 100.0
"""Largest time [s] and coordinate [m] in a record."""
OFF_UNIT = 0.02
"""Largest deviation of an orientation's length from 1."""
BONE_LENGTHS = (0.003, 0.2)
"""Range of the distance between a joint and the next of its finger [m]."""
MAX_SPREAD = math.radians(60)
"""Largest angle by which a bone may leave the plane in which its finger bends [rad]."""
CHAINS = ((2, 3, 4, 5), *(tuple(range(first, first + 5)) for first in (6, 11, 16, 21)))
"""Joints of each finger from the palm to the tip."""
WORLD_FROM_XR = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""OpenXR's axes (x right, y up, z back) in ours (x forward, y left, z up), of the world and of the wrist."""


class HandRecord(NamedTuple):
    """Pose of all joints of a hand at one time."""

    hand: str
    time: float
    positions: Float[np.ndarray, "26 3"]
    quaternions: Float[np.ndarray, "26 4"]
    """Orientations of length 1, real part first."""


def read_hand_record(line: bytes) -> HandRecord | None:
    """Decode a line without its end; return None for a wrong sum, and values that no hand has."""
    if len(line) > MAX_LINE or line[8:9] != b" ":
        return None
    check, text = line[:8], line[9:]
    if check.lower() != b"%08x" % zlib.crc32(text):
        return None
    try:
        content = json.loads(text)
        hand, time, joints = content["hand"], content["time"], content["joints"]
        rows = np.array(joints, dtype=float)
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
        return None
    if hand not in ("right", "left") or not is_number(time, MAX_TIME) or rows.shape != (JOINTS, 7):
        return None
    if not np.all(np.isfinite(rows)) or np.abs(rows).max() > MAX_POSITION:
        return None
    positions, quaternions = rows[:, :3], rows[:, [6, 3, 4, 5]]
    lengths = np.linalg.norm(quaternions, axis=1)
    if np.abs(lengths - 1).max() > OFF_UNIT:
        return None
    for chain in CHAINS:
        bones = np.linalg.norm(np.diff(positions[list(chain)], axis=0), axis=1)
        if bones.min() < BONE_LENGTHS[0] or bones.max() > BONE_LENGTHS[1]:
            return None
    return HandRecord(hand, float(time), positions, quaternions / lengths[:, None])


def hand_angles(record: HandRecord) -> dict[str, float]:
    """Compute the angles of the joints of [`jaxgrasp.hand.human_hand`][] [rad]; NaN for a bone that points nowhere.

    Flexion is the angle by which a bone turns towards the palm in the frame of the one before it, and abduction the
    angle by which it leaves that plane; the thumb's own is that of its metacarpal out of the plane of the palm.
    """
    rotations = np.stack([rotation_of(quaternion) for quaternion in record.quaternions])
    forward = -rotations[:, :, 2]
    angles: dict[str, float] = {}
    # Towards the thumb: to the left on a right hand with its palm down.
    side = -1.0 if record.hand == "right" else 1.0
    for finger, chain in zip(FINGERS, CHAINS, strict=True):
        kinds = ("MP", "IP") if finger == "thumb" else ("MP", "PIP", "DIP")
        for kind, before, joint in zip(kinds, chain, chain[1:], strict=False):
            sideways, up, back = rotations[before].T @ forward[joint]
            angles[f"{finger} {kind}"] = math.atan2(-up, -back)
            if kind == "MP" and finger != "thumb":
                spread = math.asin(min(max(float(sideways), -1.0), 1.0))
                away = finger in ("ring", "little")
                angles[f"{finger} abduction"] = spread if abs(spread) <= MAX_SPREAD else math.nan
                angles[f"{finger} abduction"] *= side * (-1 if away else 1)
    _, up, _ = rotations[WRIST].T @ forward[CHAINS[0][0]]
    angles["thumb abduction"] = math.asin(min(max(float(-up), -1.0), 1.0))
    return angles


class RecordReader:
    """Decoder from bytes to records of one hand, each newer than the one before; it keeps few bytes."""

    def __init__(self, hand: str) -> None:
        """Create a decoder of the records of a hand, ``"right"`` or ``"left"``.

        Raises:
            ValueError: for another hand.
        """
        if hand not in ("right", "left"):
            raise ValueError(f"hand is {hand!r}: expected 'right' or 'left'")
        self.accepted = self.refused = self.stale = self.others = 0
        """Number of records that were taken, of lines that are none, of records no newer than the last, and of records
        of the other hand."""
        self._hand, self._buffer, self._time, self._taken_at = hand, b"", -math.inf, -math.inf

    def feed(self, timestamp: float, data: bytes) -> HandRecord | None:
        """Take bytes that came at a time [s]; return the newest record that they complete."""
        *lines, incomplete = (self._buffer + data).split(b"\n")
        # What is longer than any line is none, and neither is what follows it up to the next end.
        self._buffer = incomplete if len(incomplete) <= MAX_LINE else incomplete[:1] * (MAX_LINE + 1)
        newest = None
        for line in lines:
            if not line.strip(b"\r"):
                continue
            record = read_hand_record(line.strip(b"\r"))
            if record is None:
                self.refused += 1
            elif record.hand != self._hand:
                self.others += 1
            elif record.time <= self._time and timestamp - self._taken_at <= SILENCE:
                self.stale += 1
            else:
                self.accepted += 1
                # After a silence the sender may be another, with a clock of its own.
                self._time, self._taken_at, newest = record.time, timestamp, record
        return newest


@checked
def openxr() -> GloveModel:
    """Return the model of a tracked hand: 19 joints of [`jaxgrasp.hand.human_hand`][] without motors."""
    joints = (*FLEXIONS, *(f"{finger} abduction" for finger in FINGERS))
    return GloveModel("OpenXR hand tracking", joints, (0.0,) * len(joints))


class OpenXRHost(GloveDevice):
    """Device that reads a tracked hand, and resists nothing."""

    capability = Capability("nothing", measures_torque=False, outlives_host=False)

    def __init__(self, model: GloveModel, open_line: Callable[[], Line], guard: Guard, *, hand: str = "right") -> None:
        """Create a host whose line is not open yet.

        Args:
            model: joints that are read, without limits.
            open_line: opens the port; called again after each loss.
            guard: of the model.
            hand: whose records count, ``"right"`` or ``"left"``.

        Raises:
            ValueError: for a joint that hand tracking does not tell, a model with limits, and another hand.
        """
        tracked = openxr().joints
        for joint, limit in zip(model.joints, model.limits, strict=True):
            if joint not in tracked:
                raise ValueError(f"hand tracking does not tell the joint {joint!r}: expected {', '.join(tracked)}")
            if limit > 0:
                raise ValueError(f"the limit of {joint} is {limit:g}: expected 0, since {NO_FORCES}")
        self.model, self.guard = model, guard
        self.state, self.trouble = LinkState.CLOSED, "not opened yet"
        self.reading = Reading.empty(len(model.joints))
        self.records = RecordReader(hand)
        self.links = 0
        """Number of times that the link was established."""
        self._hand, self._open, self._next_attempt = hand, open_line, -math.inf
        self._line: Line | None = None

    def arm(self, timestamp: float, accepted: str = "") -> None:
        raise ValueError(f"there is nothing to arm: {NO_FORCES}")

    def poll(self, timestamp: float) -> Reading:
        try:
            if self._line is None and timestamp >= self._next_attempt:
                self._next_attempt = timestamp + REOPEN
                self._line = self._open()
                self.state, self.trouble = LinkState.GREETING, "no record of the hand has come"
            if self._line is not None:
                self._handle_record(timestamp, self.records.feed(timestamp, self._line.read()))
        except LineError as error:
            self._drop_line(timestamp, str(error))
        if self.state >= LinkState.LINKED and timestamp - self.reading.angles_at > SILENCE:
            self.guard.trip("the hand is not tracked")
            self.state, self.trouble = LinkState.GREETING, "the hand is not tracked"
        elif self.state == LinkState.GREETING and self.records.accepted == 0:
            self._explain()
        return self.reading

    def send(
        self, timestamp: float, requested: Any, measured_at: float, slope: np.ndarray | None = None
    ) -> GuardOutput:
        return self.guard.step(timestamp, requested, measured_at)

    def close(self, timestamp: float) -> None:
        self.disarm()
        if self._line is not None:
            self._line.close()
        self._line, self.state = None, LinkState.CLOSED

    def report(self) -> dict[str, Any]:
        counts = ("accepted", "refused", "stale", "others")
        return {"links": self.links} | {name: getattr(self.records, name) for name in counts}

    def _explain(self) -> None:
        if self.records.others:
            self.trouble = f"records of the other hand came, and none of the {self._hand} one"
        elif self.records.refused:
            self.trouble = f"{self.records.refused} lines came, none with a right check sum and 26 joints"

    def _handle_record(self, timestamp: float, record: HandRecord | None) -> None:
        if record is None:
            return
        all_angles = hand_angles(record)
        angles = np.array([all_angles[joint] for joint in self.model.joints])
        if not np.all(np.isfinite(angles)):
            self.records.accepted -= 1
            self.records.refused += 1
            return
        self.reading = replace(self.reading, angles=angles, angles_at=timestamp)
        if self.state < LinkState.LINKED:
            self.state, self.trouble = LinkState.LINKED, ""
            self.links += 1


class WristTracker:
    """Tracker that takes the wrist's pose from the records of a hand; no call waits."""

    def __init__(self, line: Line, *, hand: str = "right", jumps: JumpFilter | None = None) -> None:
        """Create a tracker on an open line.

        Args:
            line: of the records, for itself: the joints' reader needs another.
            hand: whose records count.
            jumps: what refuses samples that no hand can make; the usual one if None.

        Raises:
            ValueError: for another hand.
        """
        self.records = RecordReader(hand)
        self.jumps = jumps or JumpFilter()
        self.sample: TrackerSample | None = None
        self.sampled_at = -math.inf
        """Arrival time of the sample [s]."""
        self._line = line

    def poll(self, timestamp: float) -> TrackerSample | None:
        """Decode the bytes that came; return the newest pose of the wrist, in axes as ours.

        Raises:
            LineError: if the line is gone.
        """
        record = self.records.feed(timestamp, self._line.read())
        if record is not None:
            # R' = C R C^T turns both frames, q' = (w, C v) likewise.
            real, *imaginary = record.quaternions[WRIST]
            quaternion = np.array([real, *(WORLD_FROM_XR @ imaginary)])
            sample = TrackerSample(1, WORLD_FROM_XR @ record.positions[WRIST], quaternion, " ")
            if self.jumps.passes(timestamp, sample):
                self.sample, self.sampled_at = sample, timestamp
        return self.sample

    def close(self) -> None:
        """Close the line."""
        self._line.close()
