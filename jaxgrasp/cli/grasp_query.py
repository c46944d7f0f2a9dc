"""Choice of a grasp of a file by its name or number, as commands take it."""

import difflib

import numpy as np

from jaxgrasp.files.printable import shortened

MOST_NAMES = 2_000
"""Names among which the nearest to an unknown one are looked for."""
SIMILAR, COVERED, NEAREST = 0.6, 0.7, 3
"""Least similarity, as difflib measures it; least share of a text that a longer name repeats; number of the names that
a message lists."""


class GraspQuery:
    """Name or number that a user gave, compared with the names of a file's grasps, which come in parts."""

    def __init__(self, query: str):
        self._query = query
        self._count = 0
        self._matches: list[int] = []
        self._names: list[str] = []

    def look(self, names: np.ndarray | None, count: int) -> None:
        """Compare with the next ``count`` grasps, of these names ``(count,)``, or None if they have none."""
        if names is not None:
            self._matches += (self._count + np.flatnonzero(names == self._query)).tolist()
            self._names += names[: MOST_NAMES - len(self._names)].tolist()
        self._count += count

    def number(self, file: str) -> int:
        """Return the number of the grasp of the wanted name, or else of that number.

        Raises:
            ValueError: naming the nearest names where there is no such grasp, and the numbers of several of that name.
        """
        if len(self._matches) > 1:
            listed = " and ".join(map(str, self._matches[:2]))
            raise ValueError(f"grasps {listed} are both named {shortened(self._query)}: give a number")
        if self._matches:
            return self._matches[0]
        is_number = self._query.isascii() and self._query.isdecimal()
        if is_number and int(self._query) < self._count:
            return int(self._query)
        range_ = f"a number from 0 to {self._count - 1}"
        expected = f": expected {range_}" if is_number or not self._names else self._nearest(range_)
        raise ValueError(f"{file} holds no grasp {shortened(self._query)}{expected}")

    def _nearest(self, range_: str) -> str:
        """Return the end of a message on an unknown name: the nearest names, or some names where none is near."""
        names = list(dict.fromkeys(self._names))
        query = self._query[:200]
        near = difflib.get_close_matches(query, names, NEAREST, SIMILAR)
        if not near:
            # Of names far longer than what was typed, none is similar as a whole.
            covered = sorted(((-_covered_share(query, name), k) for k, name in enumerate(names)))[:NEAREST]
            near = [names[k] for share, k in covered if -share >= COVERED]
        if near:
            *first, last = map(shortened, near)
            return f": did you mean {', '.join(first)}{' or ' if first else ''}{last}?"
        return f": expected a name, such as {', '.join(map(shortened, names[:NEAREST]))}, or {range_}"


def _covered_share(query: str, name: str) -> float:
    """Return the share of the query's characters that the name has in the same order, in pieces of 2 or more."""
    blocks = difflib.SequenceMatcher(None, query, name, autojunk=False).get_matching_blocks()
    return sum(block.size for block in blocks if block.size > 1) / max(1, len(query))
