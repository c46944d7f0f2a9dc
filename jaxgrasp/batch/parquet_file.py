"""Grasp files as Parquet: one row for each grasp, with what belongs to contacts as lists.

Columns are those of [`columnar`][jaxgrasp.batch.columnar]: ``points`` and ``normals`` lists of [x, y, z], ``friction``,
``squeeze`` and other numbers of contacts lists, ``wrench`` a list of 6 numbers, or of W such lists, and text as it is.
"""

import json
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.batch.arrow_columns import (
    ArrayColumn,
    FlatColumn,
    arrow_library,
    check_sizes,
    flat_column,
    grasp_columns,
    parquet_writer,
)
from jaxgrasp.batch.columnar import ColumnarGrasps, ColumnOfRows
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.remote_file import RemoteFile
from jaxgrasp.files.replace import replace_file

ROWS = 65_536
"""Number of grasps that are written at a time."""
ROWS_READ = 8_192
"""Grasps that are read at a time, whatever the size of the file's row groups."""
BUFFER = 8 << 20
"""Bytes of a column that are fetched at a time; of an object store each fetch takes a while."""


class ParquetColumn:
    """Column of a file that is read forward, a few rows at a time."""

    def __init__(self, archive: "ParquetArchive", name: str, shape: tuple[int, ...], dtype: np.dtype):
        self.shape, self.dtype = shape, dtype
        self._path, self._name = archive.path, name
        self._parts = (part.array for part in archive.parts(name))
        self._held: list[np.ndarray] = []

    def take(self, rows: int) -> np.ndarray:
        """Read the next rows, an array ``(rows, ...)``."""
        while not self._held or sum(map(len, self._held)) < rows:
            part = next(self._parts, None)
            if part is None:
                raise GraspFileError(self._path, f"{self._name} ends early: the file was changed meanwhile")
            self._held.append(part)
        held = np.concatenate(self._held) if len(self._held) != 1 else self._held[0]
        self._held = [held[rows:]]
        return held[:rows]

    def skip(self, rows: int) -> None:
        while rows > 0:
            step = min(rows, ROWS_READ)
            self.take(step)
            rows -= step

    def read_all(self) -> np.ndarray:
        return self.take(self.shape[0])

    def close(self) -> None:
        self._parts.close()


class ParquetArchive:
    """Archive of the columns of a Parquet file as flat arrays, of which memory holds a few rows.

    All of it is read once as it is opened, which checks it.
    """

    def __init__(self, path: "Path | RemoteFile"):
        self._arrow = arrow_library()
        if isinstance(path, Path):
            # Of a file that is missing, or a loop of links, the system's own message is clearer than the library's.
            os.stat(path)
        self.path = path
        with opened_parquet(self.path) as file:
            file_names = file.schema_arrow.names
            names = grasp_columns(path, file_names)
        self._sizes: np.ndarray | None = None
        self._offsets = np.zeros(1, np.int64)
        self._checksums: dict[str, int] = {}
        self._headers = {name: self._checked(name) for name in names}
        self.names = list(self._headers)
        if self._sizes is not None:
            self._offsets = np.concatenate([[0], np.cumsum(self._sizes, dtype=np.int64)])
            self.names.append("offsets")
        # Rows of pandas have numbers of their own, which pandas writes as a column.
        others = (name for name in file_names if not name.startswith("__index_level_") and name != "offsets")
        self.names += [name for name in dict.fromkeys(others) if name not in names]

    def parts(self, name: str) -> Iterator[FlatColumn]:
        """Yield a column in parts of at most ``ROWS_READ`` grasps."""
        with opened_parquet(self.path) as file:
            for batch in file.iter_batches(ROWS_READ, columns=[name]):
                yield flat_column(self._arrow, self.path, name, batch.column(0))

    def _checked(self, name: str) -> tuple[tuple[int, ...], np.dtype]:
        """Read a column once; check that its rows agree, store its checksum, and return its shape and type."""
        rows, checksum = 0, 0
        sides: tuple[int, ...] | None = None
        dtype: np.dtype | None = None
        sizes: list[np.ndarray] = []
        for part in self.parts(name):
            array = part.array
            if sides is not None and array.shape[1:] != sides:
                raise GraspFileError(self.path, f"{name} holds lists of different lengths: expected one length")
            sides = array.shape[1:] if len(array) else sides
            dtype = array.dtype if dtype is None else np.promote_types(dtype, array.dtype)
            if part.sizes is not None:
                sizes.append(part.sizes)
            rows += len(array)
            checksum = zlib.crc32(_content(array), checksum)
        self._checksums[name] = checksum
        if sizes:
            contact_counts = np.concatenate(sizes)
            self._sizes = contact_counts if self._sizes is None else self._sizes
            check_sizes(self.path, name, contact_counts, self._sizes)
        if dtype is None:
            raise GraspFileError(self.path, "it holds no grasps")
        return (rows, *(sides or ())), dtype

    def checksum(self) -> int:
        """Compute the CRC-32 of the checksums of the columns."""
        return zlib.crc32(json.dumps(self._checksums, sort_keys=True).encode())

    def column(self, name: str) -> ColumnOfRows:
        return ArrayColumn(self._offsets) if name == "offsets" else ParquetColumn(self, name, *self._headers[name])

    def close(self) -> None: ...


@contextmanager
def opened_parquet(path: "Path | RemoteFile") -> Iterator[Any]:
    """Open a local or remote Parquet file as pyarrow's ``ParquetFile`` until the block ends.

    Raises:
        GraspFileError: if the file cannot be opened, or cannot be read within the block.
    """
    arrow = arrow_library()
    try:
        with (
            path.opened() if isinstance(path, RemoteFile) else nullcontext(path) as source,
            # Unless told otherwise it fetches each column of the whole file at once, and keeps it until the end.
            arrow.parquet.ParquetFile(
                source, page_checksum_verification=True, pre_buffer=False, buffer_size=BUFFER
            ) as file,
        ):
            yield file
    except (arrow.ArrowException, OSError) as error:
        raise GraspFileError(path, f"it cannot be read as Parquet ({error})") from error


def _content(array: np.ndarray) -> bytes:
    """Return the bytes of an array for a checksum that does not depend on its parts: texts without their padding."""
    if array.dtype.kind == "U":
        return "".join(f"{text}\n" for text in array.tolist()).encode("utf-8", "surrogatepass")
    return np.ascontiguousarray(array).tobytes()


def open_parquet(path: "Path | RemoteFile", fill: dict[str, float] | None = None) -> ColumnarGrasps:
    """Open a grasp file for reading; ``fill`` holds values for columns that the file lacks."""
    return ColumnarGrasps(ParquetArchive(path), fill)


def write_parquet(path: Path, sets: ContactSets) -> None:
    """Write contact sets as a Parquet file, whole or not at all."""
    arrow = arrow_library()

    def write(stream: Any) -> None:
        writer = None
        for first in range(0, max(1, len(sets)), ROWS):
            table = _table(arrow, sets.rows(slice(first, first + ROWS)))
            writer = writer or parquet_writer(arrow, stream, table.schema)
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
    """Convert an array to Arrow lists of lists, a level for each axis after the first."""
    values = arrow.array(np.ascontiguousarray(array).ravel())
    for side in reversed(array.shape[1:]):
        values = arrow.FixedSizeListArray.from_arrays(values, side)
    return values
