"""Redirection of what C code writes to stderr, past Python's ``sys.stderr``."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any


@contextmanager
def redirected_stderr(file: IO[Any]) -> Iterator[None]:
    """Let the process write to ``file`` in place of stderr until the block ends; without a stderr nothing changes."""
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        saved = os.dup(2)
    except OSError:
        yield
        return
    os.dup2(file.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
