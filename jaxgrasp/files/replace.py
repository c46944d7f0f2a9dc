"""Replacement of whole files, so that neither a reader nor a crash leaves or meets half a file."""

import contextlib
import os
import re
import secrets
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO

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
            with contextlib.suppress(OSError):
                directory.rmdir()
