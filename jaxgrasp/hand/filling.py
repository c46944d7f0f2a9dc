"""Sphere trees of solids: filling with balls and their stacking into a tree, once, in NumPy."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.hand.descent import Balls, Nodes
from jaxgrasp.hand.mesh import Mesh, MeshSurface, NearestPoints, check_mesh, mass_properties, sample_surface
from jaxgrasp.hand.octree import Octree, octree_balls
from jaxgrasp.hand.shapes import Shape, check_shape, signed_distance
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.validation.checked import checked

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
