"""What a hand exerts on every object that it touches, by the package's own laws, and what its joints feel of it all."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.distribution import closed_form_and_optimum
from jaxgrasp.force.reachable import reachable_wrench
from jaxgrasp.grip.monitor import Assessment, Hold, Law, judged
from jaxgrasp.grip.motion import guide_at, spatial_inertia
from jaxgrasp.grip.obstacles import hand_torques
from jaxgrasp.grip.slipping import Exerted, cut_to_cones
from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.to_grasp import grasp_about
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.world.many_bodies import World


class ThingTouches(eqx.Module):
    """Where a hand touches each of N objects."""

    contacts: Contacts
    """``(N, L)``: of the hand's links with each object."""
    grasp: Grasp
    """``(N, L)``: about each object's centre, along the world's axes."""
    stiffness: Float[Array, "N L"]
    """Effective stiffness of each contact, c K of eq. 6 [N/m]; 0 where nothing touches."""


class HandShare(eqx.Module):
    """What a hand exerts on each of N objects at one instant."""

    touches: ThingTouches
    wrench: Float[Array, "N 6"]
    """What the hand is to exert on each object about its centre [N, N.m]: what gives it its motion, less its weight and
    what the others exert."""
    assessment: Assessment
    exerted: Float[Array, "N L 3"]
    """What it exerts [N]: the law's forces where they hold; of an object that slips by the closed form, each as far as
    its friction goes, by the optimum those that come closest; none on what it does not touch."""
    moments: Float[Array, "N L"] | None
    """What soft fingers exert about their normals with that [N.m]; None where all contacts are hard."""
    missed: Float[Array, "N 6"]
    """What the hand leaves of the wrench of objects that slip [N, N.m]."""
    torques: Float[Array, "J"]
    """On the joints, by objects, table and obstacles [N.m]: negative where they resist a positive angle."""
    blocked: Float[Array, "J"]
    """What of them is by table and obstacles, where the hand itself touches them [N.m]."""

    @property
    def by_hand(self) -> Exerted:
        """Forces and moments of the hand on each object."""
        return Exerted(self.exerted, self.moments)


@jax.jit
def touched_things(world: World, posture: Posture, placed: Pose) -> ThingTouches:
    """Contacts of the hand with each object ``(N,)``, and their Grasps."""
    things, hand = world.things, world.scene.hand
    contacts = _contacts(hand, posture, [thing.body.shape for thing in things], placed)
    friction, stiffness = (
        jnp.stack([jnp.asarray(getattr(thing, name), contacts.depths.dtype) for thing in things])[:, None]
        for name in ("friction", "stiffness")
    )
    contributions = jnp.asarray(world.scene.contributions)
    torsion = None
    if world.is_soft:
        own = [0.0 if thing.torsion is None else thing.torsion for thing in things]
        torsion = jnp.stack([jnp.asarray(each, contacts.depths.dtype) for each in own])[:, None]
    grasp = grasp_about(placed.origin, contacts, friction, stiffness, contributions, torsion)
    return ThingTouches(contacts, grasp, contacts.present * stiffness * contributions)


def _contacts(hand: Hand, posture: Posture, shapes: list[Shape], placed: Pose) -> Contacts:
    """One search for all exact shapes of a kind; a tree has its own."""
    kinds: dict[object, list[int]] = {}
    for n, shape in enumerate(shapes):
        kinds.setdefault(n if isinstance(shape, SphereTree) else type(shape), []).append(n)
    found, order = [], []
    for members in kinds.values():
        first = shapes[members[0]]
        alike = (
            first
            if isinstance(first, SphereTree)
            else jax.tree.map(lambda *sizes: jnp.stack(sizes), *(jax.tree.map(jnp.asarray, shapes[n]) for n in members))
        )
        index = np.array(members)
        there = Pose(jnp.asarray(placed.origin)[index], jnp.asarray(placed.rotation)[index])
        found.append(find_contacts(hand, posture, alike, there))
        order += members
    together = jax.tree.map(lambda *parts: jnp.concatenate(parts), *found)
    return jax.tree.map(lambda part: part[np.argsort(order)], together)


def hand_share(
    world: World,
    posture: Posture,
    placed: Pose,
    touches: ThingTouches,
    wrench: Float[AnyArray, "N 6"],
    *,
    law: Law,
) -> HandShare:
    """What the hand exerts on each object.

    Args:
        world: hand and objects.
        posture: of the hand.
        placed: where the objects are ``(N,)``.
        touches: of the hand there, from ``touched_things``.
        wrench: what the hand is to exert on each [N, N.m].
        law: which forces the hand applies, as for [`jaxgrasp.grip.monitor`][].
    """
    share = cut_share(world, posture, placed, touches, jnp.asarray(wrench), law=law)
    if law == "optimum" and bool(jnp.any(share.assessment.hold == Hold.SLIPPING)):
        return closest_share(world, posture, placed, share)
    return share


@partial(jax.jit, static_argnames="law")
def cut_share(
    world: World, posture: Posture, placed: Pose, touches: ThingTouches, wrench: Array, *, law: Law
) -> HandShare:
    """As ``hand_share``, but that what slips is cut to its friction by either law."""
    grasp = touches.grasp
    closed, optimum = closed_form_and_optimum(grasp, wrench, free=_free(world, placed))
    assessment = judged(grasp, closed, optimum, law)
    slips = assessment.hold == Hold.SLIPPING
    exerted = cut_to_cones(grasp, assessment.exerted).where(slips, assessment.exerted)
    return _felt(world, posture, touches, wrench, assessment, exerted, hand_torques(world.scene, posture))


@jax.jit
def closest_share(world: World, posture: Posture, placed: Pose, share: HandShare) -> HandShare:
    """The forces that come closest to what no allowed ones exert, by how what is missed moves the object."""
    inertia = jnp.stack([spatial_inertia(thing.body, placed.rotation[n]) for n, thing in enumerate(world.things)])
    touches = share.touches
    closest = reachable_wrench(touches.grasp, share.wrench, inertia=inertia, free=_free(world, placed))
    slips = share.assessment.hold == Hold.SLIPPING
    exerted = Exerted(closest.forces, closest.moments).where(slips, share.by_hand)
    return _felt(world, posture, touches, share.wrench, share.assessment, exerted, share.blocked)


def _felt(
    world: World,
    posture: Posture,
    touches: ThingTouches,
    wrench: Array,
    assessment: Assessment,
    exerted: Exerted,
    blocked: Array,
) -> HandShare:
    torques = pressing_torques(world, posture, touches, exerted) + blocked
    slips = (assessment.hold == Hold.SLIPPING)[:, None]
    missed = jnp.where(slips, wrench - exerted.wrench(touches.grasp), 0)
    return HandShare(touches, wrench, assessment, *exerted, missed, torques, blocked)


def pressing_torques(world: World, posture: Posture, touches: ThingTouches, exerted: Exerted) -> Array:
    """Torques on the joints by what the hand exerts on all objects [N.m]."""
    hand, couples = world.scene.hand, exerted.couples(touches.grasp)
    return jnp.sum(joint_torques(hand, pose_hand(hand, posture), touches.contacts.points, exerted.forces, couples), 0)


def _free(world: World, placed: Pose) -> Array | None:
    """Twists left to each object: of the gripped one those of its guide, of the others all."""
    guide = world.scene.guide
    if guide is None:
        return None
    own = guide_at(guide, placed.origin[0])
    every = jnp.broadcast_to(jnp.eye(6), (len(world.others), 6, 6))
    return jnp.concatenate([jnp.pad(own, ((0, 0), (0, 6 - own.shape[1])))[None], every])
