"""Which grasps have normals that point out of the object, as far as contacts alone can tell; NumPy on flat arrays."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxgrasp.files.printable import shortened

ROUNDING = 1e-3
"""Part of the distances: as far as normals out of files may be off."""
STRAIGHT_AWAY = -np.sqrt(0.5)
"""Cosine of normal and direction to the middle: a contact beyond 135 degrees is suspected by itself."""
NAMED = 5
"""Grasps that a warning names."""


class NormalDirections(NamedTuple):
    """What the contacts of each of N grasps say about the sign of their normals."""

    away: np.ndarray
    """``(N,)``: normals point away from the middle of the grasp's contacts, in all or straight at a contact."""
    decided: np.ndarray
    """``(N,)``: False where normals lie across the directions to the middle, so that contacts cannot tell."""


def normal_directions(points: np.ndarray, normals: np.ndarray, offsets: np.ndarray) -> NormalDirections:
    """Return which grasps have normals that point away from the middle of their contacts.

    Inward normals of a convex object never do: the middle q of points p on it lies inside, so that a . (q - p) >= 0.

    Args:
        points: contacts of all grasps ``(M, 3)`` [m].
        normals: ``(M, 3)``.
        offsets: grasp i owns contacts ``offsets[i]:offsets[i + 1]``, ``(N + 1,)``.
    """
    sizes = np.diff(offsets)
    away, decided = np.zeros(len(sizes), bool), np.zeros(len(sizes), bool)
    held = np.flatnonzero(sizes)
    if not len(held):
        return NormalDirections(away, decided)
    starts, owner = offsets[:-1][held], np.repeat(np.arange(len(held)), sizes[held])
    with np.errstate(invalid="ignore", over="ignore"):
        ways = to_middle(points, offsets)
        distance, inward = np.linalg.norm(ways, axis=1), np.einsum("ci,ci->c", ways, normals)
        reach, total = np.add.reduceat(distance, starts), np.add.reduceat(inward, starts)
        straight = (distance > ROUNDING * reach[owner]) & (inward < STRAIGHT_AWAY * distance)
        away[held] = (total < -ROUNDING * reach) | np.logical_or.reduceat(straight, starts)
        decided[held] = away[held] | (total > ROUNDING * reach)
    return NormalDirections(away, decided)


def to_middle(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return the vectors from each contact to the mean of its grasp's contacts, ``(M, 3)`` [m]."""
    held = np.flatnonzero(np.diff(offsets))
    if not len(held):
        return np.zeros((0, 3))
    sizes = np.diff(offsets)[held]
    middle = np.add.reduceat(points, offsets[:-1][held], axis=0) / sizes[:, None]
    return np.repeat(middle, sizes, axis=0) - points


def direction_warning(names: Sequence[str], away: int, decided: int, remedy: str) -> str:
    """Return the sentence that warns of grasps whose normals point away, of which there are ``away``.

    Args:
        names: of the first such grasps.
        away: how many there are.
        decided: of how many grasps the contacts can tell.
        remedy: how the sentence ends, after the grasps that are to be checked.
    """
    shown = ", ".join(shortened(name) for name in names[:NAMED]) + (", ..." if away > len(names[:NAMED]) else "")
    return (
        f"normals of {away:,} of {decided:,} grasps point away from the middle of their contacts, as those into a "
        f"convex object never do ({shown}): {remedy}"
    )
