"""Alignment of a tracker's transmitter with the world and of its receiver with the wrist: samples to hand poses.

A tracker says where its receiver is in the frame of its transmitter. Both are strapped on as it comes, so that neither
its axes nor its zero mean anything until three places have been shown: the hand at home, moved forward, and moved up.
The receiver sits beside the wrist's centre, so a hand that turns in place moves it. The lever arm between both is
fitted to samples of a hand that turns in place; without them it counts as zero.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxgrasp.files.printable import shortened
from jaxgrasp.files.replace import replace_file
from jaxgrasp.glove.other_devices.polhemus import TrackerSample

MIN_MOVE = 0.05
"""Shortest move that gives a direction to about a degree, with a tracker accurate to a millimetre [m]."""
MIN_ANGLE = 60.0
"""Smallest angle between the moves forward and up, which are meant to be square [deg]."""
OFF_ROTATION = 1e-6
"""Largest deviation of a stored rotation matrix from orthonormality."""
MAX_COORDINATE = 1e3
"""Largest coordinate in a stored alignment [m], beyond the reach of any tracker."""
MIN_TURN = 15.0
"""Smallest root mean square of the turning angle about the second of a hand's axes, by which the lever arm is found to
about four times the tracker's error [deg]."""
MAX_PIVOT_MOTION = 0.01
"""Largest root mean square of the distance by which the wrist's centre may move while the hand turns in place [m]."""
MAX_LEVER = 0.3
"""Largest lever arm from the wrist's centre to a receiver on hand or forearm [m]."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Rotations and zero position that map a tracker's samples to poses of the wrist."""

    transmitter: Float[np.ndarray, "3 3"]
    """Rotation from the transmitter's axes to the world's."""
    receiver: Float[np.ndarray, "3 3"]
    """Rotation from the wrist's axes to the receiver's."""
    zero: Float[np.ndarray, "3"]
    """Position of the receiver in the transmitter's frame when the wrist is at the world's origin, not turned [m]."""
    lever: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Position of the receiver in the wrist's frame, of which the wrist's centre is the origin [m]."""

    def pose(self, sample: TrackerSample) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Compute the wrist's origin ``(3,)`` [m] and rotation ``(3, 3)`` in the world from a sample."""
        rotation = self.transmitter @ rotation_of(sample.quaternion) @ self.receiver
        # p = T (s - zero) + lever is the receiver, and o = p - R lever the wrist.
        return self.transmitter @ (sample.position - self.zero) + self.lever - rotation @ self.lever, rotation


def at_home(home: TrackerSample, transmitter: Float[np.ndarray, "3 3"] | None = None) -> Alignment:
    """Compute the alignment that maps the home sample to the wrist at the origin, along the world's axes.

    Args:
        home: the sample.
        transmitter: turns the transmitter's axes into the world's; as they are where not given.
    """
    turn = np.eye(3) if transmitter is None else transmitter
    return Alignment(turn, (turn @ rotation_of(home.quaternion)).T, home.position)


def aligned(
    home: TrackerSample, forward: TrackerSample, up: TrackerSample, turned: Sequence[TrackerSample] = ()
) -> Alignment:
    """Compute the alignment from samples at home, moved from there along the world's x axis, and along its z axis.

    Args:
        home: sample of the hand at home.
        forward: sample of the hand moved along the world's x axis, not turned.
        up: sample of the hand moved from home along the world's z axis, not turned.
        turned: samples of a hand that turns in place, for the lever arm; the lever arm is zero without them.

    Raises:
        ValueError: for a move that is too short to tell a direction, moves that are not nearly square, and as
            ``with_lever`` does.
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
    alignment = at_home(home, np.stack([x, np.cross(z, x), z]))
    return with_lever(alignment, turned) if len(turned) else alignment


def with_lever(alignment: Alignment, turned: Sequence[TrackerSample]) -> Alignment:
    """Return an alignment with the lever arm that samples of a hand turning in place tell.

    The wrist's centre c stays where it is, so a receiver at the lever arm l, in its own axes, is at s = c + Q l in
    every sample with position s and rotation Q: linear least squares for c and l.

    Args:
        alignment: of the same tracker, as strapped on.
        turned: samples of a hand that turns about two axes at least, with its wrist's centre in one place.

    Raises:
        ValueError: for fewer than three samples, a hand that did not turn about two axes, a wrist that moved, and a
            lever arm that no receiver on a hand has.
    """
    if len(turned) < 3:
        raise ValueError(f"turned has {len(turned)} samples: expected 3 or more of a hand that turns in place")
    positions = np.stack([sample.position for sample in turned])
    rotations = np.stack([rotation_of(sample.quaternion) for sample in turned])
    # Without the means the pivot c drops out: s - mean s = (Q - mean Q) l.
    turns = (rotations - rotations.mean(0)).reshape(-1, 3)
    moves = (positions - positions.mean(0)).ravel()
    # The least of these is that of the axis about which the hand turned most: points on an axis do not move.
    spread = np.linalg.svd(turns, compute_uv=False)[-1] / math.sqrt(len(turned))
    if not spread >= math.radians(MIN_TURN):
        raise ValueError(
            f"turned holds turns of {math.degrees(spread):.0f} degrees (root mean square) about the second axis: "
            f"expected {MIN_TURN:.0f} or more; roll the hand and bend the wrist, both as far as they go"
        )
    lever, *_ = np.linalg.lstsq(turns, moves, rcond=None)
    motion = float(np.linalg.norm(moves - turns @ lever)) / math.sqrt(len(turned))
    if not motion <= MAX_PIVOT_MOTION:
        raise ValueError(
            f"the wrist moved by {1e3 * motion:.0f} mm (root mean square) while the hand turned: expected at most "
            f"{1e3 * MAX_PIVOT_MOTION:.0f} mm; rest the wrist on a table's edge"
        )
    if not np.linalg.norm(lever) <= MAX_LEVER:
        raise ValueError(
            f"the receiver seems to be {100 * np.linalg.norm(lever):.0f} cm from the wrist's centre: expected at most "
            f"{100 * MAX_LEVER:.0f} cm"
        )
    return replace(alignment, lever=alignment.receiver.T @ lever)


def rotation_of(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Convert a unit quaternion, real part first, to its rotation matrix."""
    w, v = quaternion[0], quaternion[1:]
    # NumPy alone, as all of the glove's side: a bench needs no SciPy. R = 1 + 2 w [v] + 2 [v][v].
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def save_alignment(alignment: Alignment, path: Path) -> None:
    """Write an alignment to a JSON file; an interrupted write leaves the old file unchanged."""
    fields = {name: getattr(alignment, name).tolist() for name in _SHAPES}
    text = json.dumps({"alignment": 1} | fields, indent=1) + "\n"
    replace_file(path, lambda stream: stream.write(text.encode()))


def load_alignment(path: Path) -> Alignment:
    """Read an alignment from a file that ``save_alignment`` wrote; the lever arm of older files is zero.

    Raises:
        ValueError: for a file that is none; the message names the entry, what stands there and what was expected.
    """
    try:
        contents = json.loads(path.read_text())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not JSON ({error})") from error
    if not isinstance(contents, dict) or contents.get("alignment") != 1:
        raise ValueError(f"{path} is not an alignment of a tracker: expected the entry 'alignment' to be 1")
    contents.setdefault("lever", [0.0, 0.0, 0.0])
    arrays = {name: _numbers(path, contents, name, shape) for name, shape in _SHAPES.items()}
    for name in ("transmitter", "receiver"):
        turn = arrays[name]
        if np.abs(turn @ turn.T - np.eye(3)).max() > OFF_ROTATION or np.linalg.det(turn) < 0:
            raise ValueError(f"{path}: {name} is not a rotation: expected orthonormal rows of determinant 1")
    return Alignment(**arrays)


_SHAPES = {"transmitter": (3, 3), "receiver": (3, 3), "zero": (3,), "lever": (3,)}


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
