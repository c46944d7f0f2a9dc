"""A virtual hand that a glove moves: the glove reads its flexions, all other joints stay fixed."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.contact_forces import ContactForces
from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.obstacles import hand_torques
from jaxgrasp.grip.scene import Scene, at_time, check_scene
from jaxgrasp.grip.simulation import closest_forces
from jaxgrasp.grip.tick import ContactMemory, StepResult, Touches, assess_touches, find_touches, observe
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, HandFrames, Pose, Posture
from jaxgrasp.validation.checked import checked


class GloveHand(eqx.Module):
    """Map between the joints of a hand and the channels of a glove, with the angles of all other joints."""

    joint_indices: tuple[int, ...] = eqx.field(static=True)
    """Index of each channel's joint among the hand's joints."""
    transmission: Float[AnyArray, "channels J"]
    """Angle of each joint for one radian of each channel; unit rows where no joints are coupled."""
    fixed_angles: Float[AnyArray, "J"]
    """Angles of the joints that follow no channel [rad]; 0 for those that do."""

    def posture(self, flexions: Float[AnyArray, "channels"], wrist: Pose) -> Posture:
        """Return the posture of the hand, as the glove reads it."""
        # q = q_fixed + T' theta
        return Posture(wrist, self.fixed_angles + jnp.asarray(flexions) @ self.transmission)

    def resisting(self, torques: Float[AnyArray, "J"]) -> Float[Array, "channels"]:
        """Compute the torque of each channel against flexion [N.m], from torques on all joints."""
        # tau_channel = -T tau: equal virtual work
        return -(jnp.asarray(self.transmission) @ torques)


@checked
def glove_hand(hand: Hand, model: GloveModel, fixed_angles: Float[AnyArray, "J"]) -> GloveHand:
    """Fit a glove on a hand.

    Args:
        hand: hand with the glove's joints.
        model: model of the glove.
        fixed_angles: angles of all its joints [rad]; joints without a channel keep them.

    Raises:
        ValueError: for a hand without one of the glove's joints, or a number of angles other than that of its joints.
    """
    if np.shape(fixed_angles) != (len(hand.joints),):
        raise ValueError(
            f"fixed_angles has shape {np.shape(fixed_angles)}: expected ({len(hand.joints)},), an angle for each joint"
        )
    transmission = model.transmission(hand.joints)
    is_free = np.all(transmission == 0, 0)
    return GloveHand(model.joint_indices(hand.joints), transmission, jnp.where(is_free, jnp.asarray(fixed_angles), 0))


class Resistance(NamedTuple):
    """Torques at a glove from an object at one instant, with their derivative and the forces behind them."""

    torques: Float[Array, "channels"]
    """Torques of the glove against flexion [N.m]: the negative joint torques from the contacts."""
    slope: Float[Array, "channels channels"]
    """Derivative of the torques by the flexions [N.m/rad], for the time between two ticks."""
    exerted: ContactForces
    """Contact forces on the object that cause the torques."""


@partial(jax.jit, static_argnames="law")
def resistance(
    scene: Scene,
    glove: GloveHand,
    flexions: Float[AnyArray, "channels"],
    wrist: Pose,
    placed: Pose,
    inertial: Float[AnyArray, "6"] | None = None,
    *,
    law: Law = "closed-form",
) -> Float[Array, "channels"]:
    """Compute the torques of the glove against flexion [N.m].

    Args:
        scene: hand, object and world.
        glove: map between the hand's joints and the glove's channels.
        flexions: angles that the glove reads [rad].
        wrist: pose of the wrist.
        placed: pose of the object.
        inertial: wrench about the object's centre that accelerates it [N, N.m]; none at rest.
        law: force law of the hand, as for [`jaxgrasp.grip.monitor`][].
    """
    return glove.resisting(observe(scene, glove.posture(flexions, wrist), placed, inertial, law=law).torques)


@partial(jax.jit, static_argnames="law")
def resistance_with_slope(
    scene: Scene,
    glove: GloveHand,
    flexions: Float[AnyArray, "channels"],
    wrist: Pose,
    placed: Pose,
    inertial: Float[AnyArray, "6"],
    memory: ContactMemory | None = None,
    *,
    law: Law,
) -> tuple[Resistance, StepResult]:
    """Compute torques as by ``resistance`` with their exact derivative, and the instant's StepResult.

    ``memory`` is that of the contacts with table and obstacles, from the last step. By the optimum, an object that no
    allowed forces hold is rendered with the closest forces; their slope is that of fixed forces.
    """

    # Forward through the detection, where each contact moves with a few joints, and in reverse through the forces, of
    # which torques are few: dtau/dq = (dtau/dp) (dp/dq), with p all that the forces depend on.
    torques, slope, tick = _torques_and_slope(scene, glove, jnp.asarray(flexions), wrist, placed, inertial, memory, law)
    exerted = tick.by_hand
    if law == "optimum":
        torques, slope, exerted = lax.cond(
            tick.slips,
            lambda: _by_closest_forces(scene, glove, flexions, wrist, placed, tick),
            lambda: (torques, slope, exerted),
        )
    return Resistance(torques, slope, exerted), tick


def _torques_and_slope(
    scene: Scene,
    glove: GloveHand,
    flexions: Array,
    wrist: Pose,
    placed: Pose,
    inertial: AnyArray,
    memory: ContactMemory | None,
    law: Law,
) -> tuple[Array, Array, StepResult]:
    check_scene(scene)
    scene = at_time(scene, 0.0)

    def found(angles: Array) -> tuple[HandFrames, Touches]:
        posture = glove.posture(angles, wrist)
        return pose_hand(scene.hand, posture), find_touches(scene, posture, placed)

    def moving_and_fixed(angles: Array) -> tuple[Any, tuple[Any, Any]]:
        moving, fixed = eqx.partition(found(angles), eqx.is_inexact_array)
        return moving, (moving, fixed)

    by_angles, (moving, fixed) = jax.jacfwd(moving_and_fixed, has_aux=True)(flexions)

    def torques_of(moving: Any) -> tuple[Array, StepResult]:
        frames, touches = eqx.combine(moving, fixed)
        tick = assess_touches(scene, frames, placed, touches, inertial, law, memory=memory)
        return glove.resisting(tick.torques), tick

    torques, pull, tick = jax.vjp(torques_of, moving, has_aux=True)
    (by_moving,) = jax.vmap(pull)(jnp.eye(torques.size))
    parts = jax.tree.map(
        lambda rows, columns: rows.reshape(torques.size, -1) @ columns.reshape(-1, flexions.size), by_moving, by_angles
    )
    return torques, sum(jax.tree.leaves(parts), jnp.zeros((torques.size, flexions.size))), tick


def _by_closest_forces(
    scene: Scene, glove: GloveHand, flexions: AnyArray, wrist: Pose, placed: Pose, tick: StepResult
) -> tuple[Array, Array, ContactForces]:
    """Compute torques, their slope, and the contact forces, for an object that no allowed forces hold."""
    exerted, _ = closest_forces(scene, tick, placed)
    couples = exerted.couples(tick.grasp)

    def torques_at(angles: Array) -> Array:
        posture = glove.posture(angles, wrist)
        frames = pose_hand(scene.hand, posture)
        torques = joint_torques(scene.hand, frames, tick.contacts.points, exerted.forces, couples)
        return glove.resisting(torques + hand_torques(scene, posture))

    return *with_slope(torques_at, jnp.asarray(flexions)), exerted


def with_slope(
    torques_at: Callable[[Array], Array], angles: Float[AnyArray, "channels"]
) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"]]:
    """Compute torques, and their derivative by the angles, together."""

    def value_and_aux(angles: Array) -> tuple[Array, Array]:
        torques = torques_at(angles)
        return torques, torques

    slope, torques = jax.jacfwd(value_and_aux, has_aux=True)(jnp.asarray(angles))
    return torques, slope
