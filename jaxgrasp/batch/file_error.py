"""What readers and writers of grasp files report: files that cannot be used, and columns that no reader uses."""

import difflib
import os
import warnings
from collections.abc import Collection, Iterable

from jaxgrasp.files.printable import message_line, printable


class GraspFileError(ValueError):
    """Error of a file that cannot be used: its path and the reason."""

    def __init__(self, path: str | os.PathLike, reason: str):
        super().__init__(f"{os.fspath(path)}: {reason}")
        self.path = path
        self.reason = reason


CLOSE = 0.7
"""Similarity of two names, as difflib measures it, from which one is taken for the other, misspelled."""
LONGEST_NAME = 60
"""Characters of a column's name that a message shows."""


def warn_unused_columns(path: os.PathLike, names: Iterable[str], known: Collection[str]) -> None:
    """Warn once for a file of the columns that it has and no reader uses.

    Args:
        path: of the file.
        names: of its columns; those without a name are not mentioned.
        known: names of the columns that are read.
    """
    if unused := describe_unknown(names, known):
        warnings.warn(message_line(f"{path}: columns that are not used: {', '.join(unused)}"), stacklevel=5)


def describe_unknown(names: Iterable[str], known: Collection[str], *, only_close: bool = False) -> list[str]:
    """Return each unknown name, with the nearest known name that the file lacks where that is close.

    Args:
        names: of a file's columns.
        known: names of the columns that are read.
        only_close: leave out the names that are close to no known one.
    """
    present = list(dict.fromkeys(filter(None, names)))
    lacking = sorted(set(known) - set(present))
    descriptions = []
    for name in present:
        if name in known:
            continue
        shown = printable(name[:LONGEST_NAME])
        matches = difflib.get_close_matches(name[:LONGEST_NAME].lower(), lacking, 1, CLOSE)
        if matches or not only_close:
            descriptions.append(f"{shown} (did you mean {matches[0]}?)" if matches else shown)
    return descriptions
