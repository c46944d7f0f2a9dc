"""What the psychophysics lets a hand in a glove feel: a weight that it lifts, a stiffness that it squeezes, a torque.

Each is a law of resistance: torques at the glove's joints from their angles and an intensity. The weight is that of
Fig. 8: a bar on the fingers, held to the vertical, in a hand whose palm looks up.
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
from jaxgrasp.lab.haptic_loop import law_of
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Hand, HandFrames, Pose
from jaxgrasp.psychophysics.plan import StimulusPlan
from jaxgrasp.validation.checked import checked

TRAVEL = 0.04
"""Travel of the bar, upwards (section III-C) [m]."""
ENGAGED = 0.001
"""Height over which the bar's weight passes from its rest to the fingers [m]."""
STOP = 2000.0
"""Stiffness of the end of its travel [N/m]."""
SQUEEZED = 0.01
"""Depth to which an object is squeezed [m]; its stiffness is felt on the way there."""
WIDTH = 0.07
"""Width of the squeezed object, that of the paper's cube [m]."""
FRICTION = 0.6
BENT = {"PIP": 0.25, "DIP": 0.15}
"""How fingers that lift are bent at the outset [rad]."""
CURLED = {"MP": 0.5, "PIP": 0.5, "DIP": 0.25}
"""How fingers that squeeze are bent at the outset [rad]."""
MOST_BENT = 1.2
"""How far knuckles are bent in search of the whole travel [rad]."""

PALM_UP = Pose(np.zeros(3), np.diag([1.0, -1.0, -1.0]))


class FeltTick(NamedTuple):
    """What is felt of an intensity at one instant."""

    law: TorqueLaw
    share: float
    """How much of the intensity is felt, from 0 to 1."""
    is_alone: bool
    """Whether nothing but the intensity is felt, such as the end of a travel."""


class Rendering(ABC):
    """How intensities are rendered, one after another, by one thread."""

    @abstractmethod
    def begin(self, intensity: float) -> None:
        """Render this one from now on."""

    @abstractmethod
    def tick(self, now: float, angles: Float[np.ndarray, "channels"]) -> FeltTick:
        """What the glove is to do, at a time [s] and angles [rad]."""

    @abstractmethod
    def on_the_way(self, intensity: float) -> Float[np.ndarray, "P channels"]:
        """Torques that it asks for in all the postures in which a person feels it [N.m]."""


class FeltObject(eqx.Module):
    """Something with an intensity, felt by some joints of a glove."""

    @abstractmethod
    def resistance(
        self, angles: Float[AnyArray, "channels"], intensity: Float[AnyArray, ""] | float
    ) -> Float[Array, "channels"]:
        """Torques against flexion [N.m]."""

    @abstractmethod
    def postures(self) -> Float[np.ndarray, "P channels"]:
        """Angles that a person goes through who feels it [rad]."""

    @abstractmethod
    def channels(self) -> tuple[int, ...]:
        """Those joints of the glove that move where a person does what it takes to feel it."""

    @abstractmethod
    def share(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        """How much of the intensity is felt there, from 0 to 1."""

    def is_alone(self, angles: Float[AnyArray, "channels"]) -> Bool[Array, ""]:
        """Whether nothing but the intensity is felt there, such as the end of a travel."""
        return jnp.asarray(True)


class Lifted(FeltObject):
    """A weight [N] on the same phalanx of some fingers."""

    hand: Hand
    worn: GloveHand
    links: tuple[int, ...] = eqx.field(static=True)
    start: Float[AnyArray, "channels"]
    """Angles at which the bar rests [rad]."""

    def height(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        """Height of the bar above its rest [m]."""
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
        return _resisting(self.hand, self.worn, self.links, frames, grasp, wrench, jnp.eye(6)[:, 2:3])

    def share(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        return passed_over(self.height(angles))

    def channels(self) -> tuple[int, ...]:
        return _fingers_channels(self)

    def is_alone(self, angles: Float[AnyArray, "channels"]) -> Bool[Array, ""]:
        return self.height(angles) <= TRAVEL

    def postures(self) -> Float[np.ndarray, "P channels"]:
        return _within(self, lambda angles: (self.height(angles) > ENGAGED) & (self.height(angles) <= TRAVEL))

    def pads(self, angles: Float[AnyArray, "channels"]) -> tuple[HandFrames, Array]:
        """The posed hand, and where the bar lies on each finger ``(n, 3)`` [m]."""
        frames = pose_hand(self.hand, self.worn.posture(jnp.asarray(angles), PALM_UP))
        centres, radii = _pads(self.hand, frames, self.links)
        return frames, centres + radii[:, None] * jnp.array([0.0, 0.0, 1.0])


class Squeezed(FeltObject):
    """A stiffness [N/m] between some fingers and a thumb that stands against them."""

    hand: Hand
    worn: GloveHand
    links: tuple[int, ...] = eqx.field(static=True)
    start: Float[AnyArray, "channels"]
    """Angles at which fingers touch it [rad]."""

    def depths(self, angles: Float[AnyArray, "channels"]) -> Float[Array, "n"]:
        """How far each finger has gone in [m]."""
        _, centres = self.pads(angles)
        _, touching = self.pads(self.start)
        return (centres - touching) @ self.inward()

    def resistance(
        self, angles: Float[AnyArray, "channels"], intensity: Float[AnyArray, ""] | float
    ) -> Float[Array, "channels"]:
        frames, points = self.pads(angles)
        inward = self.inward()
        squeeze = intensity * jnp.maximum(self.depths(angles), 0)
        # The thumb stands opposite, where the fingers' forces have no moment about it, and takes their sum.
        total = jnp.sum(squeeze)
        middle = jnp.where(total > 0, squeeze @ points / jnp.where(total > 0, total, 1), points.mean(0))
        points = jnp.vstack([points, middle + WIDTH * inward])
        normals = jnp.vstack([jnp.broadcast_to(inward, (len(self.links), 3)), -inward])
        all_of_them = jnp.append(squeeze, total)
        grasp = Grasp(points, normals, jnp.full(len(all_of_them), FRICTION), all_of_them)
        free = jnp.append(inward, jnp.zeros(3))[:, None]
        return _resisting(self.hand, self.worn, self.links, frames, grasp, jnp.zeros(6), free)

    def share(self, angles: Float[AnyArray, "channels"]) -> Float[Array, ""]:
        # A stiffness is felt as soon as there is a depth; the force of the first touch tells nothing of it.
        return passed_over(jnp.mean(self.depths(angles)))

    def channels(self) -> tuple[int, ...]:
        return _fingers_channels(self)

    def postures(self) -> Float[np.ndarray, "P channels"]:
        return _within(self, lambda angles: (self.depths(angles).mean() > 0) & (self.depths(angles).max() <= SQUEEZED))

    def inward(self) -> Float[Array, "3"]:
        """Where the pads look at the outset: from the fingers into the object."""
        frames = pose_hand(self.hand, self.worn.posture(jnp.asarray(self.start), PALM_UP))
        looks = -frames.links.rotation[np.array(self.links), :, 2].mean(0)
        return looks / jnp.linalg.norm(looks)

    def pads(self, angles: Float[AnyArray, "channels"]) -> tuple[HandFrames, Array]:
        """The posed hand, and where each finger touches ``(n, 3)`` [m]."""
        frames = pose_hand(self.hand, self.worn.posture(jnp.asarray(angles), PALM_UP))
        centres, radii = _pads(self.hand, frames, self.links)
        outward = -frames.links.rotation[np.array(self.links), :, 2]
        return frames, centres + radii[:, None] * outward


class Resisted(FeltObject):
    """A torque [N.m] on one joint, whatever its angle."""

    channel: int = eqx.field(static=True)
    count: int = eqx.field(static=True)
    """Joints of the glove."""

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
    """A felt object's own law: its torques at the angles of the instant, whatever was before."""

    def __init__(self, felt: FeltObject) -> None:
        self._felt, self._intensity = felt, 0.0
        self._postures = felt.postures()

    def begin(self, intensity: float) -> None:
        self._intensity = intensity

    def tick(self, now: float, angles: Float[np.ndarray, "channels"]) -> FeltTick:
        law = law_of(now, angles, resistance_and_slope(self._felt, angles, self._intensity))
        share, alone = jax.device_get(share_and_alone(self._felt, angles))
        return FeltTick(law, float(share), bool(alone))

    def on_the_way(self, intensity: float) -> Float[np.ndarray, "P channels"]:
        return np.asarray(resistances(self._felt, self._postures, intensity))


@checked
def felt_object(plan: StimulusPlan, model: GloveModel, hand: Hand | None = None) -> FeltObject:
    """What a plan lets a hand in a glove feel.

    Args:
        plan: of the stimulus.
        model: of the glove.
        hand: a human one; of middling size if None.

    Raises:
        ValueError: for a glove that pulls on none of its joints, or a joint that it does not pull on.
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
            raise ValueError(f"fingers[{k}] is {finger!r}, on whose MP joint {model.name} does not pull")
    start = open_angles(hand)
    bent = BENT if plan.kind == "weight" else CURLED
    for k, joint in enumerate(hand.joints):
        finger, _, kind = joint.partition(" ")
        if finger != "thumb":
            start[k] = bent.get(kind, start[k])
    names = [link.name for link in hand.links]
    links = tuple(names.index(f"{finger} {plan.phalanx}") for finger in plan.fingers)
    worn = glove_hand(hand, model, start)
    made = Lifted if plan.kind == "weight" else Squeezed
    return made(hand, worn, links, jnp.asarray(start[list(worn.places)]))


@jax.jit
def resistance_and_slope(
    felt: FeltObject, angles: Float[AnyArray, "channels"], intensity: Float[AnyArray, ""] | float
) -> tuple[Float[Array, "channels"], Float[Array, "channels channels"]]:
    """Torques against flexion [N.m], and their exact derivative by the angles [N.m/rad]."""

    return with_slope(lambda at: felt.resistance(at, intensity), angles)


@jax.jit
def share_and_alone(felt: FeltObject, angles: Float[AnyArray, "channels"]) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """How much of the intensity is felt, and whether it alone; compiled once for all instants."""
    return felt.share(angles), felt.is_alone(angles)


@jax.jit
def resistances(
    felt: FeltObject, angles: Float[AnyArray, "P channels"], intensity: Float[AnyArray, ""] | float
) -> Float[Array, "P channels"]:
    """Torques against flexion in many postures."""
    return jax.vmap(lambda one: felt.resistance(one, intensity))(jnp.asarray(angles))


def _pads(hand: Hand, frames: HandFrames, links: tuple[int, ...]) -> tuple[Array, Array]:
    """Centres and radii of the spheres in the middle of links."""
    index = np.array(links)
    centres = jnp.asarray(hand.skin.centers)[index, LEAVES // 2]
    turned = jnp.einsum("lij,lj->li", frames.links.rotation[index], centres)
    return frames.links.origin[index] + turned, jnp.asarray(hand.skin.radii)[index, LEAVES // 2]


def _resisting(
    hand: Hand,
    worn: GloveHand,
    links: tuple[int, ...],
    frames: HandFrames,
    grasp: Grasp,
    wrench: Float[AnyArray, "6"],
    free: Float[AnyArray, "6 1"],
) -> Float[Array, "channels"]:
    """Torques at the glove's joints from method B's forces on a guided object, whose first contacts are the links'."""
    forces = applied_forces(closed_form(grasp, wrench, free=free)).forces
    index, count = np.array(links), len(links)
    points = jnp.zeros((len(hand.links), 3)).at[index].set(grasp.points[:count])
    on_links = jnp.zeros((len(hand.links), 3)).at[index].set(forces[:count])
    return worn.resisting(joint_torques(hand, frames, points, on_links))


@jax.jit
def passed_over(way: Float[Array, ""]) -> Float[Array, ""]:
    """From 0 to 1 over a short way [m]; smooth, so that the law has a slope wherever the hand is."""
    share = jnp.clip(way / ENGAGED, 0, 1)
    return share**2 * (3 - 2 * share)


def _fingers_channels(felt: "Lifted | Squeezed") -> tuple[int, ...]:
    """The glove's joints of the fingers that bear it."""
    fingers = {felt.hand.links[link].finger for link in felt.links}
    joints = [felt.hand.joints[place] for place in felt.worn.places]
    return tuple(k for k, joint in enumerate(joints) if joint.partition(" ")[0] in fingers)


def _within(felt: "Lifted | Squeezed", is_felt) -> Float[np.ndarray, "P channels"]:
    """Postures on the way as the knuckles of its fingers bend, where it is felt."""
    moved = np.zeros(len(felt.start))
    for k in felt.channels():
        moved[k] = felt.hand.joints[felt.worn.places[k]].endswith(" MP")
    path = np.asarray(felt.start) + np.linspace(0, MOST_BENT, 241)[:, None] * moved
    return path[np.asarray(jax.vmap(is_felt)(jnp.asarray(path)))]
