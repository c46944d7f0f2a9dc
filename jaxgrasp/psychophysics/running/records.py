"""Records of one person: lines of JSON that are only ever appended, each on disk before the program goes on."""

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

FORMAT = 1
_BINARY = getattr(os, "O_BINARY", 0)
SUFFIX = ".jsonl"


class RecordError(ValueError):
    """Records that cannot be read, or are not those of this experiment."""


def read_records(path: Path) -> tuple[list[dict[str, Any]], bytes]:
    """Read all records of a file, and the bytes of a last record that was cut off while it was written.

    Raises:
        RecordError: for a line that is no record, by its number.
        OSError: for a file that cannot be read.
    """
    *lines, cut_off = path.read_bytes().split(b"\n")
    records = [_parsed(line) for line in lines]
    for k, record in enumerate(records, 1):
        if record is None:
            raise RecordError(f"{path}, line {k}, is not a record: {lines[k - 1][:60]!r}")
    # Nothing that was cut off within a record is one: what lacks its end of line alone is whole.
    last = _parsed(cut_off)
    complete = [record for record in (*records, last) if record is not None]
    return complete, b"" if last is not None else cut_off


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) and isinstance(record.get("record"), str) else None


class Journal:
    """A file of records that is open for one more at a time, and for one program alone; a context manager."""

    def __init__(self, path: Path, first: dict[str, Any]) -> None:
        """Open a file, or create it with its first record.

        A last line that a crash cut off becomes a record of its own, so that nothing is lost.

        Args:
            path: of the file.
            first: the record that a new file begins with.

        Raises:
            RecordError: for a file with a line that is no record.
            OSError: for a file that cannot be written, or that another program has open.
        """
        self.path = path
        # One file from the beginning on, locked before it is looked at: of two programs, one finds it in use.
        self._stream: BinaryIO = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | _BINARY, 0o666), "r+b")
        try:
            _lock(self._stream, path)
            self.records, cut_off = read_records(path)
            self._mend(cut_off, first)
            _sync_folder(path.parent)
        except BaseException:
            self._stream.close()
            raise

    def _mend(self, cut_off: bytes, first: dict[str, Any]) -> None:
        """Begin an empty file, and end a last line that a crash cut off."""
        self._stream.seek(-len(cut_off), os.SEEK_END)
        if not cut_off and self._stream.tell() and not self._ends_a_line():
            self._stream.seek(0, os.SEEK_END)
            self._stream.write(b"\n")
        if not self.records:
            self._write(first)
            self.records.append(first)
        if cut_off:
            self._write({"record": "cut-off", "text": cut_off.decode(errors="replace")})
        self._stream.truncate()
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def _ends_a_line(self) -> bool:
        self._stream.seek(-1, os.SEEK_END)
        return self._stream.read(1) == b"\n"

    def append(self, record: dict[str, Any]) -> None:
        """Write a record; it is on disk when this returns.

        Raises:
            ValueError: for numbers that are not finite: JSON has none.
            OSError: if the disk does not take it.
        """
        self._write(record)
        self.records.append(record)

    def close(self) -> None:
        """Close the file, and release its lock."""
        # What a full disk did not take was never said to be on record.
        with contextlib.suppress(OSError):
            self._stream.close()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, record: dict[str, Any]) -> None:
        line = _line(record)
        try:
            self._stream.write(line)
            self._stream.flush()
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise OSError(
                f"{self.path} cannot be written: {error.strerror}; all earlier answers are in it; --resume continues"
            ) from None


def subjects(folder: Path) -> Iterator[Path]:
    """Yield the files of records in a folder, in the order of the persons' codes."""
    yield from sorted(folder.glob(f"*{SUFFIX}"))


def _line(record: dict[str, Any]) -> bytes:
    return json.dumps(record, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _sync_folder(folder: Path) -> None:
    """Write the name of a new file to disk, on systems that can sync a folder."""
    with contextlib.suppress(OSError, AttributeError):
        number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _lock(stream: BinaryIO, path: Path) -> None:
    """Lock a file until its stream is closed or the program ends.

    Raises:
        OSError: for a file that another program has locked.
    """
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
