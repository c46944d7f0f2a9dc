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
        found = nearest(cells)
        diagonal = np.sqrt(3) * half
        last = level == levels
        inside = found.distance <= -diagonal
        kept = found.distance < diagonal
        centers, radii = cells.copy(), np.where(inside, -found.distance, 0.0)
        if last:
            # Where the nearest point lies in another cell, the surface clips a corner only, and that cell has it.
            cut = kept & ~inside & (np.abs(found.foot - cells).max(1) <= half * (1 + ROUNDING))
            centers[cut], radii[cut] = _surface_balls(
                nearest, cells[cut], NearestPoints(*(a[cut] for a in found)), 2 * half
            )
            kept &= radii > SMALL * 2 * half
        parts.append((centers[kept], radii[kept], parents[kept], np.full(kept.sum(), level)))
        first, count = count, count + int(kept.sum())
        further = (radii[kept] == 0).nonzero()[0]
        half /= 2
        cells = (cells[kept][further][:, None] + half * CORNERS).reshape(-1, 3)
        parents = np.repeat(first + further, 8)
    return _without_empty(Octree(*map(np.concatenate, zip(*parts, strict=True))))


def _surface_balls(
    nearest: Callable[[np.ndarray], NearestPoints], cells: np.ndarray, found: NearestPoints, edge: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute balls inside, each touching the surface at the point nearest to a cell's centre where it can.

    A ball through that point shrinks about it until no other point of the surface lies in it.
    """
    # A cell whose centre lies on the surface is on no side of it.
    apart = np.abs(found.distance) > ROUNDING * edge
    away = np.where(found.distance < 0, -1, 1)[:, None] * (cells - found.foot)
    outward = np.where(apart[:, None], away, found.normal)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    radius = np.full(len(cells), ROUND * edge)
    moving = np.arange(len(cells))
    for _ in range(SHRINKS):
        foot, out = found.foot[moving], outward[moving]
        seen = nearest(foot - radius[moving, None] * out)
        chord = seen.foot - foot
        along = -np.einsum("pi,pi->p", chord, out)
        with np.errstate(divide="ignore", invalid="ignore"):
            through = np.einsum("pi,pi->p", chord, chord) / (2 * along)
        enters = (-seen.distance < radius[moving] * (1 - ROUNDING)) & (along > 0) & (through < radius[moving])
        moving = moving[enters]
        radius[moving] = through[enters]
        # At an edge no ball touches the point itself, and half a cell is what is taken below.
        moving = moving[radius[moving] > edge / 2]
        if not len(moving):
            break
    radius = np.maximum(radius, edge / 2)
    centers = found.foot - radius[:, None] * outward
    return centers, np.maximum(-nearest(centers).distance, 0)


def _without_empty(tree: Octree) -> Octree:
    """Return the tree without cells that have neither a ball nor cells below with one."""
    kept = tree.leaf
    for level in range(int(tree.level.max()), 0, -1):
        kept[tree.parents[kept & (tree.level == level)]] = True
    place = np.cumsum(kept) - 1
    parents = tree.parents[kept]
    return Octree(tree.centers[kept], tree.radii[kept], np.where(parents < 0, -1, place[parents]), tree.level[kept])
