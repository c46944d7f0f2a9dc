"""Where grasps come from: a file of any kind we read, as a stream of contact sets, adjusted as the user asks."""

import os
import warnings
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from jaxgrasp.batch.columnar import LABELS, LONGEST_LABEL
from jaxgrasp.batch.contact_sets import ContactSets, as_sets
from jaxgrasp.batch.csv_file import read_csv, write_csv
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.hdf5_file import open_hdf5, write_hdf5
from jaxgrasp.batch.npz_file import open_npz, write_npz
from jaxgrasp.batch.parquet_file import open_parquet, write_parquet
from jaxgrasp.batch.remote_file import RemoteFile, read_place
from jaxgrasp.files.printable import shortened
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.faults import GraspError
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits

POINT_AWAY = "most normals point away from the middle of their grasp"
MOSTLY = 0.8
"""Share of grasps from which all are suspected."""
ROUNDING = 1e-3
"""Part of the distances: as far as normals out of files may be off."""
MILLIMETRES_LIKELY = 2.0
"""A contact this far from its grasp's middle [m] is no hand's; as millimetres it would be."""


@runtime_checkable
class GraspSource(Protocol):
    """Grasps that can be read chunk by chunk, until the block ends that they are opened for."""

    @property
    def wrenches(self) -> int: ...

    @property
    def largest(self) -> int: ...

    @property
    def fingerprint(self) -> int:
        """A checksum of the contents."""
        ...

    def __len__(self) -> int: ...

    def __enter__(self) -> "GraspSource": ...

    def __exit__(self, *_) -> None: ...

    def chunks(self, size: int, start: int = 0) -> Iterator[ContactSets]: ...


class MemorySource:
    """Contact sets that are in memory already."""

    def __init__(self, sets: ContactSets):
        self._sets = sets

    def __len__(self) -> int:
        return len(self._sets)

    def __enter__(self) -> "MemorySource":
        return self

    def __exit__(self, *_) -> None: ...

    @property
    def wrenches(self) -> int:
        return self._sets.wrenches

    @property
    def largest(self) -> int:
        return self._sets.largest

    @property
    def fingerprint(self) -> int:
        sum_, sets = 0, self._sets
        arrays = [*sets.columns.values(), sets.offsets, sets.wrench]
        for array in (*arrays, *([] if sets.torque_max is None else [sets.torque_max])):
            sum_ = zlib.crc32(np.ascontiguousarray(array).tobytes(), sum_)
        return sum_

    def chunks(self, size: int, start: int = 0) -> Iterator[ContactSets]:
        for first in range(start, len(self), size):
            yield self._sets.rows(slice(first, first + size))


@dataclass(frozen=True)
class Adjustments:
    """What the user says about data that differ from our conventions."""

    outward_normals: bool = False
    friction: float | None = None
    """Replaces the file's, or stands in for a missing column."""
    squeeze: float | None = None
    torsion: float | None = None
    """Makes every contact with friction a soft finger of this torsional coefficient [m], in place of the file's."""

    @property
    def fill(self) -> dict[str, float]:
        return {name: value for name in ("friction", "squeeze") if (value := getattr(self, name)) is not None}

    def apply(self, sets: ContactSets) -> ContactSets:
        changes = {name: np.full_like(getattr(sets, name), value) for name, value in self.fill.items()}
        if self.torsion is not None:
            friction = changes.get("friction", sets.friction)
            changes["torsion"] = np.where(friction > 0, friction.dtype.type(self.torsion), 0)
        elif self.friction == 0 and sets.torsion is not None:
            # A contact without friction has no torsional friction either.
            changes["torsion"] = np.zeros_like(sets.torsion)
        if self.outward_normals:
            changes["normals"] = -sets.normals
        return replace(sets, **changes) if changes else sets


def open_source(path: str | os.PathLike, adjustments: Adjustments = Adjustments()) -> GraspSource:
    """The grasps of a file of any kind that we read, by its ending.

    Raises:
        GraspFileError: for a directory, another ending, and a file that is damaged or lacks what it needs.
        ImportError: for a kind whose library is not installed.
    """
    path = read_place(path)
    if isinstance(path, RemoteFile):
        if path.suffix != ".parquet":
            raise GraspFileError(path, "it lies elsewhere: expected Parquet, or a file of this machine")
        return open_parquet(path, adjustments.fill)
    if path.is_dir():
        raise GraspFileError(path, f"it is a directory: expected a file that ends in {ENDINGS}")
    return file_format(path).open(path, adjustments.fill)


@dataclass(frozen=True)
class FileFormat:
    """A kind of grasp files."""

    open: Callable[[Path, dict[str, float]], GraspSource]
    write: Callable[[Path, ContactSets], None]


def _open_csv(path: Path, fill: dict[str, float]) -> GraspSource:
    return MemorySource(read_csv(path, fill))


_HDF5 = FileFormat(open_hdf5, write_hdf5)
FORMATS = {
    ".npz": FileFormat(open_npz, write_npz),
    ".csv": FileFormat(_open_csv, write_csv),
    ".parquet": FileFormat(open_parquet, write_parquet),
    ".h5": _HDF5,
    ".hdf5": _HDF5,
}
"""By the endings of their files' names."""
ENDINGS = ", ".join(list(FORMATS)[:-1]) + f" or {list(FORMATS)[-1]}"


def file_format(path: Path) -> FileFormat:
    """The kind of a file by its ending.

    Raises:
        GraspFileError: for any other.
    """
    found = FORMATS.get(path.suffix.lower())
    if found is None:
        raise GraspFileError(path, f"its name ends in {shortened(path.suffix)}: expected {ENDINGS}")
    return found


def load_grasps(path: str | os.PathLike) -> ContactSets:
    """Read a grasp file (``.npz``, ``.csv``, ``.parquet``, ``.h5``), check every entry, and return it whole.

    Raises:
        GraspFileError: if the file is of another kind, damaged, lacks a column, or its shapes do not fit.
        ImportError: for Parquet and HDF5 without the extras `table` and `mesh`.
        GraspError: for the first entry that is not usable: which, its value, and what was expected.
    """
    with open_source(path) as source:
        sets = next(source.chunks(max(1, len(source))))
    for fault in sets.faults():
        raise GraspError(fault)
    if looks_like_millimetres(sets):
        warnings.warn(
            f"{os.fspath(path)}: contacts lie metres apart, as if lengths were in millimetres: expected metres",
            stacklevel=2,
        )
    if normals_point_away(sets):
        warnings.warn(f"{os.fspath(path)}: {POINT_AWAY}: expected normals that point into the object", stacklevel=2)
    return sets


def save_grasps(
    path: str | os.PathLike,
    grasps: ContactSets | Grasp,
    wrenches: AnyArray | None = None,
    *,
    limits: Limits | None = None,
    **labels: AnyArray | Sequence[str],
) -> None:
    """Write a grasp file, ``.npz``, ``.csv``, ``.parquet`` or ``.h5`` by its name, whole or not at all.

    Args:
        path: where to; a file that stands there is replaced once the new one is complete.
        grasps: contact sets, or a batch of grasps ``(N, n)`` with ``wrenches``.
        wrenches: ``(N, 6)`` or ``(N, W, 6)``.
        limits: with a batch of grasps, of its shape.
        labels: text of each grasp ``(N,)``: any of ``name``, ``source``, ``object``, ``hand``.

    Raises:
        GraspError: for the first entry that is not usable.
        GraspFileError: for a name of another ending.
        ImportError: for Parquet and HDF5 without the extras `table` and `mesh`.
        ValueError: for labels that cannot be used.
    """
    kind = file_format(Path(path))
    sets = as_sets(grasps, wrenches, limits)
    for name, values in labels.items():
        if name not in LABELS:
            raise ValueError(f"label {name!r} is unknown: expected some of {', '.join(LABELS)}")
        if np.shape(values) != (len(sets),):
            raise ValueError(f"{name} has shape {np.shape(values)}: expected ({len(sets)},), a text for each grasp")
        texts = np.asarray(values, str)
        if texts.dtype.itemsize > LONGEST_LABEL * np.dtype("U1").itemsize:
            at = int(np.argmax(np.char.str_len(texts)))
            raise ValueError(
                f"{name}[{at}] is text of {len(texts[at]):,} characters: expected at most {LONGEST_LABEL:,}"
            )
    if labels:
        sets = replace(sets, labels={name: np.asarray(values, str) for name, values in labels.items()})
    for fault in sets.faults():
        raise GraspError(fault)
    kind.write(Path(path), sets)


def looks_like_millimetres(sets: ContactSets) -> bool:
    """Whether most grasps are larger than any hand, as they are when lengths are in millimetres."""
    reach = sets.reach()
    return bool(len(reach) and np.median(reach) > MILLIMETRES_LIKELY)


def normals_point_away(sets: ContactSets) -> bool:
    """Whether the normals of most grasps point away from the contacts' own middle, as no convex object's do."""
    if not len(sets.points):
        return False
    ways, starts = sets.towards_middle(), sets.offsets[:-1][sets.sizes > 0]
    inward = np.add.reduceat(np.einsum("ci,ci->c", ways, sets.normals), starts)
    # Those that press across the plane that they lie in, as fingers under a tray, say nothing either way.
    return bool(np.mean(inward < -ROUNDING * np.add.reduceat(np.linalg.norm(ways, axis=1), starts)) > MOSTLY)
