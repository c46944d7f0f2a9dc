"""Files in an object store, or wherever else pyarrow reads from, by their addresses: ``s3://bucket/folder/a.parquet``.

What an address says after ``?``, such as a region, goes to pyarrow; credentials come from the environment or a profile,
as with the store's own tools.
"""

import fnmatch
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import SplitResult, urlsplit

from jaxgrasp.batch.arrow_columns import arrow_library
from jaxgrasp.batch.file_error import GraspFileError

MARK = "://"
WILD = "*?["


@dataclass(frozen=True)
class RemoteFile:
    """File at an address, with the attributes of a path that readers of grasp files use."""

    address: str

    def __str__(self) -> str:
        return self.address

    __fspath__ = __str__

    @property
    def name(self) -> str:
        """The last part of the address's path."""
        return PurePosixPath(urlsplit(self.address).path).name

    @property
    def suffix(self) -> str:
        """The ending of its name."""
        return PurePosixPath(self.name).suffix

    def absolute(self) -> "RemoteFile":
        """Return this file, since an address is absolute."""
        return self

    @contextmanager
    def opened(self) -> Iterator[Any]:
        """Open the file as a stream of pyarrow until the block ends.

        Raises:
            FileNotFoundError: if there is no such file.
            OSError: if it cannot be reached.
        """
        files, path = _file_system(self.address)
        with files.open_input_file(path) as stream:
            yield stream


def parse_path(text: str | os.PathLike) -> "Path | RemoteFile":
    """Convert text to a path of this machine, or to a RemoteFile if it is an address."""
    address = os.fspath(text)
    return RemoteFile(address) if MARK in address else Path(address)


def remote_files(location: RemoteFile, ending: str) -> list[RemoteFile]:
    """List the files of an address: a single file, files that match a pattern ``part-*.parquet``, or a folder's files.

    Args:
        location: address, whose last part may hold ``*``, ``?`` that no query follows, and ``[...]``.
        ending: of the names of files in a folder.

    Raises:
        GraspFileError: for an address that cannot be read, or where there is nothing.
    """
    parts, pattern = _parts(location.address), f"*{ending}"
    folder = PurePosixPath(parts.path)
    if any(mark in folder.name for mark in WILD):
        folder, pattern = folder.parent, folder.name
    elif folder.suffix == ending:
        return [location]
    arrow = arrow_library()
    try:
        files, path = _file_system(parts._replace(path=str(folder)).geturl())
        entries = files.get_file_info(arrow.fs.FileSelector(path, allow_not_found=True))
    except (arrow.ArrowException, OSError) as error:
        raise GraspFileError(location, f"it cannot be listed ({_first_line(error)})") from error
    names = sorted(
        entry.base_name for entry in entries if entry.is_file and fnmatch.fnmatchcase(entry.base_name, pattern)
    )
    return [RemoteFile(parts._replace(path=str(folder / name)).geturl()) for name in names]


def _parts(address: str) -> SplitResult:
    parts = urlsplit(address)
    if parts.username is not None:
        public_address = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
        raise GraspFileError(
            public_address, "the address holds credentials: expected them in the environment or a profile"
        )
    return parts


def _file_system(address: str) -> tuple[Any, str]:
    """Return pyarrow's file system for an address, and the path in it."""
    arrow = arrow_library()
    _parts(address)
    try:
        files, path = arrow.fs.FileSystem.from_uri(address)
    except arrow.ArrowInvalid as error:
        raise GraspFileError(address, f"the address cannot be used ({_first_line(error)})") from error
    return files, path


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0]
