"""A virtual hand that a glove moves: the glove reads its flexions, all other joints stay fixed."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.contact_forces import ContactForces
from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.obstacles import felt_surfaces, surface_torques
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.simulation import closest_forces
from jaxgrasp.grip.table_support import Solutions
from jaxgrasp.grip.tick import ContactMemory, StepResult, Touches, assess_touches, observe, touches_of
from jaxgrasp.hand.detection import ContactGeometry, Contacts, contacts_and_rates
from jaxgrasp.hand.kinematics import frame_rates, joint_torques, pose_hand
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.kernel import is_used
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, HandFrames, Pose, Posture
from jaxgrasp.validation.checked import checked

Result = TypeVar("Result")


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


class FeltInstant(NamedTuple):
    """Arguments of the forces of one instant."""

    scene: Scene
    frames: HandFrames
    placed: Pose
    touches: Touches
    inertial: Float[Array, "6"]
    memory: ContactMemory | None

    def assess(self, law: Law, known: Solutions | None = None) -> tuple[StepResult, Solutions]:
        """Compute the instant's forces, and the solutions behind them; of ``known`` solutions only derivatives."""
        scene, frames, placed, touches, inertial, memory = self
        return assess_touches(scene, frames, placed, touches, inertial, law, memory=memory, known=known)


def felt_instant(
    scene: Scene,
    glove: GloveHand,
    flexions: Float[AnyArray, "channels"],
    wrist: Pose,
    placed: Pose,
    inertial: Float[AnyArray, "6"],
    memory: ContactMemory | None,
) -> tuple[FeltInstant, "TouchingHand"]:
    """Find the contacts of a hand as a glove reads it, with their derivatives.

    The arguments are those of ``resistance``, with obstacles at their poses in the scene; ``memory`` is that of the
    contacts with table and obstacles, from the last step.
    """
    frames = pose_hand(scene.hand, glove.posture(jnp.asarray(flexions), wrist))
    touching = touching_hand(scene.hand, frames, [(scene.body.shape, placed), *felt_surfaces(scene)])
    touches = touches_of(scene, placed, touching.contacts[0], surface_torques(scene, frames, touching.contacts[1:]))
    return FeltInstant(scene, frames, placed, touches, jnp.asarray(inertial), memory), touching


def resistance_of(
    glove: GloveHand,
    instant: FeltInstant,
    touching: "TouchingHand",
    tick: StepResult,
    solutions: Solutions,
    law: Law,
) -> Resistance:
    """Compute the torques of the glove with their exact derivative, from an instant's forces and the solutions behind
    them.

    By the optimum, an object that no allowed forces hold is rendered with the closest forces; their slope is that of
    fixed forces.
    """
    scene, _, placed, _, _, _ = instant

    def torques_of(frames: HandFrames, contacts: list[Contacts]) -> tuple[Array, None]:
        touches = touches_of(scene, placed, contacts[0], surface_torques(scene, frames, contacts[1:]))
        moved = instant._replace(frames=frames, touches=touches)
        return moved.assess(law, solutions)[0].torques, None

    torques, slope, _ = touching.torques_and_slope(glove, torques_of)
    exerted = tick.by_hand

    def by_closest_forces() -> tuple[Array, Array, ContactForces]:
        nearest, _ = closest_forces(scene, tick, placed)
        couples = nearest.couples(tick.grasp)

        def torques_of(frames: HandFrames, contacts: list[Contacts]) -> tuple[Array, None]:
            torques = joint_torques(scene.hand, frames, tick.contacts.points, nearest.forces, couples)
            return torques + surface_torques(scene, frames, contacts[1:]), None

        return *touching.torques_and_slope(glove, torques_of)[:2], nearest

    if law == "optimum":
        torques, slope, exerted = lax.cond(tick.slips, by_closest_forces, lambda: (torques, slope, exerted))
    return Resistance(torques, slope, exerted)


class TouchingHand(NamedTuple):
    """Frames of one posed hand and its contacts with several surfaces, with their derivatives by the joint angles."""

    frames: HandFrames
    contacts: list[Contacts]
    """Contacts with each surface."""
    frame_rates: HandFrames
    """Derivatives of the frames; the joints are the first axis."""
    contact_rates: list[ContactGeometry]

    def torques_and_slope(
        self, glove: GloveHand, torques_of: Callable[[HandFrames, list[Contacts]], tuple[Array, Result]]
    ) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"], Result]:
        """Compute the torques of each channel against flexion, and their derivative by the flexions [N.m/rad].

        dtau/dq = (dtau/dp) (dp/dq), with p the frames and contacts: forward through the detection, where a contact
        moves with its link alone, and with the kernel in reverse through the forces, of which torques are few.

        Args:
            glove: map between the hand's joints and the glove's channels.
            torques_of: from frames and contacts to the joint torques [N.m], and further results.
        """

        def from_geometry(frames: HandFrames, geometry: list[ContactGeometry]) -> tuple[Array, Result]:
            contacts = [replace(c, **g._asdict()) for c, g in zip(self.contacts, geometry, strict=True)]
            torques, result = torques_of(frames, contacts)
            return glove.resisting(torques), result

        geometry = [ContactGeometry(c.points, c.normals, c.depths) for c in self.contacts]
        rates = self.frame_rates, self.contact_rates
        if not is_used():
            # The JAX solver's derivative by one more direction costs less than another pull through it.
            torques, push, result = jax.linearize(from_geometry, self.frames, geometry, has_aux=True)
            # q = q_fixed + T' theta
            directions = jax.tree.map(lambda rate: jnp.tensordot(glove.transmission, rate, 1), rates)
            return torques, jax.vmap(lambda direction: push(*direction))(directions).T, result
        torques, pull, result = jax.vjp(from_geometry, self.frames, geometry, has_aux=True)
        by_place = jax.vmap(pull)(jnp.eye(torques.size))
        by_joint = jax.tree.map(
            lambda rows, rate: rows.reshape(torques.size, -1) @ rate.reshape(len(rate), -1).T, by_place, rates
        )
        return torques, sum(jax.tree.leaves(by_joint)) @ jnp.asarray(glove.transmission).T, result


def touching_hand(hand: Hand, frames: HandFrames, surfaces: Sequence[tuple[Shape, Pose]]) -> TouchingHand:
    """Find the contacts of a hand with each surface, and their derivatives."""
    contacts, rates = zip(*(contacts_and_rates(hand, frames, *surface) for surface in surfaces), strict=True)
    return TouchingHand(frames, list(contacts), frame_rates(hand, frames), list(rates))


def with_slope(
    torques_at: Callable[[Array], Array], angles: Float[AnyArray, "channels"]
) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"]]:
    """Compute torques, and their derivative by the angles, together."""

    def value_and_aux(angles: Array) -> tuple[Array, Array]:
        torques = torques_at(angles)
        return torques, torques

    slope, torques = jax.jacfwd(value_and_aux, has_aux=True)(jnp.asarray(angles))
    return torques, slope
