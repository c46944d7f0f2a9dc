"""Objects of the psychophysics that a hand in a glove feels: a weight to lift, a stiffness to squeeze, a torque.

Each is a law of resistance: torques at the glove's joints as a function of their angles and an intensity. The weight is
that of Fig. 8: a bar on the fingers, guided vertically, in a hand with its palm up.
"""

from abc import ABC, abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool

from jaxgrasp.force.distribution import closed_form
from jaxgrasp.glove.loop.exchange import TorqueLaw
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.contact_forces import applied_forces
from jaxgrasp.hand.human_hand import LEAVES, human_hand, open_angles
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand, with_slope
from jaxgrasp.lab.haptic_loop import torque_law
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Hand, HandFrames, Pose
from jaxgrasp.psychophysics.plan import StimulusPlan
from jaxgrasp.validation.checked import checked

TRAVEL = 0.04
"""Travel of the bar, upwards (section III-C) [m]."""
ENGAGED = 0.001
"""Height over which the bar's weight passes from its support to the fingers [m]."""
STOP = 2000.0
"""Stiffness of the end stop [N/m]."""
SQUEEZED = 0.01
"""Depth to which an object is squeezed [m]; its stiffness is felt up to it."""
WIDTH = 0.07
"""Width of the squeezed object, that of the paper's cube [m]."""
FRICTION = 0.6
BENT = {"PIP": 0.25, "DIP": 0.15}
"""Initial flexion of fingers that lift [rad]."""
CURLED = {"MP": 0.5, "PIP": 0.5, "DIP": 0.25}
"""Initial flexion of fingers that squeeze [rad]."""
MAX_FLEXION = 1.2
"""Flexion of knuckles up to which the travel is searched [rad]."""

PALM_UP = Pose(np.zeros(3), np.diag([1.0, -1.0, -1.0]))


class FeltTick(NamedTuple):
    """Rendering of an intensity at one instant."""

    law: TorqueLaw
    share: float
    """Share of the intensity that is felt, from 0 to 1."""
    is_alone: bool
    """True if only the intensity is felt, without the end stop."""


class Rendering(ABC):
    """Renderer of intensities, one after another, used by one thread."""

    @abstractmethod
    def begin(self, intensity: float) -> None:
        """Start to render an intensity."""

    @abstractmethod
    def tick(self, timestamp: float, angles: Float[np.ndarray, "channels"]) -> FeltTick:
        """Compute the law of torques at a time [s] and angles [rad]."""

    @abstractmethod
    def predicted_torques(self, intensity: float) -> Float[np.ndarray, "P channels"]:
        """Return the torques of an intensity in all the postures in which a person feels it [N.m]."""


class FeltObject(eqx.Module):
    """An object with an intensity, felt by some joints of a glove."""

    @abstractmethod
    def resistance(
        self, angles: Float[AnyArray, "channels"], intensity: Float[AnyArray, ""] | float
    ) -> Float[Array, "channels"]:
        """Compute the torques against flexion [N.m]."""

    @abstractmethod
    def postures(self) -> Float[np.ndarray, "P channels"]:
        """Return the angles in which a person feels it [rad]."""

    @abstractmethod
    def channels(self) -> tuple[int, ...]:
        """Return the joints of the glove that a person moves to feel it."""

    @abstractmethod
    def share(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        """Compute the share of the intensity that is felt at these angles, from 0 to 1."""

    def is_alone(self, angles: Float[AnyArray, "channels"]) -> Bool[Array, ""]:
        """Return whether only the intensity is felt at these angles, without the end stop."""
        return jnp.asarray(True)


class Lifted(FeltObject):
    """A weight [N] on the same phalanx of several fingers."""

    hand: Hand
    glove: GloveHand
    links: tuple[int, ...] = eqx.field(static=True)
    start: Float[AnyArray, "channels"]
    """Angles at which the bar rests [rad]."""

    def height(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        """Compute the height of the bar above its rest [m]."""
        return jnp.mean(self.pads(angles)[1][:, 2]) - jnp.mean(self.pads(self.start)[1][:, 2])

    def resistance(
        self, angles: Float[AnyArray, "channels"], intensity: Float[AnyArray, ""] | float
    ) -> Float[Array, "channels"]:
        frames, points = self.pads(angles)
        load = intensity * self.share(angles) + STOP * jnp.maximum(self.height(angles) - TRAVEL, 0)
        up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), points.shape)
        squeeze = jnp.full(len(self.links), load / len(self.links))
        grasp = Grasp(points, up, jnp.full(len(self.links), FRICTION), squeeze)
        wrench = jnp.zeros(6).at[2].set(load)
        return _resisting_torques(self.hand, self.glove, self.links, frames, grasp, wrench, jnp.eye(6)[:, 2:3])

    def share(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        return engaged_share(self.height(angles))

    def channels(self) -> tuple[int, ...]:
        return _finger_channels(self)

    def is_alone(self, angles: Float[AnyArray, "channels"]) -> Bool[Array, ""]:
        return self.height(angles) <= TRAVEL

    def postures(self) -> Float[np.ndarray, "P channels"]:
        return _felt_postures(self, lambda angles: (self.height(angles) > ENGAGED) & (self.height(angles) <= TRAVEL))

    def pads(self, angles: Float[AnyArray, "channels"]) -> tuple[HandFrames, Array]:
        """Return the posed hand, and the contact of the bar on each finger ``(n, 3)`` [m]."""
        frames = pose_hand(self.hand, self.glove.posture(jnp.asarray(angles), PALM_UP))
        centres, radii = _pads(self.hand, frames, self.links)
        return frames, centres + radii[:, None] * jnp.array([0.0, 0.0, 1.0])


class Squeezed(FeltObject):
    """A stiffness [N/m] between several fingers and an opposed thumb."""

    hand: Hand
    glove: GloveHand
    links: tuple[int, ...] = eqx.field(static=True)
    start: Float[AnyArray, "channels"]
    """Angles at which fingers touch it [rad]."""

    def depths(self, angles: Float[AnyArray, "channels"]) -> Float[Array, "n"]:
        """Compute the depth of each finger [m]."""
        _, centres = self.pads(angles)
        _, touching = self.pads(self.start)
        return (centres - touching) @ self.inward()

    def resistance(
        self, angles: Float[AnyArray, "channels"], intensity: Float[AnyArray, ""] | float
    ) -> Float[Array, "channels"]:
        frames, points = self.pads(angles)
        inward = self.inward()
        squeeze = intensity * jnp.maximum(self.depths(angles), 0)
        # The thumb is opposite, at the point without a moment of the fingers' forces, and bears their sum.
        total = jnp.sum(squeeze)
        middle = jnp.where(total > 0, squeeze @ points / jnp.where(total > 0, total, 1), points.mean(0))
        points = jnp.vstack([points, middle + WIDTH * inward])
        normals = jnp.vstack([jnp.broadcast_to(inward, (len(self.links), 3)), -inward])
        squeeze_of_all = jnp.append(squeeze, total)
        grasp = Grasp(points, normals, jnp.full(len(squeeze_of_all), FRICTION), squeeze_of_all)
        free = jnp.append(inward, jnp.zeros(3))[:, None]
        return _resisting_torques(self.hand, self.glove, self.links, frames, grasp, jnp.zeros(6), free)

    def share(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        # A stiffness is felt only with some depth; the force of the first touch is independent of it.
        return engaged_share(jnp.mean(self.depths(angles)))

    def channels(self) -> tuple[int, ...]:
        return _finger_channels(self)

    def postures(self) -> Float[np.ndarray, "P channels"]:
        return _felt_postures(
            self, lambda angles: (self.depths(angles).mean() > 0) & (self.depths(angles).max() <= SQUEEZED)
        )

    def inward(self) -> Float[Array, "3"]:
        """Return the direction of the pads at the start: from the fingers into the object."""
        frames = pose_hand(self.hand, self.glove.posture(jnp.asarray(self.start), PALM_UP))
        facing = -frames.links.rotation[np.array(self.links), :, 2].mean(0)
        return facing / jnp.linalg.norm(facing)

    def pads(self, angles: Float[AnyArray, "channels"]) -> tuple[HandFrames, Array]:
        """Return the posed hand, and the contact of each finger ``(n, 3)`` [m]."""
        frames = pose_hand(self.hand, self.glove.posture(jnp.asarray(angles), PALM_UP))
        centres, radii = _pads(self.hand, frames, self.links)
        outward = -frames.links.rotation[np.array(self.links), :, 2]
        return frames, centres + radii[:, None] * outward


class Resisted(FeltObject):
    """A torque [N.m] on a joint, at any angle."""

    channel: int = eqx.field(static=True)
    count: int = eqx.field(static=True)
    """Number of joints of the glove."""

    def resistance(
        self, angles: Float[AnyArray, "channels"], intensity: Float[AnyArray, ""] | float
    ) -> Float[Array, "channels"]:
        return jnp.zeros(self.count).at[self.channel].set(intensity)

    def share(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        return jnp.ones(())

    def channels(self) -> tuple[int, ...]:
        return (self.channel,)

    def postures(self) -> Float[np.ndarray, "P channels"]:
        return np.zeros((1, self.count))


class LawOfAngles(Rendering):
    """Renderer of a felt object's own law: its torques at the current angles, without memory."""

    def __init__(self, target: FeltObject) -> None:
        self._target, self._intensity = target, 0.0
        self._postures = target.postures()

    def begin(self, intensity: float) -> None:
        self._intensity = intensity

    def tick(self, timestamp: float, angles: Float[np.ndarray, "channels"]) -> FeltTick:
        law = torque_law(timestamp, angles, resistance_and_slope(self._target, angles, self._intensity))
        share, is_alone = jax.device_get(share_and_alone(self._target, angles))
        return FeltTick(law, float(share), bool(is_alone))

    def predicted_torques(self, intensity: float) -> Float[np.ndarray, "P channels"]:
        return np.asarray(resistances(self._target, self._postures, intensity))


@checked
def felt_object(plan: StimulusPlan, model: GloveModel, hand: Hand | None = None) -> FeltObject:
    """Build the object that a plan lets a hand in a glove feel.

    Args:
        plan: plan of the stimulus.
        model: model of the glove.
        hand: a human hand; one of average size if None.

    Raises:
        ValueError: for a finger or a joint that the glove does not pull on.
    """
    if plan.kind == "torque":
        if plan.joint not in model.joints:
            raise ValueError(
                f"joint is {plan.joint!r}, which {model.name} does not pull on: expected one of "
                f"{', '.join(model.joints)}"
            )
        return Resisted(model.joints.index(plan.joint), len(model.joints))
    hand = human_hand() if hand is None else hand
    for k, finger in enumerate(plan.fingers):
        if f"{finger} MP" not in model.joints:
            raise ValueError(f"fingers[{k}] is {finger!r}: {model.name} does not pull on its MP joint")
    start = open_angles(hand)
    flexion = BENT if plan.kind == "weight" else CURLED
    for k, joint in enumerate(hand.joints):
        finger, _, kind = joint.partition(" ")
        if finger != "thumb":
            start[k] = flexion.get(kind, start[k])
    names = [link.name for link in hand.links]
    links = tuple(names.index(f"{finger} {plan.phalanx}") for finger in plan.fingers)
    glove = glove_hand(hand, model, start)
    cls = Lifted if plan.kind == "weight" else Squeezed
    return cls(hand, glove, links, jnp.asarray(start[list(glove.joint_indices)]))


@jax.jit
def resistance_and_slope(
    target: FeltObject, angles: Float[AnyArray, "channels"], intensity: Float[AnyArray, ""] | float
) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"]]:
    """Compute the torques against flexion [N.m], and their exact derivative by the angles [N.m/rad]."""
    return with_slope(lambda at: target.resistance(at, intensity), angles)


@jax.jit
def share_and_alone(
    target: FeltObject, angles: Float[AnyArray, "channels"]
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Compute ``share`` and ``is_alone``; compiled once for all instants."""
    return target.share(angles), target.is_alone(angles)


@jax.jit
def resistances(
    target: FeltObject, angles: Float[AnyArray, "P channels"], intensity: Float[AnyArray, ""] | float
) -> Float[Array, "P channels"]:
    """Compute the torques against flexion in many postures."""
    return jax.vmap(lambda row: target.resistance(row, intensity))(jnp.asarray(angles))


def _pads(hand: Hand, frames: HandFrames, links: tuple[int, ...]) -> tuple[Array, Array]:
    """Return the centres and radii of the spheres in the middle of links."""
    index = np.array(links)
    centres = jnp.asarray(hand.skin.centers)[index, LEAVES // 2]
    offsets = jnp.einsum("lij,lj->li", frames.links.rotation[index], centres)
    return frames.links.origin[index] + offsets, jnp.asarray(hand.skin.radii)[index, LEAVES // 2]


def _resisting_torques(
    hand: Hand,
    glove: GloveHand,
    links: tuple[int, ...],
    frames: HandFrames,
    grasp: Grasp,
    wrench: Float[AnyArray, "6"],
    free: Float[AnyArray, "6 1"],
) -> Float[Array, "channels"]:
    """Compute the torques at the glove's joints from method B's forces on a guided object, whose first contacts are
    those of the links."""
    forces = applied_forces(closed_form(grasp, wrench, free=free)).forces
    index, count = np.array(links), len(links)
    points = jnp.zeros((len(hand.links), 3)).at[index].set(grasp.points[:count])
    on_links = jnp.zeros((len(hand.links), 3)).at[index].set(forces[:count])
    return glove.resisting(joint_torques(hand, frames, points, on_links))


@jax.jit
def engaged_share(travel: Float[Array, ""]) -> Float[Array, ""]:
    """Rise smoothly from 0 to 1 over a short travel [m], so that the law has a slope at every angle."""
    share = jnp.clip(travel / ENGAGED, 0, 1)
    # 3 s^2 - 2 s^3
    return share**2 * (3 - 2 * share)


def _finger_channels(target: "Lifted | Squeezed") -> tuple[int, ...]:
    """Return the glove's joints of the fingers in contact."""
    fingers = {target.hand.links[link].finger for link in target.links}
    joints = [target.hand.joints[index] for index in target.glove.joint_indices]
    return tuple(k for k, joint in enumerate(joints) if joint.partition(" ")[0] in fingers)


def _felt_postures(target: "Lifted | Squeezed", is_felt) -> Float[np.ndarray, "P channels"]:
    """List the postures, along the flexion of the fingers' knuckles, in which it is felt."""
    direction = np.zeros(len(target.start))
    for k in target.channels():
        direction[k] = target.hand.joints[target.glove.joint_indices[k]].endswith(" MP")
    path = np.asarray(target.start) + np.linspace(0, MAX_FLEXION, 241)[:, None] * direction
    return path[np.asarray(jax.vmap(is_felt)(jnp.asarray(path)))]
