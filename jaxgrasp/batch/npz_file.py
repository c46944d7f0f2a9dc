"""Grasp files as ``.npz`` archives, which are read column by column in step, so that they need not fit in memory.

Nothing is ever unpickled.
"""

import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np

from jaxgrasp.batch.columnar import ColumnarGrasps, columns_to_save
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.batch.npz_column import DAMAGE, Column
from jaxgrasp.files.replace import replace_file


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
