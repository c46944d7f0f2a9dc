"""Solid as a tree of spheres, and the search of it for the balls that the spheres of a hand meet.

The tree is descended level by level with a frontier of pairs, a sphere of the hand and a node whose bounding sphere it
meets; the node's children are tried next. The frontier has a fixed capacity. Where more pairs are met than it
holds, a larger one is taken, and at last every ball is tried, so that no contact is missed.

Arrays are batch-first here, and poses are worked on one after another: balls times spheres of many poses would
outgrow the cache.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.hand.shapes import Proximity, Shape, Size
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.vec3 import Vec3

Tree = TypeVar("Tree")

CAPACITIES = (8, 20, 48)
"""Pairs that a frontier holds for each sphere of the hand: each is tried where the one before does not hold all, and
then every ball. Few spheres touch, so that those which do find room for many."""
FAR = 1e3
"""Distance of a sphere that meets nothing [m]: finite, since it is multiplied by a weight of zero."""


class Balls(eqx.Module):
    """Balls in a solid's frame; in a batch with a leading axis of poses, of size 1 where the poses share them.

    Coordinates are separate arrays: three gathers of numbers are faster than one of rows.
    """

    x: Float[AnyArray, "*batch K"]
    """Coordinates x of the centres [m]; ``y`` and ``z`` likewise."""
    y: Float[AnyArray, "*batch K"]
    z: Float[AnyArray, "*batch K"]
    radii: Float[AnyArray, "*batch K"]
    """[m]"""

    @property
    def centers(self) -> Float[Array, "*batch K 3"]:
        """[m]"""
        return jnp.stack([self.x, self.y, self.z], -1)

    def gather(self, index: Array) -> tuple[Vec3, Array]:
        """Return the centres and radii of the balls at these indices."""
        return Vec3(*(jnp.asarray(c)[index] for c in (self.x, self.y, self.z))), jnp.asarray(self.radii)[index]


class Nodes(eqx.Module):
    """The tree of bounding spheres above the balls; in a batch with a leading axis of poses, as the balls."""

    bounds: Balls
    """Sphere of each node, the root first: it bounds all balls below the node; a leaf's is its own ball."""
    children: Int[AnyArray, "*batch 8 N"]
    """Places among the nodes; -1 where there is none. A leaf's first child is itself."""
    leaf: Int[AnyArray, "*batch N"]
    """A leaf's place among the balls; -1 for other nodes."""
    start: Int[AnyArray, "*batch S"]
    """The nodes with which the descent starts."""
    steps: int = eqx.field(static=True)
    """Levels below the start."""


class Pairs(NamedTuple):
    """Spheres of a hand and what they meet, for one pose."""

    sphere: Array
    """``(P,)``; one beyond the last where there is no pair."""
    node: Array
    """``(P,)``, or ball; -1 where there is no pair."""


class ProximityQuery(NamedTuple):
    """Distance and direction out of the balls for each sphere of a hand, for each pose."""

    distance: Array
    """``(B, H)``: from the sphere's centre to the nearest ball; of those met, where only they were tried [m]."""
    out: Array
    """``(B, H, 3)``: unit mean of the ways out of the balls that the sphere overlaps."""
    tests: Array
    """``(B,)``: spheres tried against spheres."""


def try_all(balls: Balls, centers: Array, radii: Array) -> ProximityQuery:
    """Test every ball against every sphere ``(B, H)`` of a hand; all poses share the radii ``(H,)``."""
    return _map_poses(lambda pose_centers, balls: _try_all(balls, pose_centers, radii), balls, centers)


def descend(balls: Balls, nodes: Nodes, centers: Array, radii: Array) -> ProximityQuery:
    """Compute the result of [`try_all`][] from the balls alone that a sphere can meet, by descent of the tree."""

    def of_pose(pose_centers: Array, tree: tuple[Balls, Nodes]) -> ProximityQuery:
        return _descend(*tree, pose_centers, radii, tuple(capacity * radii.size for capacity in CAPACITIES))

    return _map_poses(of_pose, (balls, nodes), centers)


def _map_poses(function: Callable[[Array, Tree], ProximityQuery], tree: Tree, poses: Array) -> ProximityQuery:
    """Map ``function`` over the poses and the trees, or over the poses alone where they share one tree."""
    function = jax.checkpoint(function)
    if all(x.shape[0] == 1 for x in jax.tree.leaves(tree)):
        shared_tree = jax.tree.map(lambda x: x[0], tree)
        return lax.map(lambda pose: function(pose, shared_tree), poses)
    return lax.map(lambda pair: function(*pair), (poses, tree))


def _try_all(balls: Balls, centers: Array, radii: Array) -> ProximityQuery:
    """Test every ball against every sphere ``(H, 3)`` of one pose."""
    all_balls, sizes = Vec3(*map(jnp.asarray, (balls.x, balls.y, balls.z))), jnp.asarray(balls.radii)

    @jax.checkpoint
    def of_sphere(sphere: tuple[Array, Array]) -> tuple[Array, Array]:
        center, radius = sphere
        gap, weighted = _overlaps(Vec3(*center), radius, all_balls, sizes)
        return jnp.min(gap), jnp.stack(vec3.unit(Vec3(*map(jnp.sum, weighted))))

    distance, out = lax.map(of_sphere, (centers, radii))
    return ProximityQuery(distance, out, jnp.int32(radii.size * balls.radii.size))


def _descend(balls: Balls, nodes: Nodes, centers: Array, radii: Array, capacities: tuple[int, ...]) -> ProximityQuery:
    """Descend the tree for one pose, with a frontier of the first of these sizes that holds all pairs."""
    if not capacities:
        return _try_all(balls, centers, radii)
    pairs, overflows = _frontier(*lax.stop_gradient((nodes, centers, radii)), capacities[0])
    n_tests = radii.size * nodes.start.size + (8 * nodes.steps + 1) * capacities[0]

    def query_pairs(_: None) -> ProximityQuery:
        return ProximityQuery(*_query_pairs(balls, centers, radii, pairs), jnp.int32(0))

    def query_larger(_: None) -> ProximityQuery:
        return _descend(balls, nodes, centers, radii, capacities[1:])

    query = lax.cond(overflows, query_larger, query_pairs, None)
    return query._replace(tests=query.tests + n_tests)


def _query_pairs(balls: Balls, centers: Array, radii: Array, pairs: Pairs) -> tuple[Array, Array]:
    """Compute each sphere's distance and direction out, from the balls in its pairs."""
    count = radii.shape[0]
    # Pairs of no node are counted for a sphere beyond the last, which is then left out.
    index = jnp.minimum(pairs.sphere, count - 1)
    gap, weighted = _overlaps(_columns(centers, index), radii[index], *balls.gather(pairs.node))
    least_gap = jnp.full(count + 1, FAR, gap.dtype).at[pairs.sphere].min(lax.stop_gradient(gap))
    nearest = (gap == least_gap[pairs.sphere]).astype(gap.dtype)
    ties, total, *out = (
        jnp.zeros(count + 1, gap.dtype).at[pairs.sphere].add(part)[:-1] for part in (nearest, nearest * gap, *weighted)
    )
    return jnp.where(ties > 0, vec3.safe_divide(total, ties), FAR), jnp.stack(vec3.unit(Vec3(*out)), -1)


def _overlaps(centers: Vec3, radii: Array, balls: Vec3, ball_radii: Array) -> tuple[Array, Vec3]:
    """Compute the distances of spheres' centres from balls, and the directions out of the balls that they overlap.

    The directions are weighted by the square of the overlap, so that their mean does not jump where the nearest ball
    changes.
    """
    offset = vec3.sub(centers, balls)
    length = vec3.norm(offset)
    gap = length - ball_radii
    overlap = jnp.maximum(radii - gap, 0)
    return gap, vec3.scale(vec3.safe_divide(overlap * overlap, length), offset)


def _columns(vectors: Array, index: Array) -> Vec3:
    """Gather rows of vectors ``(N, 3)`` as separate components."""
    return Vec3(*(vectors[:, i][index] for i in range(3)))


def _frontier(nodes: Nodes, centers: Array, radii: Array, capacity: int) -> tuple[Pairs, Array]:
    """Find the pairs of spheres and balls that meet, and tell whether some pairs did not fit."""
    count = radii.shape[0]
    sphere = jnp.arange(count, dtype=jnp.int32)
    nodes_to_test = jnp.broadcast_to(nodes.start[:, None], (nodes.start.shape[0], count))
    pairs, overflows = _meeting_pairs(nodes, centers, radii, sphere, nodes_to_test, capacity)
    for _ in range(nodes.steps):
        children = jnp.where(pairs.node >= 0, nodes.children[:, pairs.node], -1)
        pairs, level_overflows = _meeting_pairs(nodes, centers, radii, pairs.sphere, children, capacity)
        overflows = overflows | level_overflows
    return Pairs(pairs.sphere, nodes.leaf[pairs.node]), overflows


def _meeting_pairs(
    nodes: Nodes, centers: Array, radii: Array, sphere: Array, nodes_to_test: Array, capacity: int
) -> tuple[Pairs, Array]:
    """Gather the nodes ``(k, P)`` that meet their spheres ``(P,)``, and tell whether some pairs did not fit."""
    index = jnp.minimum(sphere, radii.shape[0] - 1)
    middles, sizes = nodes.bounds.gather(nodes_to_test)
    offset = vec3.sub(_columns(centers, index), middles)
    reach = radii[index] + sizes
    meets = (nodes_to_test >= 0) & (radii[index] > 0) & (vec3.dot(offset, offset) < reach * reach)
    # Places count through the nodes of a sphere first: short sums over those, and one long sum over the spheres.
    count, ranks = jnp.zeros(sphere.shape, jnp.int32), []
    for row in meets:
        ranks.append(count)
        count = count + row
    total = jnp.cumsum(count, dtype=jnp.int32)
    slot = jnp.where(meets, total - count + jnp.stack(ranks), capacity)
    gathered = Pairs(
        jnp.full(capacity, radii.shape[0], jnp.int32)
        .at[slot]
        .set(jnp.broadcast_to(sphere, nodes_to_test.shape), mode="drop"),
        jnp.full(capacity, -1, jnp.int32).at[slot].set(nodes_to_test, mode="drop"),
    )
    return gathered, total[-1] > capacity


class SphereTree(Shape):
    """A solid by balls inside it, the same for all poses; from [`jaxgrasp.hand.sphere_tree`][]."""

    balls: Balls
    nodes: Nodes
    moments: Float[AnyArray, "*batch 3"]
    """Principal moments of inertia by unit of mass [m^2]; NaN where the frame is not the principal one."""
    descends: bool = eqx.field(static=True)
    """True where contacts are found by descent, False where all balls are tried."""

    def scaled(self, factor: float) -> "SphereTree":
        """Return the tree of the same solid with all lengths multiplied by a factor."""
        balls, bounds = (jax.tree.map(lambda x: factor * x, part) for part in (self.balls, self.nodes.bounds))
        nodes = eqx.tree_at(lambda nodes: nodes.bounds, self.nodes, bounds)
        return SphereTree(balls, nodes, factor**2 * self.moments, self.descends)

    @property
    def _sizes(self) -> dict[str, Size]:
        return {}

    @property
    def _batch(self) -> tuple[int, ...]:
        return ()

    def _flat(self, batch: tuple[int, ...]) -> "SphereTree":
        return jax.tree.map(lambda x: jnp.asarray(x)[None], self)

    def _distance(self, point: Vec3) -> tuple[Array, Vec3]:
        """Compute the distance from the nearest of all balls, and the direction out of it."""
        centers, radii = self.balls.centers, jnp.asarray(self.balls.radii)

        def of_one(point_row: Array) -> tuple[Array, Array]:
            offset = point_row - centers
            length = jnp.sqrt(jnp.sum(offset * offset, -1))
            nearest = jnp.argmin(length - radii)
            shortest = Vec3(*offset[nearest])
            return vec3.norm(shortest) - radii[nearest], jnp.stack(vec3.unit(shortest))

        distance, out = lax.map(of_one, jnp.stack(point, -1).reshape(-1, 3))
        shape = jnp.shape(point.x)
        return distance.reshape(shape), Vec3(*(out[:, i].reshape(shape) for i in range(3)))

    def _bound(self, point: Vec3) -> Array:
        bounds = self.nodes.bounds
        root = Vec3(*(jnp.asarray(c)[:, 0] for c in (bounds.x, bounds.y, bounds.z)))
        return vec3.norm(vec3.sub(point, root)) - bounds.radii[:, 0]

    def _near(self, centers: Vec3, radii: Array) -> Proximity:
        shape = centers.x.shape
        points = jnp.moveaxis(jnp.stack(centers, -1).reshape(-1, shape[-1], 3), 0, 1)
        sizes = jnp.broadcast_to(radii, (*shape[:-1], 1)).ravel()
        query_balls = partial(descend, self.balls, self.nodes) if self.descends else partial(try_all, self.balls)
        query = query_balls(points, sizes)
        out = Vec3(*(query.out[..., i].T.reshape(shape) for i in range(3)))
        return Proximity(query.distance.T.reshape(shape), out, query.tests)

    def _support(self, direction: Vec3) -> Array:
        along = jnp.stack(direction, -1) @ self.balls.centers.T
        return jnp.max(along + self.balls.radii * vec3.norm(direction)[..., None], -1)

    def _moments(self) -> tuple[Array, Array, Array]:
        x, y, z = jnp.asarray(self.moments)
        return x, y, z
