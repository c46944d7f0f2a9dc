"""Which of a glove's joints matter for a scene: what is lost where one is neither read nor resisted (section II-B)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.monitor import Hold
from jaxgrasp.grip.scene_file import GrippedScene
from jaxgrasp.grip.tick import Tick, observe
from jaxgrasp.model.hand import Pose, Posture

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
    """Whether the object is held without it."""


def joint_losses(made: GrippedScene, model: GloveModel) -> list[JointLoss]:
    """What each joint of a glove is worth to a grip, the one that is felt most first.

    The object is clear of the table, at rest, and where the file has it: a joint that is not read leaves its link where
    an open hand has it, and all others where they are.

    Args:
        made: hand and object as a scene file has them.
        model: of the glove.

    Raises:
        ValueError: for a hand without one of the glove's joints.
    """
    joints = made.scene.hand.joints
    follows = model.transmission(joints) != 0
    whole = np.asarray(made.closed.angles)
    angles = np.concatenate([whole[None], np.where(follows, np.asarray(made.open), whole)])
    scene = eqx.tree_at(lambda s: s.table.origin, made.scene, made.scene.table.origin - jnp.array([0.0, 0.0, CLEAR]))
    wrist = jax.tree.map(lambda x: jnp.broadcast_to(x, (len(angles), *jnp.shape(x))), made.closed.wrist)
    placed = Pose(*(jnp.broadcast_to(x, (len(angles), *x.shape)) for x in (made.placed.origin, made.placed.rotation)))
    tick: Tick = jax.device_get(observe(scene, Posture(wrist, angles), placed, law=made.law))
    torques = model.resisting(joints, np.asarray(tick.torques[0]))
    present = np.asarray(tick.contacts.present)
    squeeze = np.sum(np.asarray(tick.grasp.squeeze) * present, -1)
    count, held = present.sum(-1), np.asarray(tick.assessment.hold) == Hold.STABLE
    found = [
        JointLoss(
            joint=joint,
            torque=float(torques[k]),
            felt=float(torques[k] ** 2 / (np.sum(torques**2) or 1)),
            contacts=int(count[0] - count[k + 1]),
            squeeze=float(1 - squeeze[k + 1] / (squeeze[0] or 1)),
            holds=bool(held[k + 1]),
        )
        for k, joint in enumerate(model.joints)
    ]
    return sorted(found, key=lambda one: (-one.felt, -one.squeeze))
