"""Records of files from anywhere: read one by one, checked before they are used, and named where they are bad.

Grasps that say where a hand or gripper stands, not where it touches: what every reader of such files returns.

Grasps that say where a hand touches, and for most of them with which forces: what readers of such files return.
"""

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from os.path import isfile
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from jaxgrasp.files.file_values import nearest
from jaxgrasp.files.printable import message_line, printable, shortened
from jaxgrasp.model.hand import Hand
from jaxgrasp.numerics.geometry import is_rotation

Read = TypeVar("Read")

ROUNDING = 1e-4
"""Largest deviation of a rotation in a file from orthonormal: many are written in single precision."""
UNIT_ROUNDING = 1e-2
"""Largest deviation of a unit vector's or quaternion's length from 1: some files have three digits."""
BEYOND_LIMITS = 0.05
"""Largest excess of a joint beyond its limits [rad, m]: simulators let them give way."""
LARGEST = 1e100
"""No quantity is this large, and what is can be squared."""
MOST_BYTES = 2**28
"""Larger texts are refused: they are no lists of grasps."""


def read_each(
    path: str | Path,
    records: Iterable[tuple[str, Any]],
    read: Callable[[Any], Read],
    keep_going: bool,
    noun: str = "record",
) -> tuple[list[tuple[str, Read]], tuple[str, ...]]:
    """Read each record of a file; return the results with their names, and messages on records left out.

    Raises:
        ValueError: for the first bad record unless ``keep_going``, and for a file without a good one.
    """
    results, left_out = [], []
    for name, record in records:
        try:
            results.append((name, read(record)))
        except ValueError as error:
            message = f"{path}: {noun} {name}: {error}"
            if not keep_going:
                raise ValueError(message) from None
            left_out.append(message)
    if not results:
        raise ValueError(f"{left_out[0]}; every other {noun} is bad too" if left_out else f"{path} holds no {noun}s")
    return results, tuple(left_out)


def warn_unused(kind: str, names: Iterable[Any], used: Iterable[str]) -> None:
    """Warn by name of the fields of a file that its reader does not use.

    The warning names the ``kind`` of file and not the file, so that Python shows it once for all files of a folder.
    """
    unused = sorted({str(name) for name in names} - set(used))
    if unused:
        warnings.warn(message_line(f"{kind}: fields that are not used: {', '.join(unused)}"), stacklevel=4)


def read_text(path: str | Path) -> str:
    """Read a text file.

    Raises:
        ValueError: for one that is too large or no text.
        OSError: for one that cannot be read.
    """
    path = Path(path)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} has {path.stat().st_size} bytes: expected {MOST_BYTES} at most")
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not text in UTF-8") from None


def numbers(name: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """Convert a value to an array of finite numbers in float64; None in ``shape`` stands for any size.

    Raises:
        ValueError: naming the entry that is none, or the shape that it has.
    """
    try:
        array = np.asarray(value)
    except (ValueError, OverflowError):
        raise ValueError(f"{name} is {shortened(value)}: expected an array {_shape_words(shape)}") from None
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} is {shortened(value)}: expected an array of numbers {_shape_words(shape)}")
    if array.ndim != len(shape) or any(expected not in (None, size) for expected, size in zip(shape, array.shape)):
        raise ValueError(f"{name} has the shape {array.shape}: expected {_shape_words(shape)}")
    array = array.astype(float)
    bad = np.argwhere(~(np.abs(array) < LARGEST))
    if len(bad):
        index = f"[{', '.join(map(str, bad[0]))}]" if array.ndim else ""
        raise ValueError(f"{name}{index} is {array[tuple(bad[0])]}: expected a finite number")
    return array


def number(name: str, value: Any) -> float:
    """Convert a value to a finite number."""
    try:
        return float(numbers(name, value, ()))
    except ValueError:
        # Texts keep their quotes; arrays are shorter without their type.
        text = shortened(value) if isinstance(value, str | bytes) else printable(str(value)[:40])
        raise ValueError(f"{name} is {text}: expected a finite number") from None


def positive(name: str, value: Any) -> float:
    """Convert a value to a finite number above zero."""
    parsed = number(name, value)
    if not parsed > 0:
        raise ValueError(f"{name} is {parsed:g}: expected a positive number")
    return parsed


def field(record: Any, name: str) -> Any:
    """Return the entry of a record under a name."""
    if not isinstance(record, dict):
        raise ValueError(f"it is {shortened(record)}: expected fields by their names")
    if name not in record:
        raise ValueError(f"it has no {name!r}{nearest(name, [printable(str(key)[:40]) for key in list(record)[:40]])}")
    return record[name]


def directions(name: str, value: Any) -> np.ndarray:
    """Convert a value to unit vectors ``(n, 3)``, normalised to exactly unit length."""
    array = numbers(name, value, (None, 3))
    length = np.linalg.norm(array, axis=1, keepdims=True)
    bad = np.flatnonzero(np.abs(length[:, 0] - 1) > UNIT_ROUNDING)
    if len(bad):
        raise ValueError(f"{name}[{bad[0]}] has the length {length[bad[0], 0]:.3g}: expected a unit vector")
    return array / length


def rotation(name: str, quaternion: Any) -> np.ndarray:
    """Convert a unit quaternion w, x, y, z to its rotation matrix."""
    q = numbers(name, quaternion, (4,))
    length = np.linalg.norm(q)
    if not abs(length - 1) <= UNIT_ROUNDING:
        raise ValueError(f"{name} has the length {length:.3g}: expected a unit quaternion w, x, y, z")
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


def pose(name: str, value: Any) -> np.ndarray:
    """Convert a position x, y, z and a unit quaternion w, x, y, z to a transform ``(4, 4)``."""
    seven = numbers(name, value, (7,))
    return frame(seven[:3], rotation(f"{name}[3:]", seven[3:]))


def frame(origin: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Build transforms ``(..., 4, 4)`` from an origin and from axes as columns."""
    transforms = np.zeros((*axes.shape[:-2], 4, 4))
    transforms[..., :3, :3], transforms[..., :3, 3], transforms[..., 3, 3] = axes, origin, 1
    return transforms


def transform(name: str, value: Any) -> np.ndarray:
    """Convert a value to a rigid transform ``(4, 4)``."""
    array = numbers(name, value, (4, 4))
    if not (is_rotation(array[:3, :3], ROUNDING) and np.array_equal(array[3], [0, 0, 0, 1])):
        raise ValueError(f"{name} is not a pose: expected a rotation and an origin above the row 0 0 0 1")
    return array


def rigid_axes(name: str, value: Any) -> np.ndarray:
    """Convert a value to rotations ``(n, 3, 3)``, with columns of exactly unit length."""
    array = numbers(name, value, (None, 3, 3))
    bad = np.flatnonzero(~is_rotation(array, UNIT_ROUNDING))
    if len(bad):
        raise ValueError(f"{name}[{bad[0]}] is not a rotation: expected orthonormal columns")
    return array / np.linalg.norm(array, axis=-2, keepdims=True)


def by_name(values: dict, names: Sequence[str], source: str) -> np.ndarray:
    """Return the values in the order of the wanted names.

    Raises:
        ValueError: listing the names that are unknown and those that are missing, with the nearest.
    """
    unknown = [str(name)[:40] for name in values if name not in names]
    missing = [name for name in names if name not in values]
    lines = [f"{source} has {name!r}, which the hand does not have{nearest(name, names)}" for name in unknown[:5]]
    if missing:
        present = [printable(str(name)[:40]) for name in values]
        lines += [f"{source} has no {name!r}, which the hand has{nearest(name, present)}" for name in missing[:5]]
    if lines:
        raise ValueError("; ".join(lines))
    return np.array([number(name, values[name]) for name in names])


def by_order(name: str, values: Any, hand: Hand) -> np.ndarray:
    """Read joint values that a file has in the hand's own order, which is checked by count and limits only.

    Raises:
        ValueError: for another count, or a joint far beyond its limits, as it is where the order is another one.
    """
    angles = numbers(name, values, (None,))
    if len(angles) != len(hand.joints):
        raise ValueError(f"{name} has {len(angles)} joints: expected {len(hand.joints)}, those of the hand")
    lower, upper = np.asarray(hand.lower), np.asarray(hand.upper)
    beyond = np.flatnonzero((angles < lower - BEYOND_LIMITS) | (angles > upper + BEYOND_LIMITS))
    if len(beyond):
        joint = beyond[0]
        raise ValueError(
            f"{name}[{joint}] is {angles[joint]:.3g}, but the hand's {hand.joints[joint]!r} goes from "
            f"{lower[joint]:.3g} to {upper[joint]:.3g}: is it this hand, in this order?"
        )
    return angles


def _shape_words(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('any' if size is None else str(size) for size in shape)})" if shape else "of one"


LONGEST_PATH = 4096
"""Characters of a path; no file has a longer one."""


@dataclass(frozen=True)
class GraspPoses:
    """N grasps of one object; what the file does not say is None."""

    path: Path
    names: tuple[str, ...]
    """Each grasp's name in its file, or its number there."""
    transforms: Float[np.ndarray, "N 4 4"]
    """Poses of the wrist or the gripper; in the mesh's frame, or where ``objects`` is given in the one that both stand
    in. Lengths in metres."""
    angles: Float[np.ndarray, "N J"] | None = None
    """Positions of the hand's joints [rad, m]; None of a hand that is to close."""
    scales: Float[np.ndarray, "N"] | None = None
    """Metres for one unit of the object's mesh."""
    objects: Float[np.ndarray, "N 4 4"] | None = None
    """Poses of the mesh; at the origin where None."""
    mesh: str | None = None
    """The mesh's path as the file has it."""
    mesh_parts: int = 1
    """Number of last parts of that path that tell the object: all objects may have the same file name."""
    mass: float | None = None
    """Mass of the object [kg]."""
    friction: float | None = None
    center_of_mass: Float[np.ndarray, "3"] | None = None
    """In the mesh's frame [m]."""
    succeeded: Bool[np.ndarray, "N"] | None = None
    """True for grasps that held in the simulator that the file comes from."""
    confidence: Float[np.ndarray, "N"] | None = None
    """How good each grasp is, from 0 to 1, where the file says so; NaN of a grasp of which it does not."""
    left_out: tuple[str, ...] = ()
    """Messages on the records that were left out."""

    def __len__(self) -> int:
        return len(self.transforms)

    def rows(self, chosen: np.ndarray) -> "GraspPoses":
        """Return the grasps of the given indices or mask."""
        by_grasp = ("transforms", "angles", "scales", "objects", "succeeded", "confidence")
        changed = {name: array[chosen] for name in by_grasp if (array := getattr(self, name)) is not None}
        return replace(self, names=tuple(self.names[i] for i in chosen), **changed)

    def mesh_path(self, folder: Path | None = None) -> Path | None:
        """Find the mesh in a folder, or beside the file and in the folders above it; None where it is not there."""
        return None if self.mesh is None else find_named(self.mesh, self.mesh_parts, self.path, folder)


def find_named(name: str, least: int, beside: Path, folder: Path | None = None) -> Path | None:
    """Find a file that another file names: under a folder, or beside that file and in the folders above it.

    Paths that only the machine had that wrote the file are tried from each of their parts on, as long as ``least``
    parts are left.
    """
    if len(name) > LONGEST_PATH:
        return None
    folders = beside.resolve().parents if folder is None else (folder,)
    parts = Path(name).parts
    for directory in folders:
        for first in range(max(1, len(parts) - least + 1)):
            candidate = directory / Path(*parts[first:])
            # Path.is_file raises for a name that is too long: no such file exists.
            if isfile(candidate):
                return candidate
    return None


MESH_PARTS = 3
"""Number of last parts of a mesh's path that tell the object: the file's own name is that of every object."""
PULL = 0.05
"""Largest pull of a normal force that is accepted, as a share of the largest force: solvers reach no exact zero."""


@dataclass(frozen=True)
class ContactRecords:
    """N grasps of M contacts in all, in the world of their file."""

    path: Path
    names: tuple[str, ...]
    """Each grasp's name in its file."""
    points: Float[np.ndarray, "M 3"]
    """[m]"""
    normals: Float[np.ndarray, "M 3"]
    """Unit vectors into the object."""
    pressures: Float[np.ndarray, "M"]
    """Normal forces in the file's own unit; NaN where it has none."""
    offsets: np.ndarray
    """``(N + 1,)``: grasp i owns contacts ``offsets[i]:offsets[i + 1]``."""
    centers: Float[np.ndarray, "N 3"]
    """Centre of mass of the object; NaN where the file does not say it [m]."""
    loads: Float[np.ndarray, "N 6"]
    """Loads on the object in the file, about the world's origin, in the file's own unit of force."""
    objects: Float[np.ndarray, "N 4 4"] | None = None
    """Poses of the mesh."""
    scales: Float[np.ndarray, "N 3"] | None = None
    """Metres for one unit of the mesh, along its axes."""
    mesh: str | None = None
    """The mesh's path as the file has it."""
    left_out: tuple[str, ...] = ()
    """Messages on the records that were left out."""

    def __len__(self) -> int:
        return len(self.names)

    def mesh_path(self, folder: Path | None = None) -> Path | None:
        """Find the mesh in a folder, or beside the file and in the folders above it; None where it is not there."""
        return None if self.mesh is None else find_named(self.mesh, MESH_PARTS, self.path, folder)


class OneGrasp(NamedTuple):
    """The contacts of a grasp, before it is put among others."""

    points: np.ndarray
    normals: np.ndarray
    pressures: np.ndarray
    center: np.ndarray
    load: np.ndarray


def contact_records(
    path: str | Path, named_grasps: Sequence[tuple[str, OneGrasp]], left_out: tuple[str, ...], **fields: Any
) -> ContactRecords:
    """Concatenate grasps of different numbers of contacts into the records of a file."""
    grasps = [grasp for _, grasp in named_grasps]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(grasp, name) for grasp in grasps]) for name in ("points", "normals", "pressures")
    }
    return ContactRecords(
        path=Path(path),
        names=tuple(name for name, _ in named_grasps),
        **columns,
        offsets=np.concatenate([[0], np.cumsum([len(grasp.points) for grasp in grasps])]),
        centers=np.stack([grasp.center for grasp in grasps]),
        loads=np.stack([grasp.load for grasp in grasps]),
        left_out=left_out,
        **fields,
    )


def pressing(name: str, forces: np.ndarray) -> np.ndarray:
    """Check that normal forces press, and return them with small pulls set to zero.

    Raises:
        ValueError: for one that pulls: normals or forces point the other way than the format says.
    """
    bad = np.flatnonzero(forces < -PULL * np.abs(forces).max(initial=0))
    if len(bad):
        raise ValueError(
            f"{name}[{bad[0]}] pulls with {-forces[bad[0]]:.3g}: expected normals and forces into the object"
        )
    return np.maximum(forces, 0)
