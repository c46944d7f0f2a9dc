"""Grasp files, version 1, as columns of any kind of archive: headers are checked, then few grasps are read at a time.

    version    (optional) 1
    points     (N, n, 3), or flat (M, 3) with offsets (N + 1,), [m]
    normals    like points; unit, into the object
    friction   (N, n) or (M,)
    squeeze    (N, n) or (M,) [N]
    torsion, normal_min, normal_max   (optional) like friction: of soft fingers [m], of limits [N]
    torque_map, torque_max   (optional, both) contact Jacobians (N, n, 3 or 4, j) or (M, 3 or 4, j), and (N, j) [N.m]
    offsets    (N + 1,) integers, only with flat columns
    wrench     (N, 6), or (N, W, 6) for W wrenches a grasp [N, N.m]
    name, source, object, hand   (optional) (N,) text

Other columns are not used, and a warning names them.
"""

import os
import sys
from collections import Counter
from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import numpy as np

from jaxgrasp.batch.contact_sets import CONTACT_FIELDS, OPTIONAL_FIELDS, OPTIONAL_NUMBERS, ContactSets, as_wrenches
from jaxgrasp.batch.file_error import GraspFileError, describe_unknown, warn_unused_columns
from jaxgrasp.files.printable import LARGEST

VERSION = 1
LABELS = ("name", "source", "object", "hand")
BY_CONTACT = (*CONTACT_FIELDS, *OPTIONAL_FIELDS)
NUMBERS = (*BY_CONTACT, "wrench", "torque_max")
COLUMN_NAMES = ("version", *NUMBERS, "offsets", *LABELS)
OF_SIMULATION = ("seed", "stiffness", "depth", "normal_force", "simulated_force", "mass", "link", "grip", "sample")
"""Columns by which the shipped grips say how they were simulated: a file that has all of them is not warned of them."""
LONGEST_LABEL = 1_000
"""Characters of a grasp's name, source, object or hand: every one of a column takes as much memory as its longest."""


MOST_OF_A_GRASP = 100_000
"""Largest number of contacts, or of wrenches, of a single grasp."""


@runtime_checkable
class ColumnOfRows(Protocol):
    """Protocol of an array in an archive that is read forward, a few rows at a time."""

    shape: tuple[int, ...]
    dtype: np.dtype

    def take(self, rows: int) -> np.ndarray: ...

    def skip(self, rows: int) -> None: ...

    def read_all(self) -> np.ndarray: ...

    def close(self) -> None: ...


@runtime_checkable
class Archive(Protocol):
    """Protocol of a file that holds columns by their names."""

    names: list[str]

    @property
    def path(self) -> os.PathLike: ...

    def checksum(self) -> int: ...

    def column(self, name: str) -> ColumnOfRows: ...

    def close(self) -> None: ...


class ColumnarGrasps:
    """A grasp file, open for reading. ``fill`` stands in for columns that the file lacks."""

    def __init__(self, archive: Archive, fill: dict[str, float] | None = None):
        self.path = archive.path
        self._fill = fill or {}
        self._archive = archive
        try:
            self._read_headers()
        except BaseException:
            archive.close()
            raise

    def _read_headers(self) -> None:
        """Read and check the names, types, shapes and offsets of the columns, but not their numbers."""
        self.names = self._archive.names
        self._check_names()
        self._headers = {name: self._archive.column(name) for name in self.names if name in COLUMN_NAMES}
        self._shapes = {name: column.shape for name, column in self._headers.items()}
        self._check_version()
        self._check_types()
        self.offsets = self._read_offsets()
        self._check_shapes()
        is_simulated = set(OF_SIMULATION) <= set(self.names)
        names = [name for name in self.names if not (is_simulated and name in OF_SIMULATION)]
        warn_unused_columns(self.path, names, COLUMN_NAMES)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __enter__(self) -> "ColumnarGrasps":
        return self

    def __exit__(self, *_) -> None:
        self._archive.close()

    @property
    def wrenches(self) -> int:
        shape = self._shapes["wrench"]
        return shape[1] if len(shape) == 3 else 1

    @property
    def largest(self) -> int:
        return int(np.diff(self.offsets).max(initial=0))

    @property
    def fingerprint(self) -> int:
        """Checksum of the contents."""
        return self._archive.checksum()

    def chunks(self, size: int, start: int = 0) -> Iterator[ContactSets]:
        """Yield the grasps from ``start`` on, ``size`` at a time, in order."""
        columns = {name: self._archive.column(name) for name in (*NUMBERS, *LABELS) if name in self._headers}
        per_contact = "offsets" in self._shapes
        try:
            for name, column in columns.items():
                by_contact = name in BY_CONTACT and per_contact
                column.skip(int(self.offsets[start]) if by_contact else start)
            for first in range(start, len(self), size):
                last = min(first + size, len(self))
                yield self._rows(columns, first, last, per_contact)
        finally:
            for column in columns.values():
                column.close()

    def read(self) -> ContactSets:
        """Read all grasps of the file."""
        return next(self.chunks(max(1, len(self))))

    def _rows(self, columns: dict[str, ColumnOfRows], first: int, last: int, per_contact: bool) -> ContactSets:
        contacts = int(self.offsets[last] - self.offsets[first])
        taken = {}
        for name, column in columns.items():
            taken[name] = column.take(contacts if name in BY_CONTACT and per_contact else last - first)
        dtype = np.result_type(*(taken[name].dtype for name in taken if name not in LABELS), np.float32)
        flat = {name: np.full(contacts, value, dtype) for name, value in self._fill.items() if name not in taken}
        leading = 1 if per_contact else 2
        for name in BY_CONTACT:
            if name in taken:
                tail = taken[name].shape[leading:]
                flat[name] = taken[name].reshape(contacts, *tail).astype(dtype, copy=False)
        if "torque_max" in taken:
            flat["torque_max"] = taken["torque_max"].astype(dtype, copy=False)
        return ContactSets(
            **flat,
            offsets=self.offsets[first : last + 1] - self.offsets[first],
            wrench=as_wrenches(taken["wrench"].astype(dtype, copy=False), last - first),
            labels={name: self._text(name, taken[name]) for name in LABELS if name in taken},
        )

    def _text(self, name: str, column: np.ndarray) -> np.ndarray:
        if column.dtype.kind == "U":
            if np.any(np.ascontiguousarray(column).view(column.dtype.byteorder + "u4") > sys.maxunicode):
                raise GraspFileError(self.path, f"{name} holds characters that are not Unicode")
            return column
        try:
            return np.char.decode(column, "utf-8")
        except UnicodeDecodeError as error:
            raise GraspFileError(self.path, f"{name} holds bytes that are not UTF-8 ({error})") from error

    def _check_names(self) -> None:
        duplicates = sorted(name for name, times in Counter(self.names).items() if times > 1)
        if duplicates:
            raise GraspFileError(self.path, f"it has the column {duplicates[0]!r} twice")
        required = [name for name in (*CONTACT_FIELDS, "wrench") if name not in self._fill]
        missing = [name for name in required if name not in self.names]
        if missing:
            hint = "".join(
                f"; jaxgrasp evaluate --{name} gives one value to all"
                for name in missing
                if name in ("friction", "squeeze")
            )
            if "wrench" in missing:
                hint += "; wrench (N, 6) is the load that the hand must exert: jaxgrasp.weight_wrench computes it"
            if similar := describe_unknown(self.names, COLUMN_NAMES, only_close=True):
                hint = f"; it has {', '.join(similar)}{hint}"
            present = ", ".join(self.names)[:LARGEST] or "nothing"
            raise GraspFileError(self.path, f"it lacks {', '.join(map(repr, missing))} and holds {present}{hint}")

    def _check_version(self) -> None:
        if "version" not in self._headers:
            return
        column = self._headers["version"]
        if column.shape or column.dtype.kind not in "iu":
            raise GraspFileError(
                self.path, f"version is {column.dtype} of shape {column.shape}: expected the integer {VERSION}"
            )
        version = int(column.read_all())
        if version != VERSION:
            raise GraspFileError(self.path, f"its version is {version}: this jaxgrasp reads version {VERSION}")

    def _check_types(self) -> None:
        dtypes = {name: column.dtype for name, column in self._headers.items()}
        for name in (*NUMBERS, "offsets"):
            dtype = dtypes.get(name)
            if dtype is not None and (dtype.kind not in "fiu" or dtype.itemsize > 8):
                raise GraspFileError(self.path, f"{name} holds {dtype}: expected numbers of at most 64 bits")
        for name in LABELS:
            if name not in dtypes:
                continue
            dtype = dtypes[name]
            if dtype.kind not in "US":
                raise GraspFileError(self.path, f"{name} holds {dtype}: expected text")
            length = dtype.itemsize // np.dtype(f"{dtype.kind}1").itemsize
            if not 0 < length <= LONGEST_LABEL:
                raise GraspFileError(
                    self.path, f"{name} holds text of {length:,} characters: expected 1 to {LONGEST_LABEL:,}"
                )

    def _read_offsets(self) -> np.ndarray:
        shape = self._shapes["points"]
        if "offsets" not in self._shapes:
            if len(shape) != 3 or shape[2] != 3:
                raise GraspFileError(
                    self.path, f"points has shape {shape}: expected (N, n, 3), or (M, 3) with a column 'offsets'"
                )
            if shape[1] == 0:
                raise GraspFileError(self.path, f"points has shape {shape}: expected at least one contact a grasp")
            return np.arange(shape[0] + 1, dtype=np.int64) * shape[1]
        if not shape:
            raise GraspFileError(self.path, "points is a single number: expected (M, 3)")
        column = self._headers["offsets"]
        if len(column.shape) != 1 or column.shape[0] == 0 or column.dtype.kind not in "iu":
            raise GraspFileError(
                self.path, f"offsets is {column.dtype} of shape {column.shape}: expected (N + 1,) integers"
            )
        offsets = column.read_all().astype(np.int64)
        falling = np.flatnonzero(np.diff(offsets) < 0)
        if offsets[0] != 0 or len(falling) or offsets[-1] != shape[0]:
            at = 0 if offsets[0] != 0 else (int(falling[0]) + 1 if len(falling) else len(offsets) - 1)
            raise GraspFileError(
                self.path,
                f"offsets[{at}] is {offsets[at]}: expected them to rise from 0 to {shape[0]}, the number of points",
            )
        return offsets

    def _check_shapes(self) -> None:
        contacts = self._shapes["points"][:1] if "offsets" in self._shapes else self._shapes["points"][:2]
        expected = {"points": (*contacts, 3), "normals": (*contacts, 3), "friction": contacts, "squeeze": contacts}
        expected |= dict.fromkeys(OPTIONAL_NUMBERS, contacts)
        for name, shape in expected.items():
            if name in self._shapes and self._shapes[name] != shape:
                raise GraspFileError(
                    self.path, f"{name} has shape {self._shapes[name]}: expected {shape}, to fit points"
                )
        self._check_torque_shapes(contacts)
        wrench = self._shapes["wrench"]
        if len(wrench) not in (2, 3) or wrench[0] != len(self) or wrench[-1] != 6 or 0 in wrench[1:]:
            raise GraspFileError(
                self.path, f"wrench has shape {wrench}: expected ({len(self)}, 6) or ({len(self)}, W, 6)"
            )
        for noun, count in (("contacts", self.largest), ("wrenches", self.wrenches)):
            if count > MOST_OF_A_GRASP:
                raise GraspFileError(
                    self.path,
                    f"a grasp has {count:,} {noun}: expected at most {MOST_OF_A_GRASP:,}, as it is read whole",
                )
        for name in LABELS:
            if name in self._shapes and self._shapes[name] != (len(self),):
                raise GraspFileError(self.path, f"{name} has shape {self._shapes[name]}: expected ({len(self)},)")
        if len(self) == 0:
            raise GraspFileError(self.path, "it holds no grasps")

    def _check_torque_shapes(self, contacts: tuple[int, ...]) -> None:
        present = [name for name in ("torque_map", "torque_max") if name in self._shapes]
        if len(present) == 1:
            missing = "torque_max" if present == ["torque_map"] else "torque_map"
            raise GraspFileError(self.path, f"it has {present[0]!r} and lacks {missing!r}: expected both, or neither")
        if not present:
            return
        shape = self._shapes["torque_map"]
        if len(shape) != len(contacts) + 2 or shape[:-2] != contacts or shape[-2] not in (3, 4) or shape[-1] == 0:
            leading = ", ".join(map(str, contacts))
            raise GraspFileError(
                self.path, f"torque_map has shape {shape}: expected ({leading}, 3 or 4, joints), to fit points"
            )
        expected = (len(self), shape[-1])
        if self._shapes["torque_max"] != expected:
            raise GraspFileError(
                self.path,
                f"torque_max has shape {self._shapes['torque_max']}: expected {expected}, to fit torque_map",
            )


def columns_to_save(sets: ContactSets) -> dict[str, np.ndarray]:
    """Return the columns of a grasp file with these sets: ``(N, n, ...)`` for equal sizes, else flat with offsets."""
    uniform = len(sets) > 0 and np.all(sets.sizes == sets.largest)
    columns = {name: np.ascontiguousarray(array) for name, array in sets.columns.items()}
    if uniform:
        columns = {name: a.reshape(len(sets), sets.largest, *a.shape[1:]) for name, a in columns.items()}
    else:
        columns["offsets"] = np.asarray(sets.offsets, np.int64)
    if sets.torque_max is not None:
        columns["torque_max"] = np.ascontiguousarray(sets.torque_max)
    wrench = np.ascontiguousarray(sets.wrench[:, 0] if sets.wrenches == 1 else sets.wrench)
    texts = {name: np.asarray(values, str) for name, values in sets.labels.items()}
    return {"version": np.array(VERSION), "wrench": wrench, **columns, **texts}
