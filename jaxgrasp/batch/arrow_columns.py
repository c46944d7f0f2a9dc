"""Arrow tables, one row for each grasp, and the flat arrays of [`columnar`][jaxgrasp.batch.columnar] that they hold.

Import of pyarrow, which reads and writes Parquet; the extra ``table`` installs it.
"""

import os
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

from jaxgrasp.batch.columnar import BY_CONTACT, COLUMN_NAMES, LABELS, LONGEST_LABEL
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.validation.optional_library import optional_library

MISSING = "Parquet files need pyarrow: pip install 'jaxgrasp[table]'"


def arrow_library() -> Any:
    """Import pyarrow with its modules for Parquet, compute functions and file systems, and return it.

    Raises:
        ImportError: if it is not installed; the message names the command that installs it.
    """
    return optional_library("pyarrow", "pyarrow.compute", "pyarrow.fs", "pyarrow.parquet", missing=MISSING)


def parquet_writer(arrow: Any, stream: IO[bytes], schema: Any) -> Any:
    """Create a Parquet writer on ``stream``, with page checksums and with dictionary encoding of text columns alone.

    Numbers rarely repeat: without dictionaries for them, writing takes a quarter of the time.
    """
    texts = [field.name for field in schema if arrow.types.is_string(field.type)]
    return arrow.parquet.ParquetWriter(stream, schema, use_dictionary=texts, write_page_checksum=True)


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

    def read_all(self) -> np.ndarray:
        return self._array

    def close(self) -> None: ...


def grasp_columns(path: os.PathLike, names: list[str]) -> list[str]:
    """Select the column names that grasp files define; ``offsets`` is left out, since the lists contain it.

    Raises:
        GraspFileError: for a column that occurs twice.
    """
    columns = [name for name in names if name in COLUMN_NAMES and name != "offsets"]
    duplicate = next((name for name in columns if columns.count(name) > 1), None)
    if duplicate is not None:
        raise GraspFileError(path, f"it has the column {duplicate!r} twice")
    return columns


@dataclass(frozen=True)
class FlatColumn:
    """Rows of a column as a flat array, with a row for each contact if the column belongs to contacts."""

    array: np.ndarray
    sizes: np.ndarray | None
    """``(N,)``: number of contacts of each grasp; None for a column that does not belong to contacts."""


def flat_column(arrow: Any, path: os.PathLike, name: str, values: Any) -> FlatColumn:
    """Flatten an Arrow array with a row for each grasp into a NumPy array.

    Raises:
        GraspFileError: for empty cells, missing lists, lists of different lengths, and values of other types than
            numbers and text.
    """
    if values.null_count:
        raise GraspFileError(path, f"{name} has {values.null_count:,} empty cells: expected a value in each")
    if name in LABELS:
        return FlatColumn(_text(arrow, path, name, values), None)
    sizes = None
    if name in BY_CONTACT:
        if not _is_list(arrow, values.type):
            raise GraspFileError(path, f"{name} holds {values.type}: expected a list for each grasp")
        sizes = np.asarray(values.value_lengths())
        values = values.flatten()
    rows = len(values)
    sides: list[int] = []
    while _is_list(arrow, values.type):
        lengths = np.unique(np.asarray(values.value_lengths()))
        if len(lengths) > 1 or values.null_count:
            raise GraspFileError(path, f"{name} holds lists of different lengths: expected one length")
        sides.append(int(lengths[0]) if len(lengths) else 0)
        values = values.flatten()
    if values.null_count or not (arrow.types.is_floating(values.type) or arrow.types.is_integer(values.type)):
        raise GraspFileError(path, f"{name} holds {values.type} or empty cells: expected numbers")
    return FlatColumn(values.to_numpy(zero_copy_only=False).reshape(rows, *sides), sizes)


def check_sizes(path: os.PathLike, name: str, sizes: np.ndarray, expected: np.ndarray) -> None:
    """Check that every grasp has the same number of contacts in this column as in the others.

    Args:
        path: of the file, for the message.
        name: of the column.
        sizes: contacts of each grasp in this column ``(N,)``.
        expected: contacts of each grasp in the other columns ``(N,)``.

    Raises:
        GraspFileError: for the first grasp that differs.
    """
    differs = np.flatnonzero(expected != sizes)
    if len(differs):
        at = differs[0]
        raise GraspFileError(path, f"{name}[{at}] has {sizes[at]} contacts: expected {expected[at]}, as the others")


def _text(arrow: Any, path: os.PathLike, name: str, values: Any) -> np.ndarray:
    if arrow.types.is_dictionary(values.type):
        values = values.dictionary_decode()
    if not (arrow.types.is_string(values.type) or arrow.types.is_large_string(values.type)):
        raise GraspFileError(path, f"{name} holds {values.type}: expected text")
    if not len(values):
        return np.zeros(0, "U1")
    # Every text of an array takes as much memory as the longest.
    longest = arrow.compute.max(arrow.compute.utf8_length(values)).as_py()
    if longest > LONGEST_LABEL:
        raise GraspFileError(path, f"{name} holds text of {longest:,} characters: expected {LONGEST_LABEL:,} at most")
    return np.asarray(values.to_pylist(), str)


def _is_list(arrow: Any, arrow_type: Any) -> bool:
    types = arrow.types
    return types.is_list(arrow_type) or types.is_large_list(arrow_type) or types.is_fixed_size_list(arrow_type)
