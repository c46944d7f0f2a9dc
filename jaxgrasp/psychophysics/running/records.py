"""Records of one person: lines of JSON that are only ever appended, each on disk before the program goes on."""

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from jaxgrasp.files.replace import replace_file

FORMAT = 1
SUFFIX = ".jsonl"


class RecordError(ValueError):
    """Records that cannot be read, or are not those of this experiment."""


def read_records(path: Path) -> tuple[list[dict[str, Any]], bytes]:
    """All records of a file, and what is left of a last one that was cut off while it was written.

    Raises:
        RecordError: for a line that is no record, by its number.
        OSError: for a file that cannot be read.
    """
    *lines, rest = path.read_bytes().split(b"\n")
    return [_record(path, k, line) for k, line in enumerate(lines, 1)], rest


def _record(path: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        found = json.loads(line)
    except ValueError:
        found = None
    if not (isinstance(found, dict) and isinstance(found.get("record"), str)):
        raise RecordError(f"{path}, line {number}, is no record: {line[:60]!r}")
    return found


class Journal:
    """A file of records that is open for one more at a time, and for one program alone; a context manager."""

    def __init__(self, path: Path, first: dict[str, Any]) -> None:
        """Open a file, or make it with its first record, whole.

        What a crash left of a last line becomes a record of its own, so that nothing is lost.

        Args:
            path: of the file.
            first: the record that a new file begins with.

        Raises:
            RecordError: for a file with a line that is no record.
            OSError: for a file that cannot be written, or that another program has open.
        """
        self.path = path
        if not path.exists():
            replace_file(path, lambda stream: stream.write(_line(first)))
            _sync_folder(path.parent)
        self._stream: BinaryIO = open(path, "r+b")  # noqa: SIM115
        try:
            _lock(self._stream, path)
            self.records, rest = read_records(path)
            if rest:
                self._stream.seek(-len(rest), os.SEEK_END)
                self._write({"record": "cut-off", "text": rest.decode(errors="replace")})
                self._stream.truncate()
                os.fsync(self._stream.fileno())
            self._stream.seek(0, os.SEEK_END)
        except BaseException:
            self._stream.close()
            raise

    def append(self, record: dict[str, Any]) -> None:
        """Write a record; it is on disk when this returns.

        Raises:
            ValueError: for numbers that are not finite: JSON has none.
            OSError: if the disk does not take it.
        """
        self._write(record)
        self.records.append(record)

    def close(self) -> None:
        """Let go of the file."""
        self._stream.close()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, record: dict[str, Any]) -> None:
        self._stream.write(_line(record))
        self._stream.flush()
        os.fsync(self._stream.fileno())


def subjects(folder: Path) -> Iterator[Path]:
    """The files of records in a folder, by the persons' codes."""
    yield from sorted(folder.glob(f"*{SUFFIX}"))


def _line(record: dict[str, Any]) -> bytes:
    return json.dumps(record, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _sync_folder(folder: Path) -> None:
    """The name of a new file is on disk too, where a system can be told so."""
    with contextlib.suppress(OSError, AttributeError):
        number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _lock(stream: BinaryIO, path: Path) -> None:
    """Until the stream is closed, or its program ends however it may."""
    try:
        if os.name == "nt":
            import msvcrt

            # Far beyond its end: there a lock keeps nobody from reading.
            stream.seek(2**40)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        else:
            import fcntl

            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise OSError(f"{path} is in use by another program") from None
