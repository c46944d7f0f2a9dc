"""Safe writing to disk: files are replaced whole, and a folder, or a part of it, is locked for a single process.

Neither a reader nor a crash leaves or meets half a file. A lock ends with its process, however that ends. The record
beside it, of the owner's process and its start, is for whoever finds the folder held, or finds that an owner is gone.
"""

import json
import os
import re
import secrets
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from jaxgrasp.files.printable import printable

PARTIAL = re.compile(r"\.(.+)\.[0-9a-f]+\.partial")
"""Name of a partial file; the group is the name of the file that it was to replace."""


def partial_target(name: str) -> str | None:
    """Return the name of the file that a partial file of ``replace_file`` was to replace; None for another file."""
    match = PARTIAL.fullmatch(name)
    return match[1] if match else None


def partial_path(path: Path) -> Path:
    """Return a path with a random name beside ``path``, for what is to replace it once it is whole."""
    return path.with_name(f".{path.name}.{secrets.token_hex(8)}.partial")


def replace_file(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write beside ``path`` and rename, so that a reader never meets half a file; what is written may be read again.

    The partial file has a random name, so that threads, processes and machines that write to one path at a time each
    write a file of their own; the last one to finish stays.

    Raises:
        OSError: where it cannot be written, by its own name: of a full device too, where the system names no file.
    """
    beside = partial_path(path)
    try:
        with open(beside, "x+b") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(beside, path)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(beside)):
            # Without a number it is a library's own; with another name it is of a file that is read on the way.
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        beside.unlink(missing_ok=True)


def check_writable(folder: Path, name: str = "out") -> None:
    """Check that files can be written in a folder, which need not exist; leave nothing behind.

    Args:
        folder: to be written in, made with the folders above it where it is not there.
        name: of the argument, for the message.

    Raises:
        OSError: where they cannot.
    """
    missing = [directory for directory in (folder, *folder.parents) if not directory.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(f"{name} is {folder}, where nothing can be written: {error.strerror}") from None
    finally:
        for directory in missing:
            with suppress(OSError):
                directory.rmdir()


LOCK = ".lock"
OWNER = ".owner"
MAX_LENGTH = 1000
"""Bytes of an owner's record that are read: a foreign file of that name may be of any size."""


class FolderHeldError(OSError):
    """Error of a folder that another process works in."""


@contextmanager
def locked(folder: Path, announce: Callable[[str], None] = lambda text: None, *, part: str = "") -> Iterator[None]:
    """Hold ``folder``, which is there, until the block ends.

    Args:
        folder: a folder of any content; the lock is the file ``.lock`` in it, and its owner's record ``.lock.owner``,
            both gone when the block ends.
        announce: told of an owner that is gone and left its record.
        part: name of the part of the folder that is held, if not all of it; the lock is then ``.PART.lock``.

    Raises:
        FolderHeldError: where another process, or another thread of this one, holds it; it says which.
        OSError: where no lock can be made there.
    """
    # Imported here, since it takes 18 ms, and few of the processes that replace files lock a folder.
    from filelock import FileLock, Timeout

    path = folder / (f".{part}{LOCK}" if part else LOCK)
    record = path.with_name(path.name + OWNER)
    lock = FileLock(path, timeout=0, thread_local=False)
    try:
        lock.acquire()
    except Timeout:
        raise FolderHeldError(f"{_owner(record) or 'another process'} works in it") from None
    try:
        if previous_owner := _owner(record):
            announce(f"{folder}: taken over from {previous_owner} which has ended")
        started = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        content = json.dumps({"process": os.getpid(), "started": started}).encode()
        replace_file(record, lambda file: file.write(content))
        yield
    finally:
        # Removed while the lock is held, so that nobody's record or lock is removed but our own.
        for each in (record, path):
            with suppress(OSError):
                each.unlink(missing_ok=True)
        lock.release()


def _owner(record: Path) -> str | None:
    """Read the owner that a record names; None without a record, or if it names no owner."""
    try:
        with record.open("rb") as file:
            owner = json.loads(file.read(MAX_LENGTH))
        return f"process {int(owner['process'])}, at work since {printable(str(owner['started'])[:30])},"
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
