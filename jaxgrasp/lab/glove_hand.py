"""A virtual hand that a glove moves: its flexions come from the glove, the rest stays as it is."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.tick import observe
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.checked import checked
from jaxgrasp.model.hand import Hand, HandFrames, Pose, Posture


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


@jax.jit
def resistance(
    scene: Scene, worn: GloveHand, flexions: Float[AnyArray, "channels"], wrist: Pose, placed: Pose
) -> Float[Array, "channels"]:
    """Torques by which the glove is to resist flexion [N.m]: what the contact forces ask of the joints, less."""
    torques = observe(scene, worn.posture(flexions, wrist), placed).torques
    return -torques[np.array(worn.places)]


@jax.jit
def resistance_and_slope(
    scene: Scene, worn: GloveHand, flexions: Float[AnyArray, "channels"], wrist: Pose, placed: Pose
) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"]]:
    """Torques as by ``resistance`` [N.m], and their exact derivative by the flexions [N.m/rad], with which to answer
    between two ticks."""

    return with_slope(lambda angles: resistance(scene, worn, angles, wrist, placed), flexions)


def with_slope(
    torques_at: Callable[[Array], Array], angles: Float[AnyArray, "channels"]
) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"]]:
    """Torques at some angles, and their derivative by these, computed together."""

    def both(angles: Array) -> tuple[Array, Array]:
        torques = torques_at(angles)
        return torques, torques

    slope, torques = jax.jacfwd(both, has_aux=True)(jnp.asarray(angles))
    return torques, slope
