"""Which of a glove's joints matter for a scene: what is lost where one is neither read nor resisted (section II-B)."""

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

CLEAR = 1.0
"""How far the table is lowered, so that the hand carries the object alone [m]."""


class JointLoss(NamedTuple):
    """What a glove loses of a grip without one of its joints."""

    joint: str
    torque: float
    """Against its flexion, which then nobody feels [N.m]."""
    felt: float
    """Its part of what is felt: of the sum of all joints' squared torques."""
    contacts: int
    """Contacts that go, where the joint is not read and stays open."""
    squeeze: float
    """Part of the squeezing forces that goes with them, or comes (negative)."""
    holds: bool
    """Whether the object is held without it; among several, all that are held with it."""


def joint_losses(
    made: GrippedScene, model: GloveModel, among: tuple[World, WorldState] | None = None
) -> list[JointLoss]:
    """What each joint of a glove is worth to a grip, the one that is felt most first.

    The object is clear of the table, at rest, and where the file has it: a joint that is not read leaves its link where
    an open hand has it, and all others where they are. Of several objects each is clear of the others too.

    Args:
        made: hand and object as a scene file has them.
        model: of the glove.
        among: the scene's world of several objects, and where they are, as from [`jaxgrasp.world.world_of`][].

    Raises:
        ValueError: for a hand without one of the glove's joints.
    """
    joints = made.scene.hand.joints
    follows = model.transmission(joints) != 0
    whole = np.asarray(made.closed.angles)
    angles = np.concatenate([whole[None], np.where(follows, np.asarray(made.open), whole)])
    scene = eqx.tree_at(lambda s: s.table.origin, made.scene, made.scene.table.origin - jnp.array([0.0, 0.0, CLEAR]))
    clear = made._replace(scene=scene)
    grips = _of_one(clear, angles) if among is None else _of_several(clear, angles, *among)
    torques = model.resisting(joints, np.asarray(grips.torques))
    found = [
        JointLoss(
            joint=joint,
            torque=float(torques[k]),
            felt=float(torques[k] ** 2 / (np.sum(torques**2) or 1)),
            contacts=int(grips.contacts[0] - grips.contacts[k + 1]),
            squeeze=float(1 - grips.squeeze[k + 1] / (grips.squeeze[0] or 1)),
            holds=bool(grips.holds[k + 1]),
        )
        for k, joint in enumerate(model.joints)
    ]
    return sorted(found, key=lambda one: (-one.felt, -one.squeeze))


class _Grips(NamedTuple):
    """What a hand grips in P postures, the first of which has all joints."""

    torques: Float[AnyArray, "J"]
    """On the joints in the first posture [N.m]."""
    contacts: AnyArray
    """``(P,)``"""
    squeeze: AnyArray
    """``(P,)``: the sum of the squeezing forces [N]."""
    holds: AnyArray
    """``(P,)``"""


def _of_one(made: GrippedScene, angles: Float[np.ndarray, "P J"]) -> _Grips:
    wrist = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(angles), *jnp.shape(x))), made.closed.wrist)
    placed = Pose(*(jnp.broadcast_to(x, (len(angles), *x.shape)) for x in (made.placed.origin, made.placed.rotation)))
    tick: StepResult = jax.device_get(observe(made.scene, Posture(wrist, angles), placed, law=made.law))
    present = np.asarray(tick.contacts.present)
    squeeze = np.sum(np.asarray(tick.grasp.squeeze) * present, -1)
    return _Grips(tick.torques[0], present.sum(-1), squeeze, np.asarray(tick.assessment.hold) == Hold.STABLE)


def _of_several(made: GrippedScene, angles: Float[np.ndarray, "P J"], world: World, state: WorldState) -> _Grips:
    clear, placed, weights = World(made.scene, world.others), state.placed, holding_weights(world)
    shares = []
    for each in angles:
        posture = Posture(made.closed.wrist, jnp.asarray(each))
        touches = find_touches(clear, posture, placed)
        shares.append(cut_share(clear, posture, placed, touches, jnp.asarray(weights), law=made.law))
    share = stacked(shares)
    present = np.asarray(share.touches.contacts.present)
    squeeze = np.sum(np.asarray(share.touches.grasp.squeeze) * present, (-1, -2))
    held = np.asarray(share.assessment.hold) == Hold.STABLE
    counts = held[0] | (np.arange(held.shape[1]) == 0)
    return _Grips(share.torques[0], present.sum((-1, -2)), squeeze, held[:, counts].all(-1))
