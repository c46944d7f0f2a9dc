"""Precision grip: fingertips alone hold an object, the thumb opposite the others, found by least squares."""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.hand.closing import ClosingKinematics, closing_kinematics, link_overlaps, phalanx_pairs, sphere_overlaps
from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.human_hand import is_human
from jaxgrasp.hand.kinematics import ancestry, pose_hand
from jaxgrasp.hand.shapes import Shape, check_shape, signed_distance
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.numerics.compiled_code import jit_quickly
from jaxgrasp.numerics.geometry import rotation_by
from jaxgrasp.numerics.small_minimisers import least_squares
from jaxgrasp.validation.checked import checked

CLEARANCE = 2e-3
"""Distance of all links but the fingertips from the object [m]."""
APART = 1e-3
"""Distance of fingertips from each other [m], where they are that far apart in the open hand."""
OPPOSED = 0.5
"""Least cosine of the angle between a finger's normal and the line to the thumb."""
PULP = 0.7
"""Least cosine of the angle between a contact's normal and the outward direction of the finger's palmar side."""
COUPLING = 2 / 3
"""Flexion of a finger's last joint by that of the previous joint, as tendons couple them (Rijpkema and Girard 1991)."""


class FingertipTask(eqx.Module):
    """Fingertips that are to touch an object, with their depth and joints."""

    hand: Hand
    shape: Shape
    depth: float | AnyArray
    """[m]"""
    closing: ClosingKinematics
    """Closing kinematics of the hand."""
    pulps: AnyArray
    """``(n, 3)`` Outward direction of each fingertip's palmar side, in its link's frame."""
    sides: AnyArray
    """``(n, 3)`` Sideways direction of each fingertip, in its link's frame."""
    clearances: AnyArray
    """``(P,)`` Least distance of each pair of phalanges of different fingers [m]."""
    fingers: tuple[str, ...] = eqx.field(static=True)
    """Names of the fingers, the thumb first."""
    tips: tuple[int, ...] = eqx.field(static=True)
    """Links of the fingertips."""
    joints: tuple[int, ...] = eqx.field(static=True)
    """Joints that move the fingertips."""
    flexions: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """Joints that close each finger, from the palm outwards."""

    @property
    def wrist(self) -> Pose:
        """Return the wrist's pose at the world's origin, palm down."""
        return Pose(jnp.zeros(3), jnp.asarray(self.closing.frame).T)

    @property
    def abductions(self) -> list[int]:
        """Return the fingers' joints that do not flex them."""
        flexing = {joint for chain in self.flexions for joint in chain}
        thumb = set(np.flatnonzero(ancestry(self.hand)[self.tips[0]]).tolist())
        return [joint for joint in self.joints if joint not in flexing | thumb]

    def flexion(self, angles: AnyArray, joints: Sequence[int]) -> AnyArray:
        """Return the flexion of joints from their open angles [rad]."""
        at = np.array(joints)
        ranges = jnp.asarray(self.closing.closed)[at] - jnp.asarray(self.closing.open)[at]
        return jnp.sign(ranges) * (angles[..., at] - jnp.asarray(self.closing.open)[at])


def fingertip_task(
    hand: Hand, shape: Shape, depth: float, fingers: tuple[str, ...], closing: ClosingKinematics
) -> FingertipTask:
    """Build the task of a hand's fingertips, the thumb's first.

    Raises:
        ValueError: for a hand that lacks one of these fingertips, or joints that bend it.
    """
    names, moves = [(link.finger, link.phalanx) for link in hand.links], ancestry(hand)
    missing_fingers = [finger for finger in fingers if (finger, "distal") not in names]
    if missing_fingers:
        raise ValueError(f"hand has no link {missing_fingers[0]} distal: expected links named as name_fingers does")
    tips = [names.index((finger, "distal")) for finger in fingers]
    is_closing = np.asarray(closing.closed) != np.asarray(closing.open)
    flexions = tuple(tuple(np.flatnonzero(moves[tip] & is_closing).tolist()) for tip in tips)
    for finger, chain in zip(fingers, flexions, strict=True):
        if len(chain) < 2:
            raise ValueError(f"{finger} has {len(chain)} joints that close it: expected at least two")
    open_posture = Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.asarray(closing.open))
    frames = jax.device_get(pose_hand(hand, open_posture))
    last = np.array([chain[-1] for chain in flexions])
    rotations, axes = frames.links.rotation[tips], frames.axes[last]
    tip_centers = frames.links.origin[tips] + np.einsum("tij,tj->ti", rotations, tip_ends(hand, tips))
    signs = np.sign(np.asarray(closing.closed) - np.asarray(closing.open))[last]
    towards = signs[:, None] * np.cross(axes, tip_centers - frames.joints.origin[last])
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    directions = [np.einsum("tij,ti->tj", rotations, direction) for direction in (towards, axes)]
    joints = tuple(np.flatnonzero(moves[tips].any(0)).tolist())
    pairs = phalanx_pairs(hand)
    # Fingertips stay apart, and other phalanges do not meet where they do not meet in the open hand.
    least = np.where(np.isin(pairs, tips).all(-1), APART, 0)
    clearances = jnp.minimum(least, -link_overlaps(hand, open_posture, pairs))
    return FingertipTask(
        hand, shape, depth, closing, directions[0], directions[1], clearances, fingers, tuple(tips), joints, flexions
    )


def tip_ends(hand: Hand, tips: list[int]) -> np.ndarray:
    """Return the centres ``(n, 3)`` of the spheres at the ends of links, in their frames."""
    centers, radii = np.asarray(hand.skin.centers)[tips], np.asarray(hand.skin.radii)[tips]
    furthest = np.argmax(np.where(radii > 0, np.linalg.norm(centers, axis=-1), -1), -1)
    return centers[np.arange(len(tips)), furthest]


class GripResiduals(NamedTuple):
    """Residuals of the demands of a precision grip; zero where a demand is met."""

    depth: AnyArray
    """``(n,)`` Depth of each fingertip beyond the required one [m]."""
    facing: AnyArray
    """``(2, 3)`` Thumb's normal less the direction from the thumb to the fingers, and the fingers' mean normal less the
    opposite direction."""
    opposing: AnyArray
    """``(n - 1,)`` Amount by which each finger's cosine is below ``OPPOSED``."""
    intrusion: AnyArray
    """``(L - n,)`` Amount by which the other links come closer to the object than ``CLEARANCE`` [m]."""
    overlap: AnyArray
    """``(P,)`` Amount by which phalanges of two fingers come closer than their ``clearances`` [m]."""
    pulp: AnyArray
    """``(n,)`` Amount by which the cosine is below ``PULP``."""
    side: AnyArray
    """``(n,)`` Sideways component of the normals."""
    coupling: AnyArray
    """``(n - 1,)`` Flexion of the last joints beyond the ``COUPLING`` [rad]."""
    spread: AnyArray
    """Abduction of the fingers [rad]: of all joints that do not close them."""


RESIDUAL_UNITS = {
    "depth": 5e-5,
    "facing": 0.03,
    "opposing": 0.03,
    "intrusion": 2e-4,
    "overlap": 2e-4,
    "pulp": 0.3,
    "side": 3.0,
    "coupling": 3.0,
    "spread": 1.5,
}
"""Unit of each residual: a unit of one counts as much as a unit of another. Depths are met, comfort is a preference."""


def grip_residuals(task: FingertipTask, angles: Array, placed: Pose) -> GripResiduals:
    """Compute the residuals of the demands, with the wrist at the world's origin, palm down.

    A fingertip is as deep as its deepest sphere, and in contact has the mean point and normal of its overlaps, as in
    [`jaxgrasp.hand.find_contacts`][]; without contact its sphere nearest to the object counts alone.
    """
    hand, tips = task.hand, np.array(task.tips)
    other_links = np.setdiff1d(np.arange(len(hand.links)), tips)
    links = pose_hand(hand, Posture(task.wrist, angles)).links
    centers = jnp.einsum("lij,lmj->lmi", links.rotation, hand.skin.centers) + links.origin[:, None]
    local = (centers - placed.origin) @ placed.rotation
    distances, out = signed_distance(task.shape, local)
    depths = hand.skin.radii - distances
    deepest = jax.nn.one_hot(jnp.argmax(depths[tips], -1), depths.shape[-1], dtype=depths.dtype)
    weights = _weights(depths[tips], deepest)
    points = jnp.einsum("tm,tmi->ti", weights, (local - distances[..., None] * out)[tips]) @ placed.rotation.T
    normals = -_unit(jnp.einsum("tm,tmi->ti", weights, out[tips])) @ placed.rotation.T
    along = _unit(jnp.mean(points[1:], 0) - points[0])
    rotations = links.rotation[tips]
    previous_joints, last_joints = zip(*(chain[-2:] for chain in task.flexions[1:]), strict=True)
    return GripResiduals(
        depth=jnp.sum(deepest * depths[tips], -1) - task.depth,
        facing=jnp.stack([normals[0] - along, _unit(jnp.mean(normals[1:], 0)) + along]),
        opposing=jnp.maximum(OPPOSED + normals[1:] @ along, 0),
        intrusion=jnp.maximum(jnp.max(depths[other_links], -1) + CLEARANCE, 0),
        overlap=jnp.maximum(sphere_overlaps(centers, hand.skin.radii, phalanx_pairs(hand)) + task.clearances, 0),
        pulp=jnp.maximum(PULP - jnp.einsum("tij,tj,ti->t", rotations, task.pulps, normals), 0),
        side=jnp.einsum("tij,tj,ti->t", rotations, task.sides, normals),
        coupling=task.flexion(angles, last_joints) - COUPLING * task.flexion(angles, previous_joints),
        spread=(angles - jnp.asarray(task.closing.open))[np.array(task.abductions, int)],
    )


def weighted_residuals(residuals: GripResiduals) -> Array:
    """Concatenate all residuals into one vector, in units of equal weight."""
    return jnp.concatenate([jnp.ravel(getattr(residuals, name)) / unit for name, unit in RESIDUAL_UNITS.items()])


def _weights(depths: Array, deepest: Array) -> Array:
    """Return the weights of a row's spheres in its contact; without contact the deepest, the nearest, alone counts."""
    square = jnp.maximum(depths, 0) ** 2
    total = jnp.sum(square, -1, keepdims=True)
    return jnp.where(total > 0, square / jnp.where(total > 0, total, 1), deepest)


def _unit(vectors: Array) -> Array:
    return vectors / jnp.linalg.norm(vectors, axis=-1, keepdims=True)


FINGERS = ("thumb", "index", "middle", "ring", "little")
PRESHAPES = ((25.0, 45.0, 65.0), (25.0, 50.0))
"""Start angles of the fingers' first and second flexion, in all combinations [degrees]."""
THUMB_ABDUCTIONS = (30.0, 50.0)
"""Start angles of a human thumb's abduction [degrees]."""
THUMB_SHARES = (0.5, 1.0)
"""Start positions of another hand's thumb, as a share of its closing motion, without its last two joints."""
THUMB_FLEXION = 20.0
"""Flexion of the thumb's last two joints at the start [degrees]."""
STEPS = 60
SHIFT = 0.05
"""Shift of the object that counts as much as a radian of a joint [m]."""
START_WEIGHT = 0.02
"""Weight of the distance from the start, which decides where the demands do not."""
DEPTH_TOLERANCE = 0.1
"""Allowed error of a depth, as a share of it."""
LINE_TOLERANCE = 0.2
"""Allowed error of unit normals from the line between thumb and fingers; friction 0.5 allows 0.46 rad."""


@checked
def precision_grip(
    hand: Hand, shape: Shape, fingers: int = 3, depth: float = 1e-3, closing: ClosingKinematics | None = None
) -> tuple[Posture, Pose, Contacts]:
    """Find a posture that holds an object by its fingertips, with the object's pose and the contacts.

    Joint angles within their limits and the object's pose are solved for together, by least squares from several
    preshapes: each fingertip presses to the required depth, the other links stay clear of the object and the fingers of
    one another, and the thumb's normal and the mean of the others are opposed along the line between them, so that
    their friction cones contain that line: Nguyen's condition of force closure (IJRR 7(3):3-16, 1988) for the thumb and
    one finger that stands for the others. Unused fingers are straight. The wrist is at the world's origin, palm down;
    the object's z axis lies about across the palm, its x axis about from the thumb to the fingers.

    Hands of 0.16 to 0.21 m reach round objects of 15 to 35 mm radius and boxes as thick, pressed 0.3 to 3 mm deep.
    The first call for a kind of shape and a number of fingers compiles, about 9 s; another takes one to two seconds.

    Args:
        hand: a human hand, or one whose links [`jaxgrasp.hand.name_fingers`][] has named, with a thumb.
        shape: shape of the object.
        fingers: number of fingers that touch, with the thumb: 3 (thumb, index, middle), 4, or 5.
        depth: depth of each fingertip in the object [m].
        closing: closing kinematics, from [`jaxgrasp.hand.closing_kinematics`][]; found by it where not given.

    Raises:
        ValueError: for a hand without palm and these fingers, another number of fingers, a shape of no volume, and an
            object that this hand does not hold so; the message names the unmet demands.
    """
    closing = closing_kinematics(hand) if closing is None else closing
    check_shape(shape)
    if fingers not in (3, 4, 5):
        raise ValueError(f"fingers is {fingers}: expected 3, 4 or 5, since fewer hard contacts do not hold an object")
    if not (np.isfinite(depth) and depth > 0):
        raise ValueError(f"depth is {depth}: expected a positive number [m]")
    task = fingertip_task(hand, shape, depth, FINGERS[:fingers], closing)
    angles, placed, residuals = jit_quickly(_solve)(task, *_preshapes(task))
    _check_reached(task, jax.device_get(residuals))
    posture = Posture(task.wrist, angles)
    return posture, placed, jit_quickly(find_contacts)(hand, posture, shape, placed)


def _preshapes(task: FingertipTask) -> tuple[np.ndarray, Pose]:
    """Return start angles ``(S, J)``, and the object's start pose midway between thumb and fingers."""
    starts = product(*PRESHAPES, _thumb_starts(task))
    angles = np.array([_preshape(task, flexion, bend, thumb) for flexion, bend, thumb in starts])
    posture, tips = Posture(task.wrist, angles), list(task.tips)
    links = jax.device_get(pose_hand(task.hand, posture).links)
    tip_centers = np.einsum("stij,tj->sti", links.rotation[:, tips], tip_ends(task.hand, tips)) + links.origin[:, tips]
    thumb, fingers_mean = tip_centers[:, 0], tip_centers[:, 1:].mean(1)
    x = fingers_mean - thumb
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    # z is the direction across the palm, towards the little finger of a right hand, made orthogonal to x.
    z = x[:, 1:2] * x - np.array([0.0, 1.0, 0.0])
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    return angles, Pose((thumb + fingers_mean) / 2, np.stack([x, np.cross(z, x), z], -1))


def _preshape(task: FingertipTask, flexion: float, bend: float, thumb: dict[int, float]) -> np.ndarray:
    """Return angles ``(J,)`` with fingers bent by these amounts [degrees], and the thumb's joints at these angles
    [rad]."""
    bends = dict.fromkeys(task.flexions[0][-2:], THUMB_FLEXION)
    for chain in task.flexions[1:]:
        first, *middle, last = chain
        bends |= {first: flexion, last: COUPLING * bend, **dict.fromkeys(middle, bend)}
    angles = np.asarray(task.closing.open).copy()
    for joint, angle in thumb.items():
        angles[joint] = angle
    for joint, angle in bends.items():
        angles[joint] += np.sign(task.closing.closed[joint] - task.closing.open[joint]) * np.radians(angle)
    angles = np.clip(angles, np.asarray(task.hand.lower), np.asarray(task.hand.upper))
    return angles if task.hand.coupling is None else np.asarray(task.hand.coupling.angles(angles))


def _thumb_starts(task: FingertipTask) -> list[dict[int, float]]:
    """Return start angles of the thumb's first joints [rad]."""
    if is_human(task.hand):
        return [{task.hand.joints.index("thumb abduction"): float(np.radians(a))} for a in THUMB_ABDUCTIONS]
    first = task.flexions[0][:-2]
    ranges = np.asarray(task.closing.closed) - np.asarray(task.closing.open)
    return [
        {joint: float(task.closing.open[joint] + share * ranges[joint]) for joint in first} for share in THUMB_SHARES
    ]


def _solve(task: FingertipTask, angles: AnyArray, placed: Pose) -> tuple[Array, Pose, GripResiduals]:
    """Minimise the residuals from all starts; return the best angles, the object's pose, and the remaining
    residuals."""
    free = np.array(task.joints)
    middle, half = (task.hand.upper + task.hand.lower)[free] / 2, (task.hand.upper - task.hand.lower)[free] / 2

    def decode(angles: Array, placed: Pose, unknowns: Array) -> tuple[Array, Pose]:
        # Angles are sines of the unknowns, which keeps them within the limits.
        solved_angles = angles.at[free].set(middle + half * jnp.sin(unknowns[:-6]))
        if task.hand.coupling is not None:
            solved_angles = task.hand.coupling.angles(solved_angles)
        shift, turn = unknowns[-6:-3], unknowns[-3:]
        return solved_angles, Pose(placed.origin + SHIFT * shift, rotation_by(turn) @ placed.rotation)

    def search(angles: Array, placed: Pose):
        phases = jnp.arcsin(jnp.clip((angles[free] - middle) / half, -0.95, 0.95))
        start = jnp.append(phases, jnp.zeros(6))

        def residuals(unknowns: Array) -> Array:
            return jnp.append(
                weighted_residuals(grip_residuals(task, *decode(angles, placed, unknowns))),
                START_WEIGHT * (unknowns - start),
            )

        result = least_squares(residuals, start, STEPS)
        return result.cost, decode(angles, placed, result.point)

    costs, solutions = jax.vmap(search)(jnp.asarray(angles), jax.tree.map(jnp.asarray, placed))
    solved_angles, pose = jax.tree.map(lambda x: x[jnp.nanargmin(costs)], solutions)
    return solved_angles, pose, grip_residuals(task, solved_angles, pose)


def _check_reached(task: FingertipTask, residuals: GripResiduals) -> None:
    """Raise ValueError that names the unmet demands, the first of each type."""
    links = [link.name for link in task.hand.links]
    tips = [links[i] for i in task.tips]
    other_names = [name for i, name in enumerate(links) if i not in task.tips]
    unmet = [
        f"{name} is {1e3 * abs(error):.1f} mm too {'deep' if error > 0 else 'far'}"
        for name, error in zip(tips, residuals.depth, strict=True)
        if not abs(error) <= DEPTH_TOLERANCE * task.depth
    ]
    unmet += [
        f"{name} is in the way"
        for name, intrusion in zip(other_names, residuals.intrusion, strict=True)
        if intrusion >= CLEARANCE
    ]
    if not residuals.overlap.max() <= APART:
        first, second = (links[i] for i in phalanx_pairs(task.hand)[residuals.overlap.argmax()])
        unmet.append(f"{first} and {second} have too little room")
    if not max(*np.linalg.norm(residuals.facing, axis=-1), *residuals.opposing) <= LINE_TOLERANCE:
        unmet.append("the thumb cannot oppose the fingers")
    if unmet:
        raise ValueError(
            f"no precision grip of {len(tips)} fingers on this {type(task.shape).__name__} was found: "
            f"{', '.join(unmet)}"
        )
