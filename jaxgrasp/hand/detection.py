"""Contacts of a posed hand with an object: the links that touch, their points, normals and depths.

Every link is a row of spheres. A sphere that reaches into the object is an overlap. A link's contact is as deep as
the deepest of them; its point and normal are the means of all, each weighted by the square of its depth. So none of
the three jumps while a phalanx rolls and its spheres meet the surface and leave it again.

What a scene does not need is skipped: a sphere about all that the hand can reach is tried first, then, of the poses
whose sphere meets the object, one about each link, and only where one of these meets it the links' own spheres.

A fixed number of contacts: the deepest, and how many others were dropped.
"""

from dataclasses import fields
from functools import partial, reduce
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.custom_batching import custom_vmap
from jax.typing import DTypeLike

from jaxgrasp.hand.kinematics import (
    Bodies,
    ancestry,
    bodies_of,
    body,
    flatten_posture,
    joint_twists,
    place_bodies,
    vectors,
)
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import Batched, Float, Int
from jaxgrasp.model.hand import Hand, HandFrames, Pose, Posture
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.tiling import over_chosen, shared_or_spread, spread
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.validation.checked import checked

TILE = 32


class Contacts(Batched):
    """Contacts in the world, one for each link of the hand; an absent contact is all zero but for a unit normal."""

    last_axes: ClassVar[dict[str, int]] = {"points": 2, "normals": 2, "depths": 1, "present": 1, "tests": 0}

    points: Float[Array, "*batch L 3"]
    """On the object's surface [m]."""
    normals: Float[Array, "*batch L 3"]
    """Unit normals, into the object."""
    depths: Float[Array, "*batch L"]
    """Depth of the link in the object [m], 0 or more."""
    present: Float[Array, "*batch L"]
    """1 where the link touches; NaN where that cannot be told from the data."""
    tests: Int[Array, "*batch"]
    """Sphere tests done for this pose: 1 where the hand is out of reach; else one for each link too; and where one of
    the poses that are looked at together comes near the object, those of all its spheres."""


class _Scene(eqx.Module):
    """A flat batch; leaves of leading size 1 are shared by all poses."""

    posture: Posture
    shape: Shape
    placed: Pose

    @property
    def size(self) -> int:
        return self.posture.angles.shape[0]


@checked
@jax.jit
def find_contacts(hand: Hand, posture: Posture, shape: Shape, placed: Pose) -> Contacts:
    """Find the contacts of a posed hand with an object.

    Differentiable in posture, shape, placement and the hand's own measures; of what does not touch, with
    derivative zero.

    Args:
        hand: one for all poses.
        posture: with any leading axes.
        shape: sizes broadcast against the other leading axes.
        placed: where the object stands; leading axes likewise.

    Returns:
        A contact for each link ``(..., L)``, in the world, its normal into the object;
        [`jaxgrasp.hand.grasp_from_contacts`][] makes a Grasp of them.

    Raises:
        ValueError: for shapes of arrays that do not fit.
    """
    floats = [jnp.asarray(leaf) for leaf in jax.tree.leaves((hand, posture, shape, placed))]
    dtype = jnp.result_type(*(leaf for leaf in floats if jnp.issubdtype(leaf.dtype, jnp.floating)))
    posture, placed = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), (posture, placed))
    flat, batch = flatten_posture(hand, posture)
    origin, rotation = jnp.asarray(placed.origin), jnp.asarray(placed.rotation)
    full_batch = jnp.broadcast_shapes(batch, origin.shape[:-1], rotation.shape[:-2], shape._batch)

    def respread(array: Array) -> Array:
        tail = array.shape[1:]
        return spread(full_batch, array.reshape(*batch, *tail), tail)

    scene = _Scene(
        jax.tree.map(respread, flat),
        shape._flat(full_batch),
        Pose(shared_or_spread(full_batch, origin, (3,)), shared_or_spread(full_batch, rotation, (3, 3))),
    )
    contacts = _detect(hand, scene)
    return jax.tree.map(lambda x: x.reshape(*full_batch, *x.shape[1:]), contacts)


@jax.custom_jvp
def _detect(hand: Hand, scene: _Scene) -> Contacts:
    return _detect_in_reach(hand, scene)


@_detect.defjvp
def _detect_jvp(primals, tangents):
    """Differentiate all poses at once: a loop over gathered poses has no reverse mode."""

    def differentiable_fields(hand: Hand, scene: _Scene) -> dict[str, Array]:
        contacts = _test_all_spheres(hand, scene)
        return {name: getattr(contacts, name) for name in DIFFERENTIABLE}

    contacts = _detect(*primals)
    _, tangent = jax.jvp(differentiable_fields, primals, tangents)
    constant = {"present": jnp.zeros_like(contacts.present), "tests": np.zeros(contacts.tests.shape, jax.dtypes.float0)}
    leaves = [(tangent | constant)[field.name] for field in fields(Contacts)]
    return contacts, jax.tree.unflatten(jax.tree.structure(contacts), leaves)


DIFFERENTIABLE = ("points", "normals", "depths")


@custom_vmap
def _detect_in_reach(hand: Hand, scene: _Scene) -> Contacts:
    """Find the contacts of the poses that have the object within reach, and skip the others."""
    absent = _absent_contacts(hand, scene.size, scene.posture.angles.dtype)
    detect = lambda scene, _: _test_links_first(hand, scene)  # noqa: E731
    return over_chosen(detect, scene, absent, _within_reach(hand, scene), TILE)


@_detect_in_reach.def_vmap
def _detect_in_reach_vmap(axis_size: int, in_batched, hand: Hand, scene: _Scene):
    hands, scenes = in_batched
    if any(jax.tree.leaves(hands)):
        axes = jax.tree.map(lambda batched: 0 if batched else None, (hands, scenes))
        contacts = jax.vmap(_test_all_spheres, in_axes=axes, axis_size=axis_size)(hand, scene)
    else:
        size = scene.posture.angles.shape[1 if scenes.posture.angles else 0]
        # What all poses share stays shared, be it one pose by each lane: a tree of spheres is large.
        flat = _Scene(
            jax.tree.map(partial(_merge_axis, axis_size, size, False), scene.posture, scenes.posture),
            *(
                jax.tree.map(partial(_merge_axis, axis_size, size, True), leaves, batched)
                for leaves, batched in ((scene.shape, scenes.shape), (scene.placed, scenes.placed))
            ),
        )
        contacts = jax.tree.map(lambda x: x.reshape(axis_size, size, *x.shape[1:]), _detect_in_reach(hand, flat))
    return contacts, jax.tree.map(lambda _: True, contacts)


def _merge_axis(axis_size: int, size: int, shared: bool, array: Array, batched: bool) -> Array:
    """Merge the mapped axis of one leaf into the batch; a leaf that may be shared stays shared."""
    if shared and not batched and array.shape[0] == 1:
        return array
    mapped = array if batched else array[None]
    return jnp.broadcast_to(mapped, (axis_size, size, *mapped.shape[2:])).reshape(-1, *mapped.shape[2:])


def _within_reach(hand: Hand, scene: _Scene) -> Array:
    """Tell, for each pose, whether the object meets the sphere about all points in reach at any hinge angles."""
    first = np.flatnonzero(np.array(hand.parents, int) < 0)
    middle = jnp.mean(hand.origins[first] if len(first) else hand.skin.centers.reshape(-1, 3), 0)
    bone_lengths = (
        jnp.linalg.norm(hand.origins, axis=-1).at[first].set(jnp.linalg.norm(hand.origins[first] - middle, axis=-1))
    )
    carriers = np.array([link.joint for link in hand.links])
    centers = hand.skin.centers - jnp.where((carriers < 0)[:, None, None], middle, 0)
    sphere_reach = jnp.max(jnp.linalg.norm(centers, axis=-1) + hand.skin.radii, -1)
    # What slides reaches as far as it was moved.
    travel = jnp.sum(jnp.abs(scene.posture.angles[:, hand.slides]), -1)
    reach = jnp.max(ancestry(hand).astype(float) @ bone_lengths + sphere_reach) + travel
    center = scene.posture.wrist.origin + scene.posture.wrist.rotation @ middle
    local_center = jnp.einsum("bji,bj->bi", scene.placed.rotation, center - scene.placed.origin)
    # A NaN goes on to the closer look, which shows it.
    return ~(scene.shape._bound(Vec3(*local_center.T)) > reach)


def _absent_contacts(hand: Hand, size: int, dtype: DTypeLike) -> Contacts:
    """Return contacts of ``size`` poses that are all absent, at the cost of one test for each pose."""
    zero = jnp.zeros((size, len(hand.links), 3), dtype)
    return Contacts(zero, zero.at[..., 0].set(1), zero[..., 0], zero[..., 0], jnp.ones(size, jnp.int32))


def _test_links_first(hand: Hand, scene: _Scene) -> Contacts:
    """Test each link as one ball first, and all spheres only where a link of one of these poses comes near."""
    links = _to_frame(body(scene.placed), place_bodies(hand, scene.posture).links)
    contacts = lax.cond(
        _any_near(hand, scene.shape, links),
        lambda: _link_contacts(hand, scene.shape, scene.placed, links),
        lambda: _absent_contacts(hand, scene.size, scene.posture.angles.dtype),
    )
    return _with_link_tests(contacts, hand)


def _any_near(hand: Hand, shape: Shape, links: Bodies) -> Array:
    """Tell whether any link, as one ball, meets the object, from the links' frames in its coordinates."""
    leaves, radii = hand.skin.centers, hand.skin.radii
    size = jnp.maximum(jnp.sum(radii > 0, -1, keepdims=True), 1)
    middle = jnp.sum(leaves * (radii > 0)[..., None], 1) / size
    reach = jnp.max(jnp.where(radii > 0, jnp.linalg.norm(leaves - middle[:, None], axis=-1) + radii, 0), -1)
    center = vec3.add(links.origin, vec3.rotate_back(links.axes, Vec3(*(middle[:, i, None] for i in range(3)))))
    # A NaN goes on to the closer look, which shows it.
    return jnp.any(~(shape._bound(center) > reach[:, None]))


def _with_link_tests(contacts: Contacts, hand: Hand) -> Contacts:
    """Count the test of each link as one ball."""
    return eqx.tree_at(lambda c: c.tests, contacts, contacts.tests + len(hand.links))


def _test_all_spheres(hand: Hand, scene: _Scene) -> Contacts:
    """Test every sphere of the hand against the object."""
    links = _to_frame(body(scene.placed), place_bodies(hand, scene.posture).links)
    return _link_contacts(hand, scene.shape, scene.placed, links)


def _link_contacts(hand: Hand, shape: Shape, placed: Pose, links: Bodies) -> Contacts:
    """Compute the contacts of links from their frames in the object's coordinates."""
    object_ = body(placed)
    centers = _sphere_centers(hand, links)
    radii = jnp.asarray(hand.skin.radii)[..., None]
    proximity = shape._near(centers, radii)
    depth = jnp.where(radii > 0, jnp.maximum(radii - proximity.distance, 0), 0)
    merged = _merge_overlaps(depth, vec3.sub(centers, vec3.scale(proximity.distance, proximity.out)), proximity.out)
    point = vec3.add(object_.origin, vec3.rotate_back(object_.axes, merged.point))
    normal = vec3.rotate_back(object_.axes, merged.normal)
    touching = merged.depth > 0
    # Norms take a NaN for zero; the frames themselves show it.
    is_finite = jnp.isfinite(reduce(jnp.add, jax.tree.leaves(links)) + merged.depth)
    size = merged.depth.shape[-1]
    return Contacts(
        points=vectors(Vec3(*(jnp.where(touching, c, 0) for c in point)), (size,)),
        normals=vectors(Vec3(*(jnp.where(touching, c, i == 0) for i, c in enumerate(normal))), (size,)),
        depths=jnp.where(is_finite, merged.depth, jnp.nan).T,
        present=jnp.where(is_finite, touching.astype(merged.depth.dtype), jnp.nan).T,
        tests=1 + proximity.tests,
    )


class ContactGeometry(NamedTuple):
    """Points, normals and depths of contacts ``(..., L)``; or their derivatives by the joint angles, which are a first
    axis."""

    points: Float[Array, "*batch L 3"]
    normals: Float[Array, "*batch L 3"]
    depths: Float[Array, "*batch L"]


def contacts_and_rates(hand: Hand, frames: HandFrames, shape: Shape, placed: Pose) -> tuple[Contacts, ContactGeometry]:
    """Find contacts as ``find_contacts`` does, and their derivatives ``(J, ..., L, 3)`` by the joint angles.

    The contact of a link depends on the frame of that link alone: its derivatives by the link's twist are six, for all
    links at once, however many joints there are.

    Args:
        hand: tree of joints and links.
        frames: frames of one posed hand.
        shape: object; its sizes may have leading axes.
        placed: pose of the object; leading axes likewise.
    """
    origin, rotation = jnp.asarray(placed.origin), jnp.asarray(placed.rotation)
    batch = jnp.broadcast_shapes(origin.shape[:-1], rotation.shape[:-2], shape._batch)
    flat_shape, flat = shape._flat(batch), Pose(spread(batch, origin, (3,)), spread(batch, rotation, (3, 3)))
    in_object, links = body(flat), bodies_of(frames.links)
    dtype = links.origin.x.dtype

    def displaced(twist: Array) -> tuple[ContactGeometry, Contacts]:
        # o + v + w x o, a + w x a
        linear, angular = Vec3(*twist[:3]), Vec3(*twist[3:])
        x, y, z = (vec3.add(axis, vec3.cross(angular, axis)) for axis in links.axes)
        origin = vec3.add(links.origin, vec3.add(linear, vec3.cross(angular, links.origin)))
        contacts = _link_contacts(hand, flat_shape, flat, _to_frame(in_object, Bodies(origin, (x, y, z))))
        return ContactGeometry(contacts.points, contacts.normals, contacts.depths), contacts

    def far() -> tuple[ContactGeometry, Contacts]:
        contacts = _absent_contacts(hand, flat.origin.shape[0], dtype)
        by_none = jnp.zeros((*contacts.points.shape, 6), dtype)
        return ContactGeometry(by_none, by_none, by_none[..., 0, :]), contacts

    by_twist, contacts = lax.cond(
        _any_near(hand, flat_shape, _to_frame(in_object, links)),
        lambda: jax.jacfwd(displaced, has_aux=True)(jnp.zeros(6, dtype)),
        far,
    )
    # dc/dq_j = (dc/dtwist) t_j for every joint j that moves the link
    twists, moves = joint_twists(hand, frames), ancestry(hand).astype(float)
    by_angle = jax.tree.map(lambda rows: jnp.einsum("bl...t,jt,lj->jbl...", rows, twists, moves), by_twist)
    counted = _with_link_tests(contacts, hand)
    unflat = jax.tree.map(lambda x: x.reshape(*batch, *x.shape[1:]), counted)
    return unflat, jax.tree.map(lambda x: x.reshape(len(x), *batch, *x.shape[2:]), by_angle)


def _to_frame(frame: Bodies, bodies: Bodies) -> Bodies:
    """Transform bodies into the coordinates of a frame."""
    x, y, z = (vec3.rotate(frame.axes, axis) for axis in bodies.axes)
    return Bodies(vec3.rotate(frame.axes, vec3.sub(bodies.origin, frame.origin)), (x, y, z))


def _sphere_centers(hand: Hand, links: Bodies) -> Vec3:
    """Compute the centres of all spheres, ``(L, m, B)``."""
    local = Vec3(*(jnp.asarray(hand.skin.centers)[..., i, None] for i in range(3)))
    beside = jax.tree.map(lambda c: c[:, None], links)
    return vec3.add(beside.origin, vec3.rotate_back(beside.axes, local))


class _Merged(NamedTuple):
    point: Vec3
    normal: Vec3
    depth: Array


def _merge_overlaps(depth: Array, points: Vec3, out: Vec3) -> _Merged:
    """Merge the overlaps ``(L, m, B)`` of each link into one contact."""
    # By its index: a comparison with the maximum may fail where XLA computes the depth once more, with other rounding.
    index = lax.broadcasted_iota(jnp.int32, depth.shape, 1)
    is_deepest = index == jnp.argmax(depth, 1).astype(jnp.int32)[:, None]
    deepest = jnp.sum(jnp.where(is_deepest, depth, 0), 1)
    # Means weighted by depth^2, in units of the deepest, whose square may underflow
    unit = lax.stop_gradient(jnp.where(deepest > 0, deepest, 1))[:, None]
    weight = (depth / unit) ** 2
    total = jnp.sum(weight, 1)

    def mean(array: Array) -> Array:
        return vec3.safe_divide(jnp.sum(weight * array, 1), total)

    normal = Vec3(*(-mean(c) for c in out))
    length = vec3.norm(normal)
    return _Merged(
        point=Vec3(*map(mean, points)),
        normal=Vec3(*(vec3.safe_divide(c, length) for c in normal)),
        depth=deepest,
    )


class DeepestContacts(NamedTuple):
    """The contacts that were kept, deepest first, any leading axes."""

    contacts: Contacts
    links: Array
    """``(..., size)``: the link of each."""
    dropped: Array
    """``(...)``: present contacts for which there was no place."""


@checked
def keep_deepest(contacts: Contacts, size: int) -> DeepestContacts:
    """Keep the ``size`` deepest contacts of each pose, and count the others.

    Args:
        contacts: ``(..., L)``.
        size: of the last axis of what is kept; more than ``L`` is as ``L``.

    Raises:
        ValueError: for a size below 1.
    """
    if size < 1:
        raise ValueError(f"size is {size}: expected at least one contact")
    links = contacts.depths.shape[-1]
    # A NaN sorts before all else: bad data must not be dropped unseen.
    order = jnp.where(jnp.isnan(contacts.present), jnp.inf, jnp.where(contacts.present > 0, contacts.depths, -1.0))
    _, chosen = lax.top_k(order, min(size, links))

    def select(array: Array) -> Array:
        index = chosen if array.ndim == chosen.ndim else chosen[..., None]
        return jnp.take_along_axis(array, index, chosen.ndim - 1)

    selected = {name: select(getattr(contacts, name)) for name in ("points", "normals", "depths", "present")}
    n_present = jnp.sum(contacts.present > 0, -1)
    dropped = n_present - jnp.sum(selected["present"] > 0, -1)
    return DeepestContacts(Contacts(**selected, tests=contacts.tests), chosen, dropped)
