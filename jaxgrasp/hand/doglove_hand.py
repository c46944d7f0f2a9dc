"""The linkage of a DOGlove as a hand: five chains over the back of the hand, each with a cap on its fingertip.

Joint places and limits are facts of the published model (https://github.com/TEA-Lab/DOGlove,
``DOGlove_meshes/DOGlove_Ver20241223.urdf`` and ``DOGlove-v3.xml``): the split axes of the fingers stand 26 mm apart,
and a fingertip 45 mm beyond its chain's last joint, 50 mm beyond the thumb's. As there, angles are zero where a chain
is straight. Ours are: the radius of a cap, and where a person's wrist is under the device.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.hand.human_hand import TOWARDS_THUMB, mirrored
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Link, Pose, Posture, Spheres
from jaxgrasp.numerics.small_minimisers import least_squares
from jaxgrasp.validation.checked import checked

FINGERS = ("thumb", "index", "middle", "ring", "little")
CAP_RADIUS = 0.008
"""Radius of a cap, whose centre is the published model's fingertip [m]."""
WRIST = (-0.008, 0.0, 0.02)
"""Place of a person's wrist in the device's frame [m]: so that the middle knuckle of a hand of middling size is 28 mm
under the axis of its servo."""
SPLIT = (0.031642, 0.0, 0.085)
"""Split axis of the middle finger in the device's frame [m]."""
SPACING = {"index": 0.026, "middle": 0.0, "ring": -0.026, "little": -0.052}
"""Distance of each finger's split axis from the middle finger's, towards the thumb [m]."""
SERVO = (0.045, 0.0, -0.0365)
"""Axis of a finger's servo from its split axis [m]."""
BARS = {"index": (0.070, 0.060), "middle": (0.078, 0.065), "ring": (0.073, 0.060), "little": (0.065, 0.055)}
"""Lengths of a finger's bars, from the servo's axis to the middle joint and to the last one [m]."""
TIP, THUMB_TIP = 0.045, 0.050
"""Distance of the fingertip from the last joint [m]."""
THUMB_BASE = (-0.009156, 0.031142, 0.0475)
"""Origin of the thumb's rotation in the device's frame [m]; its axis points forward and to the radial side."""
LIMITS = {
    "abduction": (-1.57, 1.57),
    "index MP": (-1.16, 1.57),
    "middle MP": (-1.15, 1.57),
    "ring MP": (-1.15, 1.57),
    "little MP": (-1.14, 1.57),
    "index PIP": (0.0, 2.61),
    "middle PIP": (0.0, 2.44),
    "ring PIP": (0.0, 2.61),
    "little PIP": (0.0, 2.44),
    "DIP": (0.0, 2.09),
    "thumb rotation": (-1.57, 3.14),
    "thumb CM": (-1.54, 1.57),
    "thumb PIP": (0.0, 2.44),
    "thumb IP": (0.0, 1.83),
}
"""Least and largest angles by joint, or by kind of joint [rad]."""


class _Hinge(NamedTuple):
    name: str
    origin: tuple[float, float, float]
    """In the frame of the joint before it, or the device's [m]."""
    axis: tuple[float, float, float]


_FLEXES = (0.0, 1.0, 0.0)
# Frames have x along the chain and z out of the back of the hand: flexion turns x towards the palm.
_THUMB = (
    _Hinge("thumb rotation", THUMB_BASE, (-1.0, 0.0, 0.0)),
    _Hinge("thumb abduction", (0.0, 0.031, 0.0075), (0.0, 0.0, 1.0)),
    _Hinge("thumb CM", (0.040, 0.0, -0.0045), _FLEXES),
    _Hinge("thumb PIP", (0.050, 0.002, 0.0), _FLEXES),
    _Hinge("thumb IP", (0.040, -0.002, 0.0), _FLEXES),
)


def _finger(name: str) -> tuple[_Hinge, ...]:
    first, second = BARS[name]
    x, y, z = SPLIT
    return (
        _Hinge(f"{name} abduction", (x, y + SPACING[name], z), (0.0, 0.0, float(TOWARDS_THUMB[name]))),
        _Hinge(f"{name} MP", SERVO, _FLEXES),
        _Hinge(f"{name} PIP", (first, 0.0, 0.0), _FLEXES),
        _Hinge(f"{name} DIP", (second, 0.0, 0.0), _FLEXES),
    )


@checked
def doglove_hand(
    side: str = "right", cap_radius: float = CAP_RADIUS, wrist: tuple[float, float, float] = WRIST
) -> Hand:
    """Return the linkage of a DOGlove: 21 joints, and five caps, which alone can touch.

    Places of the caps, and torques of servos by J^T F, are those of the device for a person of any size; the angles
    are not those of the person's joints. Joints are ``thumb rotation``, ``thumb abduction``, ``thumb CM``,
    ``thumb PIP`` and ``thumb IP``, then ``abduction``, ``MP``, ``PIP`` and ``DIP`` of index, middle, ring and little
    finger, from the device outwards; servos turn ``thumb CM`` and the fingers' ``MP``. They are the channels of
    [`jaxgrasp.glove.doglove_linkage`][]. Angles are in rad, and zero where a chain is straight. Flexion bends towards
    the palm and counts positive; so does the thumb's rotation towards opposition. Abduction has the signs of
    [`jaxgrasp.hand.human_hand`][]. The wrist's frame: x towards the fingers, z out of the back of the hand, y towards
    the thumb of a right hand and away from that of a left one.

    Args:
        side: ``"right"``, as published, or ``"left"``, its mirror image.
        cap_radius: of each cap about the published fingertip [m].
        wrist: place of the wrist in the device's frame [m], whose origin is in the plane of the middle finger; it moves
            all caps alike.

    Raises:
        ValueError: for another side, a radius that is not positive, and a place that is not finite.
    """
    if side not in ("right", "left"):
        raise ValueError(f"side is {side!r}: expected 'right' or 'left'")
    if not (np.isfinite(cap_radius) and cap_radius > 0):
        raise ValueError(f"cap_radius is {cap_radius!r}: expected a positive number [m]")
    if len(wrist) != 3 or not np.all(np.isfinite(wrist)):
        raise ValueError(f"wrist is {wrist!r}: expected three finite numbers [m]")
    chains = {"thumb": _THUMB} | {name: _finger(name) for name in BARS}
    hinges = [hinge for chain in chains.values() for hinge in chain]
    ends = np.cumsum([len(chain) for chain in chains.values()]) - 1
    starts = {int(end) - len(chain) + 1 for end, chain in zip(ends, chains.values(), strict=True)}
    origins = np.array([hinge.origin for hinge in hinges])
    origins[sorted(starts)] -= wrist
    rests = np.tile(np.eye(3), (len(hinges), 1, 1))
    c = np.sqrt(0.5)
    rests[0] = [[c, -c, 0], [c, c, 0], [0, 0, 1]]
    limits = np.array([LIMITS.get(hinge.name) or LIMITS[hinge.name.split()[1]] for hinge in hinges])
    tips = np.array([[[THUMB_TIP if name == "thumb" else TIP, 0.0, 0.0]] for name in chains])
    hand = Hand(
        jnp.array(origins),
        jnp.array(rests),
        jnp.array([hinge.axis for hinge in hinges]),
        jnp.array(limits[:, 0]),
        jnp.array(limits[:, 1]),
        Spheres(jnp.array(tips), jnp.full((len(chains), 1), cap_radius)),
        tuple(-1 if k in starts else k - 1 for k in range(len(hinges))),
        tuple(hinge.name for hinge in hinges),
        tuple(Link(name, "distal", int(end)) for name, end in zip(chains, ends, strict=True)),
    )
    return hand if side == "right" else mirrored(hand)


STEPS = 60
NEUTRAL = {"MP": -0.5, "CM": -0.3, "PIP": 1.2, "DIP": 0.7, "IP": 0.6, "thumb rotation": 0.8}
"""Posture to which a linkage tends where the fingertips leave a choice [rad]; 0 for other joints."""
RESTING = 1e-3
"""Cost of a radian from that posture, as a distance of a fingertip [m]."""


@checked
def linkage_angles(linkage: Hand, person: Hand, angles: Float[AnyArray, "P"]) -> Float[np.ndarray, "J"]:
    """Compute angles of a linkage with its caps at the fingertips of a person's hand, both on the same wrist.

    A chain has a joint more than a fingertip's place needs: of all postures that reach it, that near a neutral one.

    Args:
        linkage: as [`jaxgrasp.hand.doglove_hand`][] builds it.
        person: hand whose distal links end in a ball, such as [`jaxgrasp.hand.human_hand`][] builds.
        angles: of the person's joints [rad].
    """
    names = [link.name for link in person.links]
    rows = np.array([names.index(link.name) for link in linkage.links])
    home = Pose(jnp.zeros(3), jnp.eye(3))
    frames = pose_hand(person, Posture(home, jnp.asarray(angles)))
    ends = jnp.asarray(person.skin.centers)[rows, -1]
    targets = frames.links.origin[rows] + jnp.einsum("lij,lj->li", frames.links.rotation[rows], ends)
    return np.asarray(_reach(linkage, targets))


@jax.jit
def _reach(linkage: Hand, targets: Array) -> Array:
    neutral = jnp.array([NEUTRAL.get(name, NEUTRAL.get(name.split()[1], 0.0)) for name in linkage.joints])
    middle, half = (linkage.upper + linkage.lower) / 2, (linkage.upper - linkage.lower) / 2

    def residuals(unknowns: Array) -> Array:
        # Angles are sines of the unknowns, which keeps them within the limits.
        angles = middle + half * jnp.sin(unknowns)
        links = pose_hand(linkage, Posture(Pose(jnp.zeros(3), jnp.eye(3)), angles)).links
        caps = links.origin + jnp.einsum("lij,lj->li", links.rotation, jnp.asarray(linkage.skin.centers)[:, 0])
        # In millimetres, as RESTING makes a radian one.
        return jnp.append((caps - targets) / RESTING, 0.1 * (angles - neutral))

    solution = least_squares(residuals, jnp.arcsin(jnp.clip((neutral - middle) / half, -0.95, 0.95)), STEPS)
    return jnp.asarray(middle + half * jnp.sin(solution.point))
