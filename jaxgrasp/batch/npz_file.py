"""Grasp files as ``.npz`` archives, which are read column by column in step, so that they need not fit in memory.

Nothing is ever unpickled.

Reader of an array of an ``.npz`` archive, whose header must agree with the sizes that the archive states.
"""

import io
import math
import os
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import IO

import numpy as np

from jaxgrasp.batch.columnar import ColumnarGrasps, columns_to_save
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.files.replace import replace_file

DAMAGE = (ValueError, zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, KeyError)
"""Errors that the standard library raises for a broken, encrypted or otherwise odd archive."""
LARGEST_HEADER = 1 << 16
"""Bytes of a column that may be its header; NumPy's own for plain arrays take some hundred."""
DEFLATE_RATIO = 1032
"""Deflate makes no data smaller than this many times; an archive that claims more than that lies about its sizes."""
HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


class Column:
    """Array of the archive that is read forward, a few rows at a time."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, name: str):
        """Read the header, and check that as many bytes follow as its shape and type need.

        Raises:
            GraspFileError: if it cannot be read, is of no plain type, or has another size than it says.
        """
        self.name = name
        self._path, self._archive = path, archive
        self._stream: IO[bytes] | None = None
        member = f"{name}.npy"
        try:
            with archive.open(member) as stream:
                head = io.BytesIO(stream.read(LARGEST_HEADER))
            version = np.lib.format.read_magic(head)
            if version not in HEADERS:
                raise ValueError(f"NPY version {version}")
            self.shape, fortran, self.dtype = HEADERS[version](head)
        except Exception as error:  # NumPy reads a header as Python, and lets out all that Python's own parsers raise
            raise self._error(f"cannot be read ({error})") from error
        if self.dtype.hasobject:
            raise self._error("holds pickled objects: expected plain numbers or text")
        if fortran and len(self.shape) > 1:
            raise self._error("is in Fortran order: save np.ascontiguousarray of it")
        self._header = head.tell()
        self._check_size(archive.getinfo(member))

    def _check_size(self, member: zipfile.ZipInfo) -> None:
        if any(side < 0 for side in self.shape):
            raise self._error(f"has shape {self.shape}: expected sizes of 0 or more")
        expected_bytes, stored_bytes = math.prod(self.shape) * self.dtype.itemsize, member.file_size - self._header
        if expected_bytes != stored_bytes:
            problem = "the file is truncated" if stored_bytes < expected_bytes else "expected no more"
            raise self._error(
                f"of shape {self.shape} and {self.dtype} takes {expected_bytes:,} bytes "
                f"and has {stored_bytes:,}: {problem}"
            )
        packing = {zipfile.ZIP_STORED: 1, zipfile.ZIP_DEFLATED: DEFLATE_RATIO}
        if member.compress_type not in packing:
            raise self._error("is compressed by another method than deflate: save it by np.savez_compressed")
        if member.file_size > packing[member.compress_type] * max(member.compress_size, 1):
            raise self._error(
                f"is {member.file_size:,} bytes packed into {member.compress_size:,}, which is not possible"
            )

    def take(self, rows: int) -> np.ndarray:
        """Read the next rows, an array ``(rows, ...)``."""
        size = rows * self._row_bytes
        try:
            if self._stream is None:
                self._stream = self._archive.open(f"{self.name}.npy")
                self._stream.read(self._header)
            data = self._stream.read(size)
        except DAMAGE as error:
            raise self._error(f"is damaged ({error})") from error
        if len(data) != size:
            raise self._error("ends early: the file is truncated")
        return np.frombuffer(data, self.dtype).reshape(rows, *self.shape[1:])

    def read_all(self) -> np.ndarray:
        """Read the whole array."""
        with closing(self):
            return self.take(self.shape[0]) if self.shape else self.take(1).reshape(())

    def skip(self, rows: int) -> None:
        while rows > 0:
            step = min(rows, max(1, (1 << 24) // max(1, self._row_bytes)))
            self.take(step)
            rows -= step

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()

    def _error(self, problem: str) -> GraspFileError:
        return GraspFileError(self._path, f"its column {self.name!r} {problem}")

    @property
    def _row_bytes(self) -> int:
        return self.dtype.itemsize * math.prod(self.shape[1:])


class NpzArchive:
    """The arrays of an ``.npz`` file."""

    def __init__(self, path: Path):
        self.path = path
        try:
            self._archive = zipfile.ZipFile(path)
        except OSError as error:
            if error.errno is not None:
                # That the file cannot be opened says nothing of its content: missing, a loop of links, no permission.
                raise
            raise GraspFileError(path, "it is not a complete .npz archive") from error
        except DAMAGE as error:
            raise GraspFileError(path, "it is not a complete .npz archive") from error
        members = self._archive.namelist()
        self.names = [member.removesuffix(".npy") for member in members if member.endswith(".npy")]

    def checksum(self) -> int:
        """Compute the CRC-32 of the names, sizes and CRCs of the archive's members."""
        parts = [f"{member.filename} {member.CRC} {member.file_size}" for member in self._archive.infolist()]
        return zlib.crc32("\n".join(sorted(parts)).encode())

    def column(self, name: str) -> Column:
        return Column(self.path, self._archive, name)

    def close(self) -> None:
        self._archive.close()


def open_npz(path: str | os.PathLike, fill: dict[str, float] | None = None) -> ColumnarGrasps:
    """Open a grasp file for reading; ``fill`` holds values for columns that the file lacks."""
    return ColumnarGrasps(NpzArchive(Path(path)), fill)


def write_npz(path: str | os.PathLike, sets: ContactSets) -> None:
    """Write contact sets as an ``.npz`` file, whole or not at all."""
    replace_file(Path(path), lambda stream: save_arrays(stream, columns_to_save(sets)))


def save_arrays(stream: IO[bytes], arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays to a stream as an ``.npz`` archive, without pickles."""
    np.savez(stream, allow_pickle=False, **arrays)
