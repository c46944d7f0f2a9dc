"""Alignment of a tracker's transmitter with the world and of its receiver with the wrist: samples to hand poses.

A tracker says where its receiver is in the frame of its transmitter. Both are strapped on as it comes, so that neither
its axes nor its zero mean anything until three places have been shown: the hand at home, moved forward, and moved up.
"""

import json
import math
from dataclasses import dataclass
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
