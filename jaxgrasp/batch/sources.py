"""Sources of grasps: files of all supported kinds as streams of contact sets, adjusted as the user asks."""

import os
import warnings
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxgrasp.batch.columnar import LABELS, LONGEST_LABEL
from jaxgrasp.batch.contact_sets import ContactSets, as_sets
from jaxgrasp.batch.csv_file import read_csv, write_csv
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.hdf5_file import open_hdf5, write_hdf5
from jaxgrasp.batch.npz_file import open_npz, write_npz
from jaxgrasp.batch.parquet_file import open_parquet, write_parquet
from jaxgrasp.batch.remote_file import RemoteFile, parse_path
from jaxgrasp.files.printable import shortened
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.faults import NAMED, GraspError, direction_warning, normal_directions
from jaxgrasp.model.grasp import Grasp, Limits

TURN_ROUND = "if yours point out of the object, add --normals outward"
MILLIMETRES = "contacts lie metres apart: are the lengths in millimetres? Points are in metres, torques in N.m"
MOSTLY = 0.8
"""Share of grasps with outward normals above which the whole file is suspected."""
MILLIMETRES_LIKELY = 2.0
"""Distance of a contact from its grasp's middle [m] that no hand reaches, so that millimetres are likely."""


@runtime_checkable
class GraspSource(Protocol):
    """Grasps that can be read chunk by chunk, until the block ends that they are opened for."""

    @property
    def wrenches(self) -> int: ...

    @property
    def largest(self) -> int: ...

    @property
    def fingerprint(self) -> int:
        """Checksum of the contents."""
        ...

    def __len__(self) -> int: ...

    def __enter__(self) -> "GraspSource": ...

    def __exit__(self, *_) -> None: ...

    def chunks(self, size: int, start: int = 0) -> Iterator[ContactSets]: ...


def numbered_chunks(source: GraspSource, chunk: int, start: int = 0) -> Iterator[tuple[int, ContactSets]]:
    """Yield the grasps of a source from ``start`` on, ``chunk`` at a time, each after the number of its first grasp."""
    for sets in source.chunks(chunk, start):
        yield start, sets
        start += len(sets)


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
        for name, values in sets.labels.items():
            sum_ = zlib.crc32("\0".join([name, *map(str, values)]).encode(), sum_)
        return sum_

    def chunks(self, size: int, start: int = 0) -> Iterator[ContactSets]:
        for first in range(start, len(self), size):
            yield self._sets.rows(slice(first, first + size))


@dataclass(frozen=True)
class Adjustments:
    """Corrections that the user asks for, of data that differ from the conventions of this package."""

    outward_normals: bool = False
    friction: float | None = None
    """Friction of every contact, in place of the file's or of a missing column."""
    squeeze: float | None = None
    torsion: float | None = None
    """Torsional coefficient [m] that makes every contact with friction a soft finger, in place of the file's."""
    normalize: bool = False
    """True to scale every normal to length 1, since normals of files with few digits are not."""

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
        changed = replace(sets, **changes) if changes else sets
        return changed.normalized() if self.normalize else changed


def open_source(path: str | os.PathLike, adjustments: Adjustments = Adjustments()) -> GraspSource:
    """Open a file of grasps of any supported kind, which its ending tells, as a source.

    Raises:
        GraspFileError: for a directory, another ending, and a file that is damaged or lacks what it needs.
        ImportError: for a kind whose library is not installed.
    """
    path = parse_path(path)
    if isinstance(path, RemoteFile):
        if path.suffix != ".parquet":
            raise GraspFileError(path, "it is a remote file: expected Parquet, or a file of this machine")
        return open_parquet(path, adjustments.fill)
    if path.is_dir():
        raise GraspFileError(path, f"it is a directory: expected a file that ends in {ENDINGS}")
    return file_format(path).open(path, adjustments.fill)


@dataclass(frozen=True)
class FileFormat:
    """Reader and writer of a kind of grasp files."""

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
"""Kinds of grasp files by the endings of their names."""
ENDINGS = ", ".join(list(FORMATS)[:-1]) + f" or {list(FORMATS)[-1]}"


def file_format(path: Path) -> FileFormat:
    """Return the kind of a grasp file by the ending of its name.

    Raises:
        GraspFileError: for an unknown ending.
    """
    matching = FORMATS.get(path.suffix.lower())
    if matching is None:
        raise GraspFileError(path, f"its name ends in {shortened(path.suffix)}: expected {ENDINGS}")
    return matching


def load_grasps(path: str | os.PathLike, *, normalize: bool = False) -> ContactSets:
    """Read a grasp file (``.npz``, ``.csv``, ``.parquet``, ``.h5``), check every entry, and return it whole.

    Args:
        path: the file.
        normalize: make every normal length 1, as those of files with few digits are not.

    Warns:
        UserWarning: where lengths look like millimetres, and naming grasps whose normals point away from the middle
            of their contacts.

    Raises:
        GraspFileError: if the file is of another kind, damaged, lacks a column, or its shapes do not fit.
        ImportError: for Parquet and HDF5 without the extras `table` and `mesh`.
        GraspError: for the first entry that is not usable: which, its value, and what was expected.
    """
    with open_source(path) as source:
        sets = Adjustments(normalize=normalize).apply(next(source.chunks(max(1, len(source)))))
    for fault in sets.faults():
        raise GraspError(fault)
    if looks_like_millimetres(sets):
        warnings.warn(
            f"{os.fspath(path)}: contacts lie metres apart, as if lengths were in millimetres: expected metres",
            stacklevel=2,
        )
    if warning := outward_normals(sets).warning("expected normals into the object"):
        warnings.warn(f"{os.fspath(path)}: {warning}", stacklevel=2)
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
    format_ = file_format(Path(path))
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
    format_.write(Path(path), sets)


def looks_like_millimetres(sets: ContactSets) -> bool:
    """Check whether most grasps are larger than any hand, as they are when lengths are in millimetres."""
    reach = sets.reach()
    return bool(len(reach) and np.median(reach) > MILLIMETRES_LIKELY)


class OutwardNormals(NamedTuple):
    """Counts and names of grasps whose normals point away from the middle of their contacts; parts of a file merge."""

    away: int = 0
    decided: int = 0
    """Grasps whose contacts can tell the sign of their normals."""
    names: tuple[str, ...] = ()
    """The first grasps whose normals point away: their names, or their numbers."""

    def merged(self, normals: "OutwardNormals") -> "OutwardNormals":
        """Return both parts as one, this one first."""
        return OutwardNormals(
            self.away + normals.away, self.decided + normals.decided, (self.names + normals.names)[:NAMED]
        )

    def warning(self, remedy: str) -> str:
        """Return the sentence that warns of these grasps and ends with the ``remedy``; nothing where there are none."""
        return direction_warning(self.names, self.away, self.decided, remedy) if self.away else ""

    @property
    def is_most(self) -> bool:
        """True if the normals of most decided grasps point away, as in a file with outward normals."""
        return self.away > MOSTLY * self.decided


def outward_normals(sets: ContactSets, numbers: np.ndarray | None = None) -> OutwardNormals:
    """Find the grasps whose normals point away from the middle of their contacts.

    Args:
        sets: the grasps.
        numbers: of the grasps in their file ``(N,)``; from 0 where not given.
    """
    away, decided = normal_directions(sets.points, sets.normals, sets.offsets)
    numbers = np.arange(len(sets)) if numbers is None else numbers
    first = np.flatnonzero(away)[:NAMED]
    names = tuple(sets.name_of(k) or f"grasp {numbers[k]}" for k in first.tolist())
    return OutwardNormals(int(away.sum()), int(decided.sum()), names)
