"""Spheres inside a solid by octree subdivision: offline, in NumPy.

A cube about the solid is cut in eight, and those in eight again. A cell wholly outside is dropped. A cell wholly
inside gets the largest ball about its centre that the solid holds, which covers it, and is cut no further. A cell
that the surface passes through is cut until the last level, where it gets a ball that touches the surface at the
point nearest to the cell's centre, from inside. So all balls lie in the solid, and what their union leaves out of
it shrinks with the square of the cells.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxgrasp.hand.mesh import NearestPoints

ROUND = 1.0
"""Largest radius of a ball at the surface, in edges of its cell: larger ones leave flatter gaps, but many more of
them reach the same place."""
SHRINKS = 8
"""Most steps by which a ball shrinks until it lies inside."""
ROUNDING = 1e-6
"""Share of a length below which two are the same."""
SMALL = 0.05
"""Radius, in edges of a cell, below which a ball at the surface tells nothing."""

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


class Octree(NamedTuple):
    """Cells in order of their level, and the ball of those that are cut no further."""

    centers: np.ndarray
    """``(N, 3)`` of the balls, or the cells where there is none [m]."""
    radii: np.ndarray
    """``(N,)`` of the balls; 0 where the cell is cut further [m]."""
    parents: np.ndarray
    """``(N,)``: the cell each was cut from; -1 for the first."""
    level: np.ndarray
    """``(N,)``"""

    @property
    def leaf(self) -> np.ndarray:
        """Mask ``(N,)`` of the cells that are cut no further."""
        return self.radii > 0


def octree_balls(
    nearest: Callable[[np.ndarray], NearestPoints], low: np.ndarray, high: np.ndarray, levels: int
) -> Octree:
    """Fill a solid within a box with balls, by the distances of points from its surface.

    Args:
        nearest: of points ``(P, 3)``.
        low: corner of the box ``(3,)`` [m].
        high: the other corner [m].
        levels: number of times that cells are cut.
    """
    half = float((high - low).max()) / 2
    cells, parents = (low + high)[None] / 2, np.array([-1])
    parts, count = [], 0
    for level in range(levels + 1):
        surface = nearest(cells)
        diagonal = np.sqrt(3) * half
        last = level == levels
        inside = surface.distance <= -diagonal
        occupied = surface.distance < diagonal
        centers, radii = cells.copy(), np.where(inside, -surface.distance, 0.0)
        if last:
            # Where the nearest point lies in another cell, the surface clips a corner only, and that cell has it.
            cut = occupied & ~inside & (np.abs(surface.foot - cells).max(1) <= half * (1 + ROUNDING))
            centers[cut], radii[cut] = _surface_balls(
                nearest, cells[cut], NearestPoints(*(a[cut] for a in surface)), 2 * half
            )
            occupied &= radii > SMALL * 2 * half
        parts.append((centers[occupied], radii[occupied], parents[occupied], np.full(occupied.sum(), level)))
        first, count = count, count + int(occupied.sum())
        to_split = (radii[occupied] == 0).nonzero()[0]
        half /= 2
        cells = (cells[occupied][to_split][:, None] + half * CORNERS).reshape(-1, 3)
        parents = np.repeat(first + to_split, 8)
    return _without_empty(Octree(*map(np.concatenate, zip(*parts, strict=True))))


def _surface_balls(
    nearest: Callable[[np.ndarray], NearestPoints], cells: np.ndarray, surface: NearestPoints, edge: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute balls inside, each touching the surface at the point nearest to a cell's centre where it can.

    A ball through that point shrinks about it until no other point of the surface lies in it.
    """
    # A cell whose centre lies on the surface is on no side of it.
    apart = np.abs(surface.distance) > ROUNDING * edge
    from_foot = np.where(surface.distance < 0, -1, 1)[:, None] * (cells - surface.foot)
    outward = np.where(apart[:, None], from_foot, surface.normal)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    radius = np.full(len(cells), ROUND * edge)
    moving = np.arange(len(cells))
    for _ in range(SHRINKS):
        foot, out = surface.foot[moving], outward[moving]
        opposite = nearest(foot - radius[moving, None] * out)
        chord = opposite.foot - foot
        chord_depth = -np.einsum("pi,pi->p", chord, out)
        with np.errstate(divide="ignore", invalid="ignore"):
            touching_radius = np.einsum("pi,pi->p", chord, chord) / (2 * chord_depth)
        enters = (
            (-opposite.distance < radius[moving] * (1 - ROUNDING))
            & (chord_depth > 0)
            & (touching_radius < radius[moving])
        )
        moving = moving[enters]
        radius[moving] = touching_radius[enters]
        # At an edge no ball touches the point itself, and half a cell is what is taken below.
        moving = moving[radius[moving] > edge / 2]
        if not len(moving):
            break
    radius = np.maximum(radius, edge / 2)
    centers = surface.foot - radius[:, None] * outward
    return centers, np.maximum(-nearest(centers).distance, 0)


def _without_empty(tree: Octree) -> Octree:
    """Return the tree without cells that have neither a ball nor cells below with one."""
    occupied = tree.leaf
    for level in range(int(tree.level.max()), 0, -1):
        occupied[tree.parents[occupied & (tree.level == level)]] = True
    new_index = np.cumsum(occupied) - 1
    parents = tree.parents[occupied]
    return Octree(
        tree.centers[occupied],
        tree.radii[occupied],
        np.where(parents < 0, -1, new_index[parents]),
        tree.level[occupied],
    )
