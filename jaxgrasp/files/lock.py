"""Locks that let a single process at a time work in a folder, or on a part of it, by ``filelock``.

The lock ends with its process, however that ends. A record beside it, the owner's process and when it started, is for
whoever finds the folder held, or finds that an owner is gone.
"""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from jaxgrasp.files.printable import printable
from jaxgrasp.files.replace import replace_file

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
