"""A virtual hand that a glove moves: its flexions come from the glove, the rest stays as it is."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.carry import closest_forces
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.tick import observe
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, HandFrames, Pose, Posture
from jaxgrasp.validation.checked import checked


class GloveHand(eqx.Module):
    """Which joints of a hand are the glove's channels, and where the others are."""

    places: tuple[int, ...] = eqx.field(static=True)
    """Index of each channel's joint among the hand's joints."""
    others: Float[AnyArray, "J"]
    """Angles of all joints [rad], of which the glove's are replaced."""

    def posture(self, flexions: Float[AnyArray, "channels"], wrist: Pose) -> Posture:
        """The hand as the glove reads it."""
        return Posture(wrist, jnp.asarray(self.others).at[np.array(self.places)].set(flexions))


@checked
def glove_hand(hand: Hand, model: GloveModel, others: Float[AnyArray, "J"]) -> GloveHand:
    """A hand in a glove.

    Args:
        hand: with the glove's joints among its own.
        model: of the glove.
        others: angles of all its joints [rad]; those that the glove does not read stay there.

    Raises:
        ValueError: for a hand without one of the glove's joints, or angles that are not one for each joint.
    """
    if np.shape(others) != (len(hand.joints),):
        raise ValueError(f"others has shape {np.shape(others)}: expected ({len(hand.joints)},), an angle a joint")
    return GloveHand(model.places(hand.joints), others)


@jax.jit
def frames_of(hand: Hand, posture: Posture) -> HandFrames:
    """The hand's frames, compiled once for all ticks."""
    return pose_hand(hand, posture)


class Felt(NamedTuple):
    """What a hand feels of an object at one instant."""

    torques: Float[Array, "channels"]
    """By which the glove is to resist flexion [N.m]: what the contacts exert asks of the joints, less."""
    slope: Float[Array, "channels channels"]
    """Their derivative by the flexions [N.m/rad], with which to answer between two ticks."""
    slips: Array
    """Whether the object slips through the hand, and does not rest on the table."""


@partial(jax.jit, static_argnames="law")
def resistance(
    scene: Scene,
    worn: GloveHand,
    flexions: Float[AnyArray, "channels"],
    wrist: Pose,
    placed: Pose,
    inertial: Float[AnyArray, "6"] | None = None,
    *,
    law: Law = "closed-form",
) -> Float[Array, "channels"]:
    """Torques by which the glove is to resist flexion [N.m].

    Args:
        scene: hand, object and world.
        worn: the hand in its glove.
        flexions: as the glove reads them [rad].
        wrist: where it is.
        placed: where the object is.
        inertial: wrench about the object's centre that accelerates it [N, N.m]; none at rest.
        law: which forces the hand applies, as for [`jaxgrasp.grip.monitor`][].
    """
    torques = observe(scene, worn.posture(flexions, wrist), placed, inertial, law=law).torques
    return -torques[np.array(worn.places)]


@partial(jax.jit, static_argnames="law")
def felt(
    scene: Scene,
    worn: GloveHand,
    flexions: Float[AnyArray, "channels"],
    wrist: Pose,
    placed: Pose,
    inertial: Float[AnyArray, "6"],
    *,
    law: Law,
) -> Felt:
    """Torques as by ``resistance``, with their exact derivative."""

    def both(angles: Array) -> tuple[Array, tuple[Array, Array]]:
        tick = observe(scene, worn.posture(angles, wrist), placed, inertial, law=law)
        torques = -tick.torques[np.array(worn.places)]
        return torques, (torques, (tick.assessment.hold == Hold.SLIPPING) & ~tick.rests)

    slope, (torques, slips) = jax.jacfwd(both, has_aux=True)(jnp.asarray(flexions))
    return Felt(torques, slope, slips)


@jax.jit
def felt_slipping(
    scene: Scene,
    worn: GloveHand,
    flexions: Float[AnyArray, "channels"],
    wrist: Pose,
    placed: Pose,
    inertial: Float[AnyArray, "6"],
) -> Felt:
    """What is felt of an object that no allowed forces hold: those that come closest; the slope is by fixed forces."""
    tick = observe(scene, worn.posture(flexions, wrist), placed, inertial, law="optimum")
    forces = closest_forces(scene, tick.grasp, tick.wrench - tick.support, placed).forces

    def torques_at(angles: Array) -> Array:
        frames = pose_hand(scene.hand, worn.posture(angles, wrist))
        return -joint_torques(scene.hand, frames, tick.contacts.points, forces)[np.array(worn.places)]

    return Felt(*with_slope(torques_at, jnp.asarray(flexions)), jnp.asarray(True))


def with_slope(
    torques_at: Callable[[Array], Array], angles: Float[AnyArray, "channels"]
) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"]]:
    """Torques at some angles, and their derivative by these, computed together."""

    def both(angles: Array) -> tuple[Array, Array]:
        torques = torques_at(angles)
        return torques, torques

    slope, torques = jax.jacfwd(both, has_aux=True)(jnp.asarray(angles))
    return torques, slope
