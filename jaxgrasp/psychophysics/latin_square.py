"""Balanced Latin squares, by which the order of conditions is counterbalanced over persons."""

from jaxgrasp.validation.checked import checked


@checked
def balanced_latin_square(count: int) -> list[list[int]]:
    """Return orders of ``count`` conditions, numbered from 0: a row for each person in turn.

    In all rows together each condition stands in each place equally often, and follows every other equally often.
    An even number of conditions takes as many rows, an odd one twice as many (Williams, Aust. J. Sci. Res. A 2, 1949).
    """
    zigzag = [(k + 1) // 2 if k % 2 else -k // 2 for k in range(count)]
    rows = [[(row + step) % count for step in zigzag] for row in range(count)]
    return rows if count % 2 == 0 else rows + [row[::-1] for row in rows]
