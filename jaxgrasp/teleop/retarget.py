"""Retargeting: from a person's fingertips to the joints of a robot hand, by damped least squares.

Minimises, with x_f the robot's fingertips and y_f their targets, both in the palm's frame,

    sum_f |x_f(q) - y_f|^2 + sum_f w_f |x_thumb(q) - x_f(q) - e_f|^2 + m |q - q_last|^2

over the joints q within their limits. The pinch targets e_f keep the distance between thumb and finger, which is zero
where the person's thumb touches that finger; their weight grows as the distance falls. A few Gauss-Newton steps from
the last answer, all in one compiled function, which JAX can differentiate.

The objective of dex-retargeting (Qin et al., AnyTeleop, RSS 2023) is the first and the last term, with a Huber loss.
"""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.hand.closing import closing_kinematics
from jaxgrasp.hand.kinematics import contact_jacobian, pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.validation.checked import checked

STEPS = 2
"""Gauss-Newton steps of a call."""
DAMPING = 1e-6
"""Weight of the change of the angles within a step [m2/rad2]."""
PERSISTENCE = 2e-6
"""Weight m of the change since the last call [m2/rad2]."""
PINCH_WEIGHT = 4.0
"""Weight of a pinch target where thumb and finger touch."""
PINCH_RANGE = 0.03
"""Distance at which that weight has fallen to a half [m]."""


class Fingertips(NamedTuple):
    """Fingertips of a hand: the ball of each distal link that is furthest from its joint."""

    links: tuple[int, ...]
    centers: Float[np.ndarray, "F 3"]
    """Centres of the balls in their links' frames [m]."""
    radii: Float[np.ndarray, "F"]
    """[m]"""


def find_fingertips(hand: Hand, fingers: tuple[str, ...]) -> Fingertips:
    """Find the fingertips of fingers by name.

    Raises:
        ValueError: for a finger of which the hand has no distal link.
    """
    names = [link.name for link in hand.links]
    links, centers, radii = [], [], []
    for finger in fingers:
        if f"{finger} distal" not in names:
            raise ValueError(f"the hand has no link {finger!r} distal: expected one of its fingers, {', '.join(names)}")
        link = names.index(f"{finger} distal")
        rows, sizes = np.asarray(hand.skin.centers[link]), np.asarray(hand.skin.radii[link])
        k = int(np.argmax(np.where(sizes > 0, np.linalg.norm(rows, axis=-1), -1.0)))
        links.append(link)
        centers.append(rows[k])
        radii.append(float(sizes[k]))
    return Fingertips(tuple(links), np.array(centers), np.array(radii))


def tip_positions(hand: Hand, tips: Fingertips, angles: Float[AnyArray, "J"]) -> Float[Array, "F 3"]:
    """Compute the positions of fingertips in the wrist's frame [m]."""
    return _tips_and_jacobian(hand, tips, angles)[0]


def _tips_and_jacobian(hand: Hand, tips: Fingertips, angles: AnyArray) -> tuple[Array, Array]:
    """Compute fingertips ``(F, 3)`` in the wrist's frame and their Jacobian ``(F, 3, J)``."""
    frames = pose_hand(hand, Posture(Pose(jnp.zeros(3), jnp.eye(3)), angles))
    links = np.array(tips.links)
    rotations, origins = frames.links.rotation[links], frames.links.origin[links]
    positions = origins + jnp.einsum("fij,fj->fi", rotations, jnp.asarray(tips.centers))
    points = jnp.zeros((len(hand.links), 3), positions.dtype).at[links].set(positions)
    return positions, contact_jacobian(hand, frames, points)[links]


class Calibration(eqx.Module):
    """Map from a person's fingertips to targets of a robot's fingertips: per finger y = base + R s (x - knuckle)."""

    axes: Float[AnyArray, "3 3"]
    """R: the person's wrist axes in the frame of the robot's palm, as columns."""
    scales: Float[AnyArray, "F"]
    """s: length of the robot's finger per length of the person's."""
    person_bases: Float[AnyArray, "F 3"]
    """Knuckles of the person's fingers in the wrist's frame [m]."""
    robot_bases: Float[AnyArray, "F 3"]
    """Knuckles of the robot's fingers in the palm's frame [m]."""
    touch_gaps: Float[AnyArray, "F"]
    """Distance between the measured tips of thumb and finger where they touch [m]; 0 for the thumb itself."""
    robot_touch_gaps: Float[AnyArray, "F"]
    """Distance between the robot's fingertip centres where they touch [m]; 0 for the thumb itself."""

    def targets(self, tips: Float[AnyArray, "F 3"]) -> Float[Array, "F 3"]:
        """Compute the targets of the robot's fingertips [m]."""
        spread = jnp.asarray(self.scales)[:, None] * (jnp.asarray(tips) - self.person_bases)
        return jnp.asarray(self.robot_bases) + spread @ jnp.asarray(self.axes).T


class Retargeting:
    """Retargeting of a person's hand to a robot's; call it with the person's angles, again and again."""

    def __init__(
        self,
        person: Hand,
        robot: Hand,
        fingers: tuple[str, ...],
        *,
        open: Mapping[str, float] | None = None,
        wearer: Hand | None = None,
    ):
        """Fit a person's hand to a robot's by the lengths of their fingers, without a calibration by touch.

        Args:
            person: human hand, such as [`jaxgrasp.hand.human_hand`][] builds.
            robot: named as by [`jaxgrasp.hand.name_fingers`][].
            fingers: fingers of both hands, the thumb first.
            open: angles of the robot's open hand, by joint [rad]; as near to zero as the limits let them otherwise.
            wearer: hand whose knuckles and lengths of fingers count, where ``person`` is a linkage on that hand
                ([`jaxgrasp.hand.doglove_hand`][]); ``person`` itself where not given.

        Raises:
            ValueError: for fingers that one of the hands lacks, or of which the thumb is not the first.
        """
        if fingers[:1] != ("thumb",) or len(fingers) < 2:
            raise ValueError(f"fingers is {fingers}: expected the thumb first, and one more at least")
        self.person, self.robot, self.fingers = person, robot, fingers
        self._person_tips, self._robot_tips = (find_fingertips(hand, fingers) for hand in (person, robot))
        wearer = person if wearer is None else wearer
        start, closing = closing_kinematics(wearer), closing_kinematics(robot, open=open)
        self.open = np.asarray(closing.open, float)
        """Angles of the robot's open hand [rad]."""
        person_bases, person_reach = _reaches(wearer, start.open, fingers, find_fingertips(wearer, fingers))
        robot_bases, robot_reach = _reaches(robot, closing.open, fingers, self._robot_tips)
        radii = self._robot_tips.radii
        self.calibration = Calibration(
            np.asarray(closing.frame) @ np.asarray(start.frame).T,
            robot_reach / person_reach,
            person_bases,
            robot_bases,
            np.append(0.0, self._person_tips.radii[0] + self._person_tips.radii[1:]),
            np.append(0.0, radii[0] + radii[1:]),
        )
        self._compile()
        self._tips = jax.jit(lambda angles: tip_positions(person, self._person_tips, angles))
        self.reset()

    def reset(self) -> None:
        """Begin anew from the robot's open hand."""
        self.angles = self.open.copy()
        """Last answer: the robot's angles [rad]."""

    def __call__(self, person_angles: Float[np.ndarray, "P"]) -> Float[np.ndarray, "J"]:
        """Compute the robot's angles ``(J,)`` [rad] for the person's [rad], from the last answer on."""
        self.angles = np.asarray(self._program(person_angles, self.angles))
        return self.angles

    def solve(self, person_angles: Float[AnyArray, "P"], last: Float[AnyArray, "J"]) -> Float[Array, "J"]:
        """Compute the robot's angles from given last ones; may be differentiated by both."""
        return self._program(person_angles, last)

    def person_tips(self, person_angles: Float[np.ndarray, "P"]) -> Float[np.ndarray, "F 3"]:
        """Compute the person's fingertips in the wrist's frame [m]."""
        return np.asarray(self._tips(person_angles))

    def robot_tips(self, angles: Float[np.ndarray, "J"]) -> Float[np.ndarray, "F 3"]:
        """Compute the robot's fingertips in the palm's frame [m]."""
        return np.asarray(tip_positions(self.robot, self._robot_tips, angles))

    def calibrate(self, touches: Mapping[str, Float[np.ndarray, "P"]]) -> None:
        """Calibrate by touch: the person's angles while the thumb touches a finger, by that finger's name.

        The distance of the two measured tips is that of a touch from then on, whatever errors glove and hand model
        have; fingers that are not named keep theirs.

        Raises:
            ValueError: for a finger that is not retargeted, the thumb, or angles that are not one for each joint.
        """
        gaps = np.array(self.calibration.touch_gaps)
        for finger, angles in touches.items():
            if finger not in self.fingers[1:]:
                raise ValueError(f"touches has {finger!r}: expected {', '.join(self.fingers[1:])}")
            if np.shape(angles) != (len(self.person.joints),) or not np.isfinite(angles).all():
                raise ValueError(f"touches[{finger!r}] is no finite angle for each of {len(self.person.joints)} joints")
            tips = self.person_tips(np.asarray(angles, float))
            k = self.fingers.index(finger)
            gaps[k] = np.linalg.norm(tips[0] - tips[k])
        self.calibration = eqx.tree_at(lambda c: c.touch_gaps, self.calibration, gaps)
        self._compile()

    def _compile(self) -> None:
        """Compile the program of a call, with the calibration as constants: arguments would cost a fifth more."""
        calibration = self.calibration

        def solve(person_angles: AnyArray, last: AnyArray) -> Array:
            tips = tip_positions(self.person, self._person_tips, person_angles)
            return solve_angles(self.robot, self._robot_tips, calibration, tips, last)

        self._program = jax.jit(solve)


@checked
def solve_angles(
    robot: Hand,
    robot_tips: Fingertips,
    calibration: Calibration,
    person_tips: Float[AnyArray, "F 3"],
    last: Float[AnyArray, "J"],
) -> Float[Array, "J"]:
    """Compute a robot's angles for a person's fingertips by ``STEPS`` Gauss-Newton steps from the last angles.

    Args:
        robot: its hand; joints that follow others keep its coupling.
        robot_tips: its fingertips, the thumb's first.
        calibration: map of the fingertips.
        person_tips: in the wrist's frame [m].
        last: angles to begin from [rad].
    """
    targets = calibration.targets(person_tips)
    between = targets[0] - targets[1:]
    distances = jnp.linalg.norm(jnp.asarray(person_tips)[0] - jnp.asarray(person_tips)[1:], axis=-1)
    free_gaps = jnp.maximum(distances - jnp.asarray(calibration.touch_gaps)[1:], 0.0)
    gap_targets = free_gaps * jnp.asarray(calibration.scales)[1:] + jnp.asarray(calibration.robot_touch_gaps)[1:]
    pinch_targets = between * (gap_targets / jnp.linalg.norm(between, axis=-1))[:, None]
    pinch_weights = PINCH_WEIGHT / (1 + (free_gaps / PINCH_RANGE) ** 2)
    coupling = robot.coupling
    free = np.arange(len(robot.joints)) if coupling is None else np.array(coupling.independent)
    matrix = jnp.eye(len(free)) if coupling is None else jnp.asarray(coupling.matrix)
    lower, upper = (jnp.asarray(bound)[free] for bound in (robot.lower, robot.upper))
    begin = jnp.asarray(last)[free]

    def all_angles(independent: Array) -> Array:
        return independent if coupling is None else matrix @ independent + coupling.offset

    angles = begin
    for _ in range(STEPS):
        positions, jacobian = _tips_and_jacobian(robot, robot_tips, all_angles(angles))
        jacobian = jacobian @ matrix
        residual = positions - targets
        pinch_residual = positions[0] - positions[1:] - pinch_targets
        pinch_jacobian = jacobian[0] - jacobian[1:]
        normal = jnp.einsum("fij,fik->jk", jacobian, jacobian)
        normal += jnp.einsum("f,fij,fik->jk", pinch_weights, pinch_jacobian, pinch_jacobian)
        gradient = jnp.einsum("fij,fi->j", jacobian, residual)
        gradient += jnp.einsum("f,fij,fi->j", pinch_weights, pinch_jacobian, pinch_residual)
        gradient += PERSISTENCE * (angles - begin)
        # A joint at its limit that is pushed outwards takes no part in the step.
        is_free = ~((angles <= lower) & (gradient > 0) | (angles >= upper) & (gradient < 0))
        normal = jnp.where(is_free[:, None] & is_free, normal, 0.0) + (DAMPING + PERSISTENCE) * jnp.eye(len(free))
        step = jnp.linalg.solve(normal, jnp.where(is_free, -gradient, 0.0))
        angles = jnp.clip(angles + step, lower, upper)
    return all_angles(angles)


def _reaches(hand: Hand, angles: AnyArray, fingers: tuple[str, ...], tips: Fingertips) -> tuple[np.ndarray, np.ndarray]:
    """Return the origins ``(F, 3)`` of the fingers' first joints, and their lengths to the tip ``(F,)`` [m]."""
    frames = jax.device_get(pose_hand(hand, Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.asarray(angles))))
    names = [(link.finger, link.phalanx) for link in hand.links]
    origins = np.asarray(frames.joints.origin)
    bases, lengths = [], []
    for k, finger in enumerate(fingers):
        # The thumb turns about its metacarpal's joint, a finger about its knuckle.
        first = "metacarpal" if finger == "thumb" and ("thumb", "metacarpal") in names else "proximal"
        joint = hand.links[names.index((finger, first))].joint
        chain, base = [hand.links[tips.links[k]].joint], origins[joint]
        while chain[-1] != joint and hand.parents[chain[-1]] >= 0:
            chain.append(hand.parents[chain[-1]])
        link = tips.links[k]
        tip = frames.links.origin[link] + frames.links.rotation[link] @ tips.centers[k]
        points = np.array([tip, *(origins[j] for j in chain)])
        bases.append(base)
        lengths.append(np.linalg.norm(np.diff(points, axis=0), axis=-1).sum())
    return np.array(bases), np.array(lengths)
