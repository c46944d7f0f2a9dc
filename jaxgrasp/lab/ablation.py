"""Importance of a glove's joints for a scene: the loss without reading or resisting a joint (section II-B)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.monitor import Hold
from jaxgrasp.grip.scene_file import GrippedScene
from jaxgrasp.grip.simulation import stacked
from jaxgrasp.grip.tick import StepResult, observe
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.world.hand_share import cut_share, find_touches
from jaxgrasp.world.many_bodies import World, WorldState, holding_weights

TABLE_DROP = 1.0
"""Distance by which the table is lowered, so that the hand carries the object alone [m]."""


class JointLoss(NamedTuple):
    """Loss of a grip without a joint of the glove."""

    joint: str
    torque: float
    """Torque against the joint's flexion, which is not rendered then [N.m]."""
    torque_share: float
    """Share in the sum of all joints' squared torques."""
    contacts: int
    """Contacts lost, where the joint is not read and stays open."""
    squeeze: float
    """Share of the squeezing forces lost with them; negative for a gain."""
    holds: bool
    """True if the object is held without the joint; for several objects, if all are that are held with it."""


def joint_losses(
    gripped: GrippedScene, model: GloveModel, among: tuple[World, WorldState] | None = None
) -> list[JointLoss]:
    """Compute the loss of a grip without each joint of a glove, the joint with the largest torque first.

    The object is clear of the table, at rest, and at its pose in the file: a joint that is not read leaves its link in
    the posture of the open hand, and all other links in place. Each of several objects is clear of the others too.

    Args:
        gripped: hand and object of a scene file.
        model: model of the glove.
        among: world of the scene with several objects, and their state, as from [`jaxgrasp.world.world_of`][].

    Raises:
        ValueError: for a hand without one of the glove's joints.
    """
    joints = gripped.scene.hand.joints
    follows = model.transmission(joints) != 0
    closed_angles = np.asarray(gripped.closed.angles)
    angles = np.concatenate([closed_angles[None], np.where(follows, np.asarray(gripped.open), closed_angles)])
    scene = eqx.tree_at(
        lambda s: s.table.origin, gripped.scene, gripped.scene.table.origin - jnp.array([0.0, 0.0, TABLE_DROP])
    )
    clear = gripped._replace(scene=scene)
    grips = _grips_of_object(clear, angles) if among is None else _grips_of_objects(clear, angles, *among)
    channel_torques = model.resisting(joints, np.asarray(grips.torques))
    losses = [
        JointLoss(
            joint=joint,
            torque=float(channel_torques[k]),
            torque_share=float(channel_torques[k] ** 2 / (np.sum(channel_torques**2) or 1)),
            contacts=int(grips.contacts[0] - grips.contacts[k + 1]),
            squeeze=float(1 - grips.squeeze[k + 1] / (grips.squeeze[0] or 1)),
            holds=bool(grips.holds[k + 1]),
        )
        for k, joint in enumerate(model.joints)
    ]
    return sorted(losses, key=lambda loss: (-loss.torque_share, -loss.squeeze))


class _Grips(NamedTuple):
    """Grips of a hand in P postures, the first of which has all joints."""

    torques: Float[AnyArray, "J"]
    """Torques on the joints in the first posture [N.m]."""
    contacts: AnyArray
    """``(P,)``"""
    squeeze: AnyArray
    """``(P,)``: sum of the squeezing forces [N]."""
    holds: AnyArray
    """``(P,)``"""


def _grips_of_object(gripped: GrippedScene, angles: Float[np.ndarray, "P J"]) -> _Grips:
    wrist = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(angles), *jnp.shape(x))), gripped.closed.wrist)
    placed = Pose(
        *(jnp.broadcast_to(x, (len(angles), *x.shape)) for x in (gripped.placed.origin, gripped.placed.rotation))
    )
    tick: StepResult = jax.device_get(observe(gripped.scene, Posture(wrist, angles), placed, law=gripped.law))
    present = np.asarray(tick.contacts.present)
    squeeze = np.sum(np.asarray(tick.grasp.squeeze) * present, -1)
    return _Grips(tick.torques[0], present.sum(-1), squeeze, np.asarray(tick.assessment.hold) == Hold.STABLE)


def _grips_of_objects(
    gripped: GrippedScene, angles: Float[np.ndarray, "P J"], world: World, state: WorldState
) -> _Grips:
    clear, placed, weights = World(gripped.scene, world.others), state.placed, holding_weights(world)
    shares = []
    for row in angles:
        posture = Posture(gripped.closed.wrist, jnp.asarray(row))
        touches = find_touches(clear, posture, placed)
        shares.append(cut_share(clear, posture, placed, touches, jnp.asarray(weights), law=gripped.law))
    share = stacked(shares)
    present = np.asarray(share.touches.contacts.present)
    squeeze = np.sum(np.asarray(share.touches.grasp.squeeze) * present, (-1, -2))
    is_held = np.asarray(share.assessment.hold) == Hold.STABLE
    counts = is_held[0] | (np.arange(is_held.shape[1]) == 0)
    return _Grips(share.torques[0], present.sum((-1, -2)), squeeze, is_held[:, counts].all(-1))
