"""Search of a sphere tree for the balls that the spheres of a hand meet, with the direction out of them.

The tree is descended level by level with a frontier of pairs, a sphere of the hand and a node whose bounding sphere it
meets; the node's children are tried next. The frontier has a fixed capacity. Where more pairs are met than it
holds, a larger one is taken, and at last every ball is tried, so that no contact is missed.

Arrays are batch-first here, and poses are worked on one after another: balls times spheres of many poses would
outgrow the cache.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.vec3 import Vec3

Tree = TypeVar("Tree")

ROOMS = (8, 20, 48)
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

    def some(self, index: Array) -> tuple[Vec3, Array]:
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


class Seen(NamedTuple):
    """Distance and direction out of the balls for each sphere of a hand, for each pose."""

    distance: Array
    """``(B, H)``: from the sphere's centre to the nearest ball; of those met, where only they were tried [m]."""
    out: Array
    """``(B, H, 3)``: unit mean of the ways out of the balls that the sphere overlaps."""
    tests: Array
    """``(B,)``: spheres tried against spheres."""


def try_all(balls: Balls, centers: Array, radii: Array) -> Seen:
    """Test every ball against every sphere ``(B, H)`` of a hand; all poses share the radii ``(H,)``."""
    return _each(lambda own, balls: _try_all(balls, own, radii), balls, centers)


def descend(balls: Balls, nodes: Nodes, centers: Array, radii: Array) -> Seen:
    """Compute the result of [`try_all`][] from the balls alone that a sphere can meet, by descent of the tree."""

    def of_pose(own: Array, tree: tuple[Balls, Nodes]) -> Seen:
        return _descend(*tree, own, radii, tuple(room * radii.size for room in ROOMS))

    return _each(of_pose, (balls, nodes), centers)


def _each(function: Callable[[Array, Tree], Seen], tree: Tree, poses: Array) -> Seen:
    """Map ``function`` over the poses and the trees, or over the poses alone where they share one tree."""
    function = jax.checkpoint(function)
    if all(x.shape[0] == 1 for x in jax.tree.leaves(tree)):
        one = jax.tree.map(lambda x: x[0], tree)
        return lax.map(lambda own: function(own, one), poses)
    return lax.map(lambda pair: function(*pair), (poses, tree))


def _try_all(balls: Balls, centers: Array, radii: Array) -> Seen:
    """Test every ball against every sphere ``(H, 3)`` of one pose."""
    all_balls, sizes = Vec3(*map(jnp.asarray, (balls.x, balls.y, balls.z))), jnp.asarray(balls.radii)

    @jax.checkpoint
    def of_sphere(one: tuple[Array, Array]) -> tuple[Array, Array]:
        center, radius = one
        gap, weighted = _overlaps(Vec3(*center), radius, all_balls, sizes)
        return jnp.min(gap), jnp.stack(vec3.unit(Vec3(*map(jnp.sum, weighted))))

    distance, out = lax.map(of_sphere, (centers, radii))
    return Seen(distance, out, jnp.int32(radii.size * balls.radii.size))


def _descend(balls: Balls, nodes: Nodes, centers: Array, radii: Array, rooms: tuple[int, ...]) -> Seen:
    """Descend the tree for one pose, with a frontier of the first of these sizes that holds all pairs."""
    if not rooms:
        return _try_all(balls, centers, radii)
    pairs, missed = _frontier(*lax.stop_gradient((nodes, centers, radii)), rooms[0])
    tried = radii.size * nodes.start.size + (8 * nodes.steps + 1) * rooms[0]

    def found(_: None) -> Seen:
        return Seen(*_met(balls, centers, radii, pairs), jnp.int32(0))

    def fall_back(_: None) -> Seen:
        return _descend(balls, nodes, centers, radii, rooms[1:])

    seen = lax.cond(missed, fall_back, found, None)
    return seen._replace(tests=seen.tests + tried)


def _met(balls: Balls, centers: Array, radii: Array, pairs: Pairs) -> tuple[Array, Array]:
    """Compute each sphere's distance and direction out, from the balls in its pairs."""
    count = radii.shape[0]
    # Pairs of no node are counted for a sphere beyond the last, which is then left out.
    one = jnp.minimum(pairs.sphere, count - 1)
    gap, weighted = _overlaps(_columns(centers, one), radii[one], *balls.some(pairs.node))
    least = jnp.full(count + 1, FAR, gap.dtype).at[pairs.sphere].min(lax.stop_gradient(gap))
    nearest = (gap == least[pairs.sphere]).astype(gap.dtype)
    ties, total, *out = (
        jnp.zeros(count + 1, gap.dtype).at[pairs.sphere].add(part)[:-1] for part in (nearest, nearest * gap, *weighted)
    )
    return jnp.where(ties > 0, vec3.safe_divide(total, ties), FAR), jnp.stack(vec3.unit(Vec3(*out)), -1)


def _overlaps(centers: Vec3, radii: Array, balls: Vec3, ball_radii: Array) -> tuple[Array, Vec3]:
    """Compute the distances of spheres' centres from balls, and the directions out of the balls that they overlap.

    The directions are weighted by the square of the overlap, so that their mean does not jump where the nearest ball
    changes.
    """
    way = vec3.sub(centers, balls)
    length = vec3.norm(way)
    gap = length - ball_radii
    overlap = jnp.maximum(radii - gap, 0)
    return gap, vec3.scale(vec3.safe_divide(overlap * overlap, length), way)


def _columns(vectors: Array, index: Array) -> Vec3:
    """Gather rows of vectors ``(N, 3)`` as separate components."""
    return Vec3(*(vectors[:, i][index] for i in range(3)))


def _frontier(nodes: Nodes, centers: Array, radii: Array, room: int) -> tuple[Pairs, Array]:
    """Find the pairs of spheres and balls that meet, and tell whether some pairs did not fit."""
    count = radii.shape[0]
    sphere = jnp.arange(count, dtype=jnp.int32)
    tried = jnp.broadcast_to(nodes.start[:, None], (nodes.start.shape[0], count))
    pairs, missed = _kept(nodes, centers, radii, sphere, tried, room)
    for _ in range(nodes.steps):
        children = jnp.where(pairs.node >= 0, nodes.children[:, pairs.node], -1)
        pairs, more = _kept(nodes, centers, radii, pairs.sphere, children, room)
        missed = missed | more
    return Pairs(pairs.sphere, nodes.leaf[pairs.node]), missed


def _kept(nodes: Nodes, centers: Array, radii: Array, sphere: Array, tried: Array, room: int) -> tuple[Pairs, Array]:
    """Gather the nodes ``(k, P)`` that meet their spheres ``(P,)``, and tell whether some pairs did not fit."""
    own = jnp.minimum(sphere, radii.shape[0] - 1)
    middles, sizes = nodes.bounds.some(tried)
    way = vec3.sub(_columns(centers, own), middles)
    near = radii[own] + sizes
    met = (tried >= 0) & (radii[own] > 0) & (vec3.dot(way, way) < near * near)
    # Places count through the nodes of a sphere first: short sums over those, and one long sum over the spheres.
    count, ranks = jnp.zeros(sphere.shape, jnp.int32), []
    for row in met:
        ranks.append(count)
        count = count + row
    total = jnp.cumsum(count, dtype=jnp.int32)
    place = jnp.where(met, total - count + jnp.stack(ranks), room)
    gathered = Pairs(
        jnp.full(room, radii.shape[0], jnp.int32).at[place].set(jnp.broadcast_to(sphere, tried.shape), mode="drop"),
        jnp.full(room, -1, jnp.int32).at[place].set(tried, mode="drop"),
    )
    return gathered, total[-1] > room
