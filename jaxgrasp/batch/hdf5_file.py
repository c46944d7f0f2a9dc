"""Grasp files as HDF5: the columns of [`columnar`][jaxgrasp.batch.columnar] as data sets of those names."""

import math
import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.batch.columnar import COLUMN_NAMES, ColumnarGrasps, columns_to_save
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.npz_file import DEFLATE_RATIO
from jaxgrasp.files.replace import replace_file
from jaxgrasp.validation.optional_library import hdf5_library

LONGEST = 1_000
"""Largest length [bytes] of a text whose length the file does not fix."""


class Hdf5Column:
    """Data set that is read forward, a few rows at a time."""

    def __init__(self, path: Path, name: str, data: Any):
        """Check the data set and read its shape and type; ``data`` is h5py's data set.

        Raises:
            GraspFileError: for data in other files, and for a shape that needs more bytes than the data can hold.
        """
        self._path, self._name, self._data, self._at = path, name, data, 0
        if data.external or data.is_virtual:
            raise GraspFileError(path, f"{name} lies in other files: expected its data in this one")
        self.shape = tuple(map(int, data.shape or ()))
        self._text = hdf5_library().check_string_dtype(data.dtype)
        self.dtype = np.dtype(f"S{self._text.length or LONGEST}") if self._text else data.dtype
        stored, packed = data.id.get_storage_size(), data.compression is not None
        size = math.prod(self.shape) * data.dtype.itemsize
        if size > stored * (DEFLATE_RATIO if packed else 1):
            raise GraspFileError(path, f"{name} of shape {self.shape} takes {size:,} bytes and stores {stored:,}")

    def take(self, rows: int) -> np.ndarray:
        return self._read(slice(self._at, self._advance(rows)))

    def skip(self, rows: int) -> None:
        self._advance(rows)

    def read_all(self) -> np.ndarray:
        return self._read(())

    def close(self) -> None: ...

    def _advance(self, rows: int) -> int:
        self._at += rows
        return self._at

    def _read(self, selection: Any) -> np.ndarray:
        try:
            values = self._data[selection]
        except (OSError, RuntimeError, ValueError) as error:
            raise GraspFileError(self._path, f"{self._name} is damaged ({error})") from error
        if not self._text:
            return np.asarray(values)
        longest = max((len(text) for text in np.ravel(values)), default=0)
        if longest > LONGEST:
            raise GraspFileError(
                self._path, f"{self._name} holds text of {longest:,} bytes: expected at most {LONGEST:,}"
            )
        return np.asarray(values, np.bytes_ if longest else "S1")


class Hdf5Archive:
    """The data sets at the root of an HDF5 file."""

    def __init__(self, path: Path):
        h5py = hdf5_library()
        # Of a file that is missing, or a loop of links, the system's own message is clearer than the library's.
        os.stat(path)
        self.path = path
        try:
            self._file = h5py.File(path, "r")
            self.names = [name for name in self._file if self._is_grasp_column(h5py, name)]
        except (OSError, RuntimeError, KeyError) as error:
            raise GraspFileError(path, f"it cannot be read as HDF5 ({error})") from error

    def _is_grasp_column(self, h5py: Any, name: str) -> bool:
        is_inside = isinstance(self._file.get(name, getlink=True), h5py.HardLink)
        if name in COLUMN_NAMES and not is_inside:
            raise GraspFileError(self.path, f"{name} is a link: expected a data set in this file")
        return is_inside and isinstance(self._file[name], h5py.Dataset)

    def checksum(self) -> int:
        """Compute the CRC-32 of all bytes of the file."""
        sum_ = 0
        with open(self.path, "rb") as stream:
            while part := stream.read(1 << 20):
                sum_ = zlib.crc32(part, sum_)
        return sum_

    def column(self, name: str) -> Hdf5Column:
        return Hdf5Column(self.path, name, self._file[name])

    def close(self) -> None:
        self._file.close()


def open_hdf5(path: Path, fill: dict[str, float] | None = None) -> ColumnarGrasps:
    """Open a grasp file for reading; ``fill`` holds values for columns that the file lacks."""
    return ColumnarGrasps(Hdf5Archive(path), fill)


def write_hdf5(path: Path, sets: ContactSets) -> None:
    """Write contact sets as an HDF5 file, whole or not at all."""
    h5py = hdf5_library()

    def write(stream: Any) -> None:
        with h5py.File(stream, "w") as file:
            for name, array in columns_to_save(sets).items():
                file[name] = np.char.encode(array, "utf-8") if array.dtype.kind == "U" else array

    replace_file(path, write)
