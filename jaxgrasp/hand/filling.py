"""Sphere trees of solids: filling with balls and their stacking into a tree, once, in NumPy.

Spheres inside a solid by octree subdivision: offline, in NumPy.

A cube about the solid is cut in eight, and those in eight again. A cell wholly outside is dropped. A cell wholly
inside gets the largest ball about its centre that the solid holds, which covers it, and is cut no further. A cell
that the surface passes through is cut until the last level, where it gets a ball that touches the surface at the
point nearest to the cell's centre, from inside. So all balls lie in the solid, and what their union leaves out of
it shrinks with the square of the cells.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.hand.mesh import Mesh, MeshSurface, NearestPoints, check_mesh, mass_properties, sample_surface
from jaxgrasp.hand.shapes import Shape, check_shape, signed_distance
from jaxgrasp.hand.sphere_tree import Balls, Nodes, SphereTree
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.validation.checked import checked

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


LEVELS = 5
"""Default number of cuts of the cube about a solid: into cells of 3 % of its longest side."""
START = 12
"""Nodes with which a descent starts, at least: of so few balls all are tried. Of more a descent has always been faster
(python -m benchmarks.sphere_trees)."""
OFF_AXIS = 1e-6
"""Share of a solid's size, or of its inertia, by which a frame may miss the principal one."""


class FillingError(NamedTuple):
    """Distances from a solid's surface to the balls of a tree, where it lies outside all of them."""

    balls: int
    largest: float
    """Distance from the surface to the balls, at the worst of the sampled points [m]."""
    mean: float
    """[m]"""


class LevelError(NamedTuple):
    """Filling error of the tree of so many levels."""

    levels: int
    cell: float
    """Edge of the smallest cells [m]."""
    error: FillingError


@checked
def sphere_tree(solid: Mesh | Shape, levels: int = LEVELS, *, descends: bool | None = None) -> SphereTree:
    """Compute the tree of balls inside a solid.

    Args:
        solid: a watertight mesh, or an exact shape with an end.
        levels: how often the cube about it is cut in eight.
        descends: whether contacts are found by descent; ``None`` for what is faster.

    Raises:
        ImportError: for a mesh without the extra `mesh`.
        ValueError: for a mesh that is no closed solid, a size that is not positive, or no levels.
    """
    if levels < 1:
        raise ValueError(f"levels is {levels}: expected 1 or more")
    outline = _outline(solid, levels)
    tree = octree_balls(outline.nearest, outline.low, outline.high, levels)
    if not len(tree.radii):
        raise ValueError(f"levels is {levels}: expected more, since no ball of such large cells fits into the solid")
    balls = _balls(tree.centers[tree.leaf], tree.radii[tree.leaf])
    descends = len(balls.radii) > START if descends is None else descends
    return SphereTree(balls, _nodes(tree), jnp.asarray(outline.moments), descends)


@checked
def level_errors(mesh: Mesh, levels: int = LEVELS, samples: int = 4000, seed: int = 0) -> list[LevelError]:
    """Compute the filling errors of trees of 1, 2 ... levels, at points spread evenly over a solid's surface.

    Trees of so few levels that no ball fits into the solid are passed over. Since all balls lie inside, a tree makes
    depths smaller than they are, about by this, and never larger.

    Args:
        mesh: a watertight one.
        levels: of the finest tree.
        samples: points on the surface.
        seed: of their places.

    Raises:
        ImportError, ValueError: as [`jaxgrasp.hand.sphere_tree`][] does.
    """
    mesh = check_mesh(mesh)
    points = sample_surface(mesh, samples, seed)
    errors = []
    for level in range(1, levels + 1):
        outline = _outline(mesh, level)
        tree = octree_balls(outline.nearest, outline.low, outline.high, level)
        if tree.leaf.any():
            left_out = _uncovered_depth(points, tree.centers[tree.leaf], tree.radii[tree.leaf])
            errors.append(LevelError(level, cell_size(mesh, level), left_out))
    return errors


def filling_error(tree: SphereTree, mesh: Mesh, samples: int = 4000, seed: int = 0) -> FillingError:
    """Compute the filling error of a tree against its checked mesh, as [`jaxgrasp.hand.level_errors`][] does."""
    return _uncovered_depth(
        sample_surface(mesh, samples, seed), np.asarray(tree.balls.centers), np.asarray(tree.balls.radii)
    )


def cell_size(mesh: Mesh, levels: int) -> float:
    """Compute the edge of a tree's smallest cells [m]."""
    return float(np.ptp(mesh.vertices, axis=0).max()) / 2**levels


def _uncovered_depth(points: np.ndarray, centers: np.ndarray, radii: np.ndarray) -> FillingError:
    uncovered = np.maximum(_outside(points, centers, radii), 0)
    return FillingError(len(radii), float(uncovered.max()), float(uncovered.mean()))


def _outside(points: np.ndarray, centers: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Compute the distance of points from the nearest ball, negative inside."""
    chunks = np.array_split(points, max(1, points.shape[0] * len(radii) // 10**7))
    return np.concatenate([np.min(np.linalg.norm(c[:, None] - centers, axis=-1) - radii, 1) for c in chunks])


class _Outline(NamedTuple):
    """Solid as the octree needs it: nearest points, bounding box and principal moments."""

    nearest: Callable[[np.ndarray], NearestPoints]
    low: np.ndarray
    high: np.ndarray
    moments: np.ndarray


def _outline(solid: Mesh | Shape, levels: int) -> _Outline:
    if isinstance(solid, Shape):
        check_shape(solid)
        low, high = (sign * _extents(solid, sign) for sign in (-1.0, 1.0))
        return _Outline(lambda points: _nearest(solid, points), low, high, np.array(solid._moments()))
    mesh = check_mesh(solid)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    return _Outline(MeshSurface(mesh, 2 * cell_size(mesh, levels)).nearest, low, high, _principal_moments(mesh))


def _extents(shape: Shape, sign: float) -> np.ndarray:
    """Compute the extents of a shape from its origin along x, y and z, or along -x, -y and -z [m]."""
    x, y, z = sign * np.eye(3)
    return np.asarray(shape._support(Vec3(jnp.asarray(x), jnp.asarray(y), jnp.asarray(z))), float)


def _nearest(shape: Shape, points: np.ndarray) -> NearestPoints:
    distance, out = (np.asarray(part, float) for part in signed_distance(shape, jnp.asarray(points)))
    return NearestPoints(distance, points - distance[:, None] * out, out)


def _principal_moments(mesh: Mesh) -> np.ndarray:
    """Compute the principal moments of a mesh [m^2]; NaN where its frame is not the principal one, as a Body's is."""
    _, center, inertia = mass_properties(mesh)
    moments = np.diagonal(inertia)
    off_axis = np.abs(inertia - np.diag(moments)).max() > OFF_AXIS * moments.max()
    off_center = np.linalg.norm(center) > OFF_AXIS * np.linalg.norm(np.ptp(mesh.vertices, axis=0))
    return np.full(3, np.nan) if off_axis or off_center else moments


def _balls(centers: np.ndarray, radii: np.ndarray) -> Balls:
    return Balls(*map(jnp.asarray, (*centers.T, radii)))


def _nodes(tree: Octree) -> Nodes:
    """Compute the nodes of the tree: bounds, children and the start of the descent."""
    count, leaf = len(tree.radii), tree.leaf
    bounds = tree.radii.copy()
    ancestor, descendant = tree.parents[leaf], np.flatnonzero(leaf)
    while (has_parent := ancestor >= 0).any():
        ancestor, descendant = ancestor[has_parent], descendant[has_parent]
        reach = np.linalg.norm(tree.centers[descendant] - tree.centers[ancestor], axis=1) + tree.radii[descendant]
        np.maximum.at(bounds, ancestor, reach)
        ancestor = tree.parents[ancestor]
    children = np.full((count, 8), -1, np.int32)
    children[leaf, 0] = np.flatnonzero(leaf)
    n_children = np.zeros(count, int)
    for node in range(1, count):
        parent = tree.parents[node]
        children[parent, n_children[parent]] = node
        n_children[parent] += 1
    ball_index = np.where(leaf, np.cumsum(leaf) - 1, -1).astype(np.int32)
    level, start = _start(tree)
    steps = int(tree.level.max()) - level
    return Nodes(
        _balls(tree.centers, bounds), jnp.asarray(children.T), jnp.asarray(ball_index), jnp.asarray(start), steps
    )


def _start(tree: Octree) -> tuple[int, np.ndarray]:
    """Find the first level with enough nodes, and return it with its nodes and the leaves above it."""
    leaf, last = tree.leaf, int(tree.level.max())
    for level in range(last + 1):
        nodes = (tree.level == level) | (leaf & (tree.level < level))
        if nodes.sum() >= START or level == last:
            break
    return level, np.flatnonzero(nodes).astype(np.int32)
