"""A virtual hand that a glove moves: its flexions come from the glove, the rest stays as it is."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.contact_forces import ContactForces
from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.motion import Motion
from jaxgrasp.grip.obstacles import hand_torques
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.simulation import closest_forces
from jaxgrasp.grip.tick import StepResult, observe
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.validation.checked import checked


class GloveHand(eqx.Module):
    """Which joints of a hand move with the glove's channels, and where the others are."""

    places: tuple[int, ...] = eqx.field(static=True)
    """Index of each channel's joint among the hand's joints."""
    transmission: Float[AnyArray, "channels J"]
    """Angle of each joint for one radian of each channel; rows of a one where no joints are coupled."""
    others: Float[AnyArray, "J"]
    """Angles of the joints that follow no channel [rad]; 0 of those that do."""

    def posture(self, flexions: Float[AnyArray, "channels"], wrist: Pose) -> Posture:
        """The hand as the glove reads it."""
        return Posture(wrist, self.others + jnp.asarray(flexions) @ self.transmission)

    def resisting(self, torques: Float[AnyArray, "J"]) -> Float[Array, "channels"]:
        """Torque by which each channel is to resist flexion [N.m], for torques on all joints."""
        return -(jnp.asarray(self.transmission) @ torques)


@checked
def glove_hand(hand: Hand, model: GloveModel, others: Float[AnyArray, "J"]) -> GloveHand:
    """A hand in a glove.

    Args:
        hand: with the glove's joints among its own.
        model: of the glove.
        others: angles of all its joints [rad]; those that the glove does not move stay there.

    Raises:
        ValueError: for a hand without one of the glove's joints, or angles that are not one for each joint.
    """
    if np.shape(others) != (len(hand.joints),):
        raise ValueError(f"others has shape {np.shape(others)}: expected ({len(hand.joints)},), an angle a joint")
    transmission = model.transmission(hand.joints)
    alone = np.all(transmission == 0, 0)
    return GloveHand(model.places(hand.joints), transmission, jnp.where(alone, jnp.asarray(others), 0))


class Felt(NamedTuple):
    """What a hand feels of an object at one instant."""

    torques: Float[Array, "channels"]
    """By which the glove is to resist flexion [N.m]: what the contacts exert asks of the joints, less."""
    slope: Float[Array, "channels channels"]
    """Their derivative by the flexions [N.m/rad], with which to answer between two ticks."""
    exerted: ContactForces
    """What the contacts exert on the object, of which the torques are."""


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
    return worn.resisting(observe(scene, worn.posture(flexions, wrist), placed, inertial, law=law).torques)


@partial(jax.jit, static_argnames="law")
def felt(
    scene: Scene,
    worn: GloveHand,
    flexions: Float[AnyArray, "channels"],
    wrist: Pose,
    placed: Pose,
    inertial: Float[AnyArray, "6"],
    motion: Motion | None = None,
    *,
    law: Law,
) -> tuple[Felt, StepResult]:
    """Torques as by ``resistance`` with their exact derivative, and the instant that they are of.

    ``motion`` is the object's, which obstacles with friction or damping resist.

    By the optimum, an object that no allowed forces hold is felt by those that come closest; their slope is that of
    fixed forces.
    """

    def both(angles: Array) -> tuple[Array, tuple[Array, StepResult]]:
        tick = observe(scene, worn.posture(angles, wrist), placed, inertial, law=law, motion=motion)
        torques = worn.resisting(tick.torques)
        return torques, (torques, tick)

    slope, (torques, tick) = jax.jacfwd(both, has_aux=True)(jnp.asarray(flexions))
    exerted = tick.by_hand
    if law == "optimum":
        torques, slope, exerted = lax.cond(
            tick.slips,
            lambda: _by_closest_forces(scene, worn, flexions, wrist, placed, tick),
            lambda: (torques, slope, exerted),
        )
    return Felt(torques, slope, exerted), tick


def _by_closest_forces(
    scene: Scene, worn: GloveHand, flexions: AnyArray, wrist: Pose, placed: Pose, tick: StepResult
) -> tuple[Array, Array, ContactForces]:
    """Torques, their slope, and what the contacts exert."""
    exerted, _ = closest_forces(scene, tick, placed)
    couples = exerted.couples(tick.grasp)

    def torques_at(angles: Array) -> Array:
        posture = worn.posture(angles, wrist)
        frames = pose_hand(scene.hand, posture)
        torques = joint_torques(scene.hand, frames, tick.contacts.points, exerted.forces, couples)
        return worn.resisting(torques + hand_torques(scene, posture))

    return *with_slope(torques_at, jnp.asarray(flexions)), exerted


def with_slope(
    torques_at: Callable[[Array], Array], angles: Float[AnyArray, "channels"]
) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"]]:
    """Torques at some angles, and their derivative by these, computed together."""

    def both(angles: Array) -> tuple[Array, Array]:
        torques = torques_at(angles)
        return torques, torques

    slope, torques = jax.jacfwd(both, has_aux=True)(jnp.asarray(angles))
    return torques, slope
