"""Forces of a hand on every object that it touches, by the package's own force laws, and the joint torques from
them."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.distribution import closed_form_and_optimum
from jaxgrasp.force.reachable import nearest_wrench
from jaxgrasp.grip.contact_forces import ContactForces, cut_to_cones
from jaxgrasp.grip.monitor import Assessment, Hold, Law, assess
from jaxgrasp.grip.motion import guide_at, spatial_inertia
from jaxgrasp.grip.obstacles import hand_torques
from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.to_grasp import grasp_about
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.world.many_bodies import World


class BodyTouches(eqx.Module):
    """Contacts of a hand with each of N objects, and the Grasps that they form."""

    contacts: Contacts
    """``(N, L)``: contacts of the hand's links with each object."""
    grasp: Grasp
    """``(N, L)``: Grasp about each object's centre, along the world's axes."""
    stiffness: Float[Array, "N L"]
    """Effective stiffness of each contact, c K of eq. 6 [N/m]; 0 without contact."""


class HandShare(eqx.Module):
    """Forces of a hand on each of N objects at one instant, and the joint torques from them."""

    touches: BodyTouches
    wrench: Float[Array, "N 6"]
    """Wrench required of the hand on each object about its centre [N, N.m]: rate of momentum, less weight and the loads
    by the other bodies."""
    assessment: Assessment
    exerted: Float[Array, "N L 3"]
    """Contact forces on the objects [N]: the law's forces where they hold. On a slipping object, by the closed form
    each force is cut to its friction, by the optimum the closest feasible forces act; zero without contact."""
    moments: Float[Array, "N L"] | None
    """Moments of soft fingers about their normals [N.m]; None where all contacts are hard."""
    wrench_residual: Float[Array, "N 6"]
    """Part of the wrench that the hand does not exert on slipping objects [N, N.m]; zero for all others."""
    torques: Float[Array, "J"]
    """Joint torques from objects, table and obstacles [N.m]: negative where they resist a positive angle."""
    blocked: Float[Array, "J"]
    """Part of the torques from table and obstacles that the hand itself touches [N.m]."""

    @property
    def by_hand(self) -> ContactForces:
        """Return forces and moments of the hand on each object."""
        return ContactForces(self.exerted, self.moments)


@jax.jit
def find_touches(world: World, posture: Posture, placed: Pose) -> BodyTouches:
    """Find the contacts of the hand with each object ``(N,)``, and build their Grasps."""
    groups = surface_groups(world, placed)
    found = [find_contacts(world.scene.hand, posture, group.shape, group.placed) for group in groups]
    return touches_of(world, placed, joined_contacts(groups, found))


class SurfaceGroup(NamedTuple):
    """Objects of a world whose contacts are found by one batched search: all exact shapes of a type, or one tree."""

    members: list[int]
    """Indices of the objects."""
    shape: Shape
    """Their shapes, with a leading axis; one tree of spheres without it."""
    placed: Pose
    """Their poses, with a leading axis."""


def surface_groups(world: World, placed: Pose) -> list[SurfaceGroup]:
    """Group the objects at their poses ``(N,)`` for the detection."""
    shapes = [member.body.shape for member in world.bodies]
    kinds: dict[object, list[int]] = {}
    for n, shape in enumerate(shapes):
        kinds.setdefault(n if isinstance(shape, SphereTree) else type(shape), []).append(n)
    groups = []
    for members in kinds.values():
        first, index = shapes[members[0]], np.array(members)
        if not isinstance(first, SphereTree):
            sizes = [jax.tree.map(jnp.asarray, shapes[n]) for n in members]
            first = jax.tree.map(lambda *values: jnp.stack(values), *sizes)
        poses = Pose(jnp.asarray(placed.origin)[index], jnp.asarray(placed.rotation)[index])
        groups.append(SurfaceGroup(members, first, poses))
    return groups


def joined_contacts(groups: list[SurfaceGroup], found: Sequence[Contacts]) -> Contacts:
    """Join the contacts with each group into those with all objects ``(N, L)``, in the world's order."""
    joined = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *found)
    order = np.argsort([n for group in groups for n in group.members])
    return jax.tree.map(lambda part: part[order], joined)


def touches_of(world: World, placed: Pose, contacts: Contacts) -> BodyTouches:
    """Build the touches from the contacts ``(N, L)`` with all objects at their poses."""
    members = world.bodies
    friction, stiffness = (
        jnp.stack([jnp.asarray(getattr(member, name), contacts.depths.dtype) for member in members])[:, None]
        for name in ("friction", "stiffness")
    )
    contributions = jnp.asarray(world.scene.contributions)
    torsion = None
    if world.is_soft:
        torsions = [0.0 if member.torsion is None else member.torsion for member in members]
        torsion = jnp.stack([jnp.asarray(value, contacts.depths.dtype) for value in torsions])[:, None]
    grasp = grasp_about(placed.origin, contacts, friction, stiffness, contributions, torsion)
    return BodyTouches(contacts, grasp, contacts.present * stiffness * contributions)


def hand_share(
    world: World,
    posture: Posture,
    placed: Pose,
    touches: BodyTouches,
    wrench: Float[AnyArray, "N 6"],
    *,
    law: Law,
) -> HandShare:
    """Compute the forces that the hand exerts on each object by a force law.

    Args:
        world: hand and objects.
        posture: posture of the hand.
        placed: poses of the objects ``(N,)``.
        touches: contacts of the hand at these poses, from ``find_touches``.
        wrench: wrench required of the hand on each object [N, N.m].
        law: force law of the hand, as for [`jaxgrasp.grip.monitor`][].
    """
    share = cut_share(world, posture, placed, touches, jnp.asarray(wrench), law=law)
    if law == "optimum" and bool(jnp.any(share.assessment.hold == Hold.SLIPPING)):
        return closest_share(world, posture, placed, share)
    return share


@partial(jax.jit, static_argnames="law")
def cut_share(
    world: World, posture: Posture, placed: Pose, touches: BodyTouches, wrench: Array, *, law: Law
) -> HandShare:
    """Compute as ``hand_share`` does, but cut the forces on a slipping object to its friction, whichever the law."""
    hand, blocked = world.scene.hand, hand_torques(world.scene, posture)
    return share_at(world, pose_hand(hand, posture), placed, touches, blocked, wrench, law=law)


def share_at(
    world: World, frames: HandFrames, placed: Pose, touches: BodyTouches, blocked: Array, wrench: Array, *, law: Law
) -> HandShare:
    """Compute as ``cut_share`` does, from the frames of the hand and its torques ``blocked`` by table and obstacles."""
    grasp = touches.grasp
    closed, optimum = closed_form_and_optimum(grasp, wrench, free=_free(world, placed))
    assessment = assess(grasp, closed, optimum, law)
    slips = assessment.hold == Hold.SLIPPING
    exerted = cut_to_cones(grasp, assessment.exerted).where(slips, assessment.exerted)
    return _complete_share(world, frames, touches, wrench, assessment, exerted, blocked)


@jax.jit
def closest_share(world: World, posture: Posture, placed: Pose, share: HandShare) -> HandShare:
    """Replace the forces on slipping objects by the feasible ones whose wrench residual moves the object least."""
    inertia = jnp.stack([spatial_inertia(member.body, placed.rotation[n]) for n, member in enumerate(world.bodies)])
    touches = share.touches
    closest = nearest_wrench(touches.grasp, share.wrench, inertia=inertia, free=_free(world, placed))
    slips = share.assessment.hold == Hold.SLIPPING
    exerted = ContactForces(closest.forces, closest.moments).where(slips, share.by_hand)
    frames = pose_hand(world.scene.hand, posture)
    return _complete_share(world, frames, touches, share.wrench, share.assessment, exerted, share.blocked)


def _complete_share(
    world: World,
    frames: HandFrames,
    touches: BodyTouches,
    wrench: Array,
    assessment: Assessment,
    exerted: ContactForces,
    blocked: Array,
) -> HandShare:
    """Add wrench residual and joint torques to the forces on all objects."""
    torques = pressing_torques(world, frames, touches, exerted) + blocked
    slips = (assessment.hold == Hold.SLIPPING)[:, None]
    # r = w - G f
    residual = jnp.where(slips, wrench - exerted.wrench(touches.grasp), 0)
    return HandShare(touches, wrench, assessment, *exerted, residual, torques, blocked)


def pressing_torques(world: World, frames: HandFrames, touches: BodyTouches, exerted: ContactForces) -> Array:
    """Compute the joint torques from the forces on all objects [N.m], summed over the objects."""
    hand, couples = world.scene.hand, exerted.couples(touches.grasp)
    return jnp.sum(joint_torques(hand, frames, touches.contacts.points, exerted.forces, couples), 0)


def _free(world: World, placed: Pose) -> Array | None:
    """Return the motion basis of each object, the guide's twists for the gripped object and all six for every other;
    None without a guide."""
    guide = world.scene.guide
    if guide is None:
        return None
    guide_twists = guide_at(guide, placed.origin[0])
    all_twists = jnp.broadcast_to(jnp.eye(6), (len(world.others), 6, 6))
    return jnp.concatenate([jnp.pad(guide_twists, ((0, 0), (0, 6 - guide_twists.shape[1])))[None], all_twists])
