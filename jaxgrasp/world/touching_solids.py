"""Where two convex solids touch, or a solid touches a table: a plane between them, and the corners of what meets there.

The plane is that of the largest gap among directions that can matter: normals of faces, edges across edges, and towards
corners, axes and balls. What the two reach it with is cut to what they share.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.numerics.centring import tangents
from jaxgrasp.world.solids import Solid

THIN = 1e-6
"""Half the width for which a line or a place counts [m]."""
SAME = 1e-5
"""Places closer than that are one [m]."""
MANY = 8
"""So many places of a patch are kept at most."""
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
CLOSEST = 8
"""So many of the shortest ways between two solids count as directions."""
STARTS = 4
"""So many of the best directions are improved, where there is a rim."""
STEPS = 0.2 * 0.7 ** np.arange(24)
"""Lengths of steps by which a direction is improved."""
TIE = 1e-9
"""By how much more an edge across an edge must keep apart than a face [m]."""


class Patch(NamedTuple):
    """What one solid touches another with."""

    points: Float[np.ndarray, "m 3"]
    """In the plane between them [m]."""
    normal: Float[np.ndarray, "3"]
    """Unit, from the second into the first."""
    gap: float
    """Between them [m]; negative where they are inside one another."""


def table_patch(solid: Solid, table: Pose) -> Patch:
    """A solid and the half space below a table's top."""
    up = np.asarray(table.rotation, float)[:, 2]
    points = solid.feature(-up)
    heights = (points - np.asarray(table.origin)) @ up
    return Patch(_outermost(points - heights[:, None] * up, up), up, float(heights.min()))


def patch_between(first: Solid, second: Solid, within: float) -> Patch | None:
    """Where two solids touch; None of those that are certainly apart, or further than ``within`` [m]."""
    way = first.origin - second.origin
    if np.linalg.norm(way) > first.extent() + second.extent() + within:
        return None
    normal, gap = _furthest_apart(first, second)
    if gap > within:
        return None
    plane = _across(normal)
    both = first.feature(-normal) @ plane, second.feature(normal) @ plane
    shared = _shared(*both)
    if not len(shared):
        if gap > 0:
            return None
        # Deep inside one another with round sides: the plane is not quite theirs.
        shared = min(both, key=len).mean(0, keepdims=True)
    height = normal @ second.origin + second.reach(normal[None])[0] + gap / 2
    return Patch(_outermost(shared @ plane.T + height * normal, normal), normal, gap)


def _furthest_apart(first: Solid, second: Solid) -> tuple[np.ndarray, float]:
    """The direction in which the gap between two solids is largest, and that gap.

    Where flat faces and straight edges meet it is among the directions that are tried; a rim is followed from there.
    """

    def gaps(directions: np.ndarray) -> np.ndarray:
        return directions @ (first.origin - second.origin) - first.reach(-directions) - second.reach(directions)

    directions, handicap = _directions(first, second)
    found = gaps(directions) - handicap
    order = np.argsort(-found)
    normal, gap = directions[order[0]], float(found[order[0]])
    if not (first.has_rim or second.has_rim) or handicap[order[0]] == 0:
        return normal, gap
    climbed = [_climb(gaps, directions[start]) for start in order[:STARTS]]
    return max(climbed, key=lambda one: one[1])


def _climb(gaps: Callable[[np.ndarray], np.ndarray], normal: np.ndarray) -> tuple[np.ndarray, float]:
    """A direction of a larger gap near another, and that gap."""
    gap = float(gaps(normal[None])[0])
    for k, size in enumerate(STEPS):
        # Turned each time, since gaps have ridges.
        around = normal + size * _compass(float(k)) @ _across(normal).T
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        further = gaps(around)
        if further.max() > gap:
            normal, gap = around[np.argmax(further)], float(further.max())
    return normal, gap


def _directions(first: Solid, second: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions from the second to the first in which they may be apart, and what each is put back by."""
    faces = np.concatenate([first.axes(), second.axes()])
    edges = np.cross(first.axes()[:, None], second.axes()).reshape(-1, 3)
    places, others = first.places(), second.places()
    ways = _shortest(places - second.nearest(places)), _shortest(first.nearest(others) - others)
    found = np.concatenate([faces, -faces, edges, -edges, *ways])
    length = np.linalg.norm(found, axis=1)
    handicap = np.where(np.arange(len(found)) < 2 * len(faces), 0, TIE)
    sound = length > SAME
    return found[sound] / length[sound, None], handicap[sound]


def _compass(turned: float) -> np.ndarray:
    """``(8, 2)``: directions in the plane."""
    angles = turned + np.pi / 4 * np.arange(MANY)
    return np.stack([np.cos(angles), np.sin(angles)], 1)


def _shortest(ways: np.ndarray) -> np.ndarray:
    """The shortest of ways from one solid to another."""
    return ways[np.argsort(np.linalg.norm(ways, axis=1))[:CLOSEST]]


def _across(normal: np.ndarray) -> np.ndarray:
    """``(3, 2)``: unit vectors in the plane of a normal, as columns."""
    return np.stack(tangents(normal, np), 1)


def _shared(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """``(m, 2)``: corners of what two convex figures in the plane share, each given by some of its places."""
    figure = _hull(one)
    fence = _hull(other)
    for start, end in zip(fence, np.roll(fence, -1, 0), strict=True):
        way = end - start
        inside = way[0] * (figure[:, 1] - start[1]) - way[1] * (figure[:, 0] - start[0])
        following, beyond = np.roll(figure, -1, 0), np.roll(inside, -1)
        kept = []
        for here, there, depth, further in zip(figure, following, inside, beyond, strict=True):
            if depth >= 0:
                kept.append(here)
            if (depth >= 0) != (further >= 0):
                kept.append(here + depth / (depth - further) * (there - here))
        if not kept:
            return np.zeros((0, 2))
        figure = np.array(kept)
    return figure


def _hull(places: np.ndarray) -> np.ndarray:
    """``(m, 2)``: corners of the convex figure of places, widened a little, in the sense of the clock's opposite."""
    wide = (places[:, None] + THIN * SQUARE).reshape(-1, 2)
    middle = wide.mean(0)
    return wide[_convex_order(wide)] if len(places) > 1 else middle + THIN * SQUARE


def _convex_order(places: np.ndarray) -> np.ndarray:
    """Indices of the corners of places' convex hull (Andrew's monotone chain)."""
    order = np.lexsort((places[:, 1], places[:, 0]))

    def chain(indices: np.ndarray) -> list[int]:
        kept: list[int] = []
        for index in indices:
            while len(kept) > 1 and _turn(places[kept[-2]], places[kept[-1]], places[index]) <= 0:
                kept.pop()
            kept.append(int(index))
        return kept[:-1]

    return np.array(chain(order) + chain(order[::-1]))


def _turn(first: np.ndarray, second: np.ndarray, third: np.ndarray) -> float:
    one, other = second - first, third - first
    return float(one[0] * other[1] - one[1] * other[0])


def _outermost(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The points of a patch, each once; of many those that go furthest in some directions."""
    same = np.linalg.norm(points[:, None] - points, axis=-1) < SAME
    # In the middle of those that are one, since a ball that is held a micrometre beside its lowest place rolls.
    points = np.array([points[same[k]].mean(0) for k in np.unique(np.argmax(same, 1))])
    if len(points) <= MANY:
        return points
    return points[np.unique(np.argmax(points @ _across(normal) @ _compass(0.2).T, 0))]
