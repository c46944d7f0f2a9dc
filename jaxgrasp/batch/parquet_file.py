"""Grasp files as Parquet: one row for each grasp, with what belongs to contacts as lists.

Columns are those of [`columnar`][jaxgrasp.batch.columnar]: ``points`` and ``normals`` lists of [x, y, z], ``friction``,
``squeeze`` and other numbers of contacts lists, ``wrench`` a list of 6 numbers, or of W such lists, and text as it is.
"""

import zlib
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.batch.arrow import arrow_library
from jaxgrasp.batch.columnar import BY_CONTACT, KNOWN, LABELS, LONGEST_LABEL, ColumnarGrasps
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.files.replace import replace_file

ROWS = 65_536
"""Grasps that are written at a time."""


class ArrayColumn:
    """An array in memory, read forward a few rows at a time."""

    def __init__(self, array: np.ndarray):
        self._array, self._at = array, 0
        self.shape, self.dtype = array.shape, array.dtype

    def take(self, rows: int) -> np.ndarray:
        self._at += rows
        return self._array[self._at - rows : self._at]

    def skip(self, rows: int) -> None:
        self._at += rows

    def whole(self) -> np.ndarray:
        return self._array

    def close(self) -> None: ...


class ParquetArchive:
    """The columns of a Parquet file, in memory, as an archive of flat arrays has them."""

    def __init__(self, path: Path):
        arrow = arrow_library()
        if not path.exists():
            raise FileNotFoundError(2, "No such file or directory", str(path))
        self.path = path
        self._arrays: dict[str, np.ndarray] = {}
        try:
            with arrow.parquet.ParquetFile(path) as file:
                names = [name for name in file.schema_arrow.names if name in KNOWN and name != "offsets"]
                twice = next((name for name in names if names.count(name) > 1), None)
                if twice is not None:
                    raise GraspFileError(path, f"it has the column {twice!r} twice")
                for name in names:
                    # One at a time, since joining its pieces takes its size once more.
                    self._arrays[name] = self._flat(arrow, name, file.read(columns=[name])[name].combine_chunks())
        except (arrow.ArrowException, OSError) as error:
            raise GraspFileError(path, f"it cannot be read as Parquet ({error})") from error
        self.names = list(self._arrays)

    def _flat(self, arrow: Any, name: str, values: Any) -> np.ndarray:
        """A column as an array, by contact where it belongs to contacts; the first of these gives the offsets."""
        if values.null_count:
            raise GraspFileError(self.path, f"{name} has {values.null_count:,} empty cells: expected a value in each")
        if name in LABELS:
            return self._text(arrow, name, values)
        sides: list[int] = []
        if name in BY_CONTACT:
            if not self._is_list(arrow, values.type):
                raise GraspFileError(self.path, f"{name} holds {values.type}: expected a list for each grasp")
            sizes = np.asarray(values.value_lengths())
            offsets = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
            known = self._arrays.setdefault("offsets", offsets)
            differs = np.flatnonzero(np.diff(known) != sizes)
            if len(differs):
                at = differs[0]
                raise GraspFileError(
                    self.path, f"{name}[{at}] has {sizes[at]} contacts: expected {np.diff(known)[at]}, as the others"
                )
            values = values.flatten()
        rows = len(values)
        while self._is_list(arrow, values.type):
            lengths = np.unique(np.asarray(values.value_lengths()))
            if len(lengths) > 1 or values.null_count:
                raise GraspFileError(self.path, f"{name} holds lists of different lengths: expected one length")
            sides.append(int(lengths[0]) if len(lengths) else 0)
            values = values.flatten()
        if values.null_count or not (arrow.types.is_floating(values.type) or arrow.types.is_integer(values.type)):
            raise GraspFileError(self.path, f"{name} holds {values.type} or empty cells: expected numbers")
        return values.to_numpy(zero_copy_only=False).reshape(rows, *sides)

    def _text(self, arrow: Any, name: str, values: Any) -> np.ndarray:
        if arrow.types.is_dictionary(values.type):
            values = values.dictionary_decode()
        if not (arrow.types.is_string(values.type) or arrow.types.is_large_string(values.type)):
            raise GraspFileError(self.path, f"{name} holds {values.type}: expected text")
        if not len(values):
            return np.zeros(0, "U1")
        # Every text of an array takes as much memory as the longest.
        longest = arrow.compute.max(arrow.compute.utf8_length(values)).as_py()
        if longest > LONGEST_LABEL:
            raise GraspFileError(
                self.path, f"{name} holds text of {longest:,} characters: expected {LONGEST_LABEL:,} at most"
            )
        return np.asarray(values.to_pylist(), str)

    @staticmethod
    def _is_list(arrow: Any, kind: Any) -> bool:
        types = arrow.types
        return types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)

    def checksum(self) -> int:
        """Checksum of the columns that are read."""
        sum_ = 0
        for name in sorted(self._arrays):
            sum_ = zlib.crc32(self._arrays[name].tobytes(), sum_)
        return sum_

    def column(self, name: str) -> ArrayColumn:
        return ArrayColumn(self._arrays[name])

    def close(self) -> None: ...


def open_parquet(path: Path, fill: dict[str, float] | None = None) -> ColumnarGrasps:
    """A grasp file, read whole. ``fill`` stands in for columns that the file lacks."""
    return ColumnarGrasps(ParquetArchive(path), fill)


def write_parquet(path: Path, sets: ContactSets) -> None:
    """Write a grasp file, whole or not at all."""
    arrow = arrow_library()

    def write(stream: Any) -> None:
        writer = None
        for first in range(0, max(1, len(sets)), ROWS):
            table = _table(arrow, sets.rows(slice(first, first + ROWS)))
            writer = writer or arrow.parquet.ParquetWriter(stream, table.schema)
            writer.write_table(table)
        if writer is not None:
            writer.close()

    replace_file(path, write)


def _table(arrow: Any, sets: ContactSets) -> Any:
    offsets = arrow.array(np.asarray(sets.offsets, np.int32))
    columns = {name: arrow.ListArray.from_arrays(offsets, _lists(arrow, a)) for name, a in sets.columns.items()}
    if sets.torque_max is not None:
        columns["torque_max"] = _lists(arrow, sets.torque_max)
    columns["wrench"] = _lists(arrow, sets.wrench[:, 0] if sets.wrenches == 1 else sets.wrench)
    return arrow.table(columns | {name: arrow.array(np.asarray(v, str)) for name, v in sets.labels.items()})


def _lists(arrow: Any, array: np.ndarray) -> Any:
    """An array as lists of lists, by its axes after the first."""
    values = arrow.array(np.ascontiguousarray(array).ravel())
    for side in reversed(array.shape[1:]):
        values = arrow.FixedSizeListArray.from_arrays(values, side)
    return values
