"""Locks that let a single process at a time work in a folder, or on a part of it, by a lock of the operating system.

The lock is on an open file, so it ends with its process, however that ends. What the file says, the owner's process and
when it started, is for whoever finds the folder held, or finds that an owner is gone.
"""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from jaxgrasp.files.printable import printable

LOCK = ".lock"
LARGEST = 1000
"""Characters of a lock file that are read: a foreign file of that name may be of any size."""


class FolderHeldError(OSError):
    """Error of a folder that another process works in."""


@contextmanager
def locked(folder: Path, announce: Callable[[str], None] = lambda text: None, *, part: str = "") -> Iterator[None]:
    """Hold ``folder``, which is there, until the block ends.

    Args:
        folder: a folder of any content; the lock is the file ``.lock`` in it, gone when the block ends.
        announce: told of an owner that is gone and left its lock.
        part: name of the part of the folder that is held, if not all of it; the lock is then ``.PART.lock``.

    Raises:
        FolderHeldError: where another process, or another thread of this one, holds it; it says which.
        OSError: where no lock can be made there.
    """
    path = folder / (f".{part}{LOCK}" if part else LOCK)
    descriptor = _acquired(path, announce)
    try:
        yield
    finally:
        # Removed while it is held, so that nobody holds a file that is no longer there.
        with suppress(OSError):
            path.unlink(missing_ok=True)
        os.close(descriptor)


def _acquired(path: Path, announce: Callable[[str], None]) -> int:
    while True:
        # A link in its place might lead to anyone's file.
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        try:
            if not _try_lock(descriptor):
                raise FolderHeldError(f"{_owner(descriptor) or 'another process'} works in it")
            # The one before may have removed the file between our opening and locking it.
            if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
                if previous_owner := _owner(descriptor):
                    announce(f"{path.parent}: taken over from {previous_owner} which has ended")
                started = datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, json.dumps({"process": os.getpid(), "started": started}).encode(), 0)
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _owner(descriptor: int) -> str | None:
    """Read the owner that the lock file names; None if the file names no owner."""
    try:
        record = json.loads(os.pread(descriptor, LARGEST, 0))
        return f"process {int(record['process'])}, at work since {printable(str(record['started'])[:30])},"
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None


def _try_lock(descriptor: int) -> bool:
    """Try to take the lock of an open file without waiting; return True if this process holds it now."""
    try:
        import fcntl
    except ImportError:
        return _try_lock_on_windows(descriptor)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _try_lock_on_windows(descriptor: int) -> bool:
    import msvcrt

    # A byte far behind what is written, since nobody else may read a locked one.
    os.lseek(descriptor, 1 << 20, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except OSError:
        return False
    return True
