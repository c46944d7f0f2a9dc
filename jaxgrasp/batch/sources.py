"""Where grasps come from: a file of any kind we read, as a stream of contact sets, adjusted as the user asks."""

import os
import warnings
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets, as_sets
from jaxgrasp.batch.csv_file import read_csv, write_csv
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.npz_file import LABELS, LONGEST_LABEL, NpzGrasps, write_npz
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.faults import GraspError
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits

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

    @property
    def fill(self) -> dict[str, float]:
        return {name: value for name in ("friction", "squeeze") if (value := getattr(self, name)) is not None}

    def apply(self, sets: ContactSets) -> ContactSets:
        changes = {name: np.full_like(getattr(sets, name), value) for name, value in self.fill.items()}
        if self.friction == 0 and sets.torsion is not None:
            # A contact without friction has no torsional friction either.
            changes["torsion"] = np.zeros_like(sets.torsion)
        if self.outward_normals:
            changes["normals"] = -sets.normals
        return replace(sets, **changes) if changes else sets


def open_source(path: str | os.PathLike, adjustments: Adjustments = Adjustments()) -> GraspSource:
    """The grasps of a ``.npz`` or ``.csv`` file."""
    path = Path(path)
    if path.is_dir():
        raise GraspFileError(path, "it is a directory: expected an .npz or a .csv file")
    if path.suffix.lower() == ".csv":
        return MemorySource(read_csv(path, adjustments.fill))
    return NpzGrasps(path, adjustments.fill)


def load_grasps(path: str | os.PathLike) -> ContactSets:
    """Read a grasp file (``.npz`` version 1, or ``.csv``), check every entry, and return it whole.

    Raises:
        GraspFileError: if the file is damaged, lacks a column, or its shapes do not fit.
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
    return sets


def save_grasps(
    path: str | os.PathLike,
    grasps: ContactSets | Grasp,
    wrenches: AnyArray | None = None,
    *,
    limits: Limits | None = None,
    **labels: AnyArray | Sequence[str],
) -> None:
    """Write a grasp file, ``.npz`` or ``.csv`` by its name, whole or not at all.

    Args:
        path: where to; a file that stands there is replaced once the new one is complete.
        grasps: contact sets, or a batch of grasps ``(N, n)`` with ``wrenches``.
        wrenches: ``(N, 6)`` or ``(N, W, 6)``.
        limits: with a batch of grasps, of its shape.
        labels: text of each grasp ``(N,)``: any of ``name``, ``source``, ``object``, ``hand``.

    Raises:
        GraspError: for the first entry that is not usable.
        ValueError: for a name of another ending, and labels that cannot be used.
    """
    if Path(path).suffix.lower() not in (".npz", ".csv"):
        raise ValueError(f"path is {str(path)!r}: expected a name that ends in .npz or .csv")
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
    writer = write_csv if Path(path).suffix.lower() == ".csv" else write_npz
    writer(path, sets)


def looks_like_millimetres(sets: ContactSets) -> bool:
    """Whether most grasps are larger than any hand, as they are when lengths are in millimetres."""
    reach = sets.reach()
    return bool(len(reach) and np.median(reach) > MILLIMETRES_LIKELY)
