"""A human hand from its length and breadth.

Segment lengths and joint centres: Buchholz, Armstrong and Goldstein, Ergonomics 35(3):261-273, 1992
(doi 10.1080/00140139208967812), as shares of hand length HL and hand breadth HB. Breadths of the fingers, the
thumb's attitude and the joint limits: as in the hand model of Sancho-Bru et al. 2011 (doi 10.5772/19977). Ours are:
fingers at rest are parallel, a phalanx is a tapered capsule, and the thumb's carpometacarpal flexion is fixed.

The wrist's frame: x towards the middle finger, y towards the thumb of a right hand, z out of the back of the hand.
A left hand is the right one's mirror image in the xz plane.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.hand import Hand, Link, Spheres
from jaxgrasp.validation.checked import checked

LENGTH, BREADTH = 0.19, 0.085
"""Length and breadth of a hand of middling size [m]."""
LEAVES = 12
"""Spheres of a phalanx: they stand so close that the skin is scalloped by a quarter of a millimetre."""
ARCH = {"index": 0.04, "middle": 0.0, "ring": 0.05, "little": 0.16}
"""How far the flesh of each finger's part of a palm with pads stands out towards the object, of HB: the hand is hollow
across, and the ball of the little finger bounds it."""
PALM_BREADTH = 1.2
"""Breadth of a finger's metacarpal, as a multiple of its proximal phalanx's."""


class Finger(NamedTuple):
    """Shares of hand length HL and breadth HB; angles in degrees."""

    base: tuple[float, float]
    """The metacarpal's near end: HL along x, HB along y."""
    knuckle: tuple[float, float]
    """The metacarpophalangeal joint, likewise."""
    lengths: tuple[float, float, float]
    """Proximal, middle and distal phalanx, of HL."""
    breadths: tuple[float, float, float, float]
    """At the metacarpophalangeal and both interphalangeal joints, and at the tip, of HB."""
    abduction: tuple[float, float]
    distal: float
    """Least angle of the last joint."""


FINGERS = {
    "index": Finger(
        (0.073, 0.126), (0.447, 0.251), (0.245, 0.143, 0.097), (0.231, 0.2185, 0.192, 0.153), (-13, 42), -10
    ),
    "middle": Finger((0.073, 0.0), (0.446, 0.0), (0.266, 0.170, 0.108), (0.212, 0.213, 0.1935, 0.159), (-8, 35), -10),
    "ring": Finger(
        (0.073, -0.129), (0.409, -0.206), (0.244, 0.165, 0.107), (0.202, 0.198, 0.1795, 0.148), (-14, 20), -20
    ),
    "little": Finger(
        (0.073, -0.223), (0.368, -0.402), (0.204, 0.117, 0.093), (0.186, 0.176, 0.161, 0.133), (-33, 19), -30
    ),
}
THUMB_BASE = (0.073, 0.196)
THUMB_LENGTHS = (0.251, 0.196, 0.158)
"""Metacarpal, proximal and distal, of HL."""
THUMB_BREADTHS = (0.438, 0.231, 0.233, 0.185)
THUMB_ATTITUDE = (32.58, 23.17, 87.98)
"""Rotations of the thumb's metacarpal [degrees]: towards the radial side, then towards the palm, then about itself to
face the fingers."""
LIMITS = {"MP": (0, 90), "PIP": (0, 100), "thumb abduction": (0, 60), "thumb MP": (-10, 55), "thumb IP": (-15, 80)}
TOWARDS_THUMB = {"index": 1, "middle": 1, "ring": -1, "little": -1}
"""Sign of each finger's abduction, that is, away from the middle finger."""

OPPOSITION = 0.6
"""Abduction of the thumb, with which its tip comes to face the fingers' [rad]."""


class _FingerParts(NamedTuple):
    """Joints and links of the hand, extended finger by finger."""

    joints: list[str]
    parents: list[int]
    origins: list[np.ndarray]
    rests: list[np.ndarray]
    axes: list[tuple[float, float, float]]
    limits: list[np.ndarray]
    links: list[Link]
    spheres: list[tuple[np.ndarray, np.ndarray]]


@checked
def human_hand(
    length: float = LENGTH, breadth: float | None = None, side: str = "right", palm_pads: bool = False
) -> Hand:
    """Return a human hand: 14 flexions and 5 abductions, 19 links that can touch, or 23 with ``palm_pads``.

    The wrist's frame: x towards the fingers, z out of the back of the hand, y towards the thumb of a right hand and
    away from that of a left one. Joints are ``thumb abduction``, ``thumb MP``, ``thumb IP``, then ``abduction``,
    ``MP``, ``PIP`` and ``DIP`` of index, middle, ring and little finger. Angles are in rad; flexion bends towards the
    palm and counts positive; abduction counts positive towards the thumb, but for ring and little finger away from it,
    and the thumb's own away from the palm.

    Args:
        length: from the wrist's crease to the middle finger's tip [m].
        breadth: across the knuckles [m]; 0.45 of the length unless given.
        side: ``"right"`` or ``"left"``.
        palm_pads: cut each finger's part of the palm in two links, which touch each by itself: ``palm`` below the
            knuckle and ``heel`` near the wrist.

    Raises:
        ValueError: for a length or breadth that is not a positive number, or another side.
    """
    if breadth is None:
        breadth = BREADTH / LENGTH * length
    for name, value in (("length", length), ("breadth", breadth)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value!r}: expected a positive number of metres")
    if side not in ("right", "left"):
        raise ValueError(f"side is {side!r}: expected 'right' or 'left'")
    parts = _FingerParts([], [], [], [], [], [], [], [])
    _add_thumb(parts, length, breadth)
    for name, finger in FINGERS.items():
        _add_finger(parts, name, finger, length, breadth, palm_pads)
    hand = _assemble(parts)
    return hand if side == "right" else mirrored(hand)


def is_human(hand: Hand) -> bool:
    """Tell, by their names, whether a hand has a human hand's joints and links."""
    tips = {f"{finger} distal" for finger in ("thumb", *FINGERS)} | {f"{finger} palm" for finger in FINGERS}
    hinges = {f"{finger} {kind}" for finger in ("thumb", *FINGERS) for kind in ("abduction", "MP")}
    return tips <= {link.name for link in hand.links} and hinges <= set(hand.joints)


def open_angles(hand: Hand) -> np.ndarray:
    """Return every joint's angle where fingers are straight and the thumb stands opposite them [rad]."""
    return np.array([OPPOSITION if name == "thumb abduction" else 0.0 for name in hand.joints])


@checked
def mirrored(hand: Hand) -> Hand:
    """Return the hand's mirror image in its wrist's xz plane: a left hand from a right one."""
    flip = jnp.array([1.0, -1.0, 1.0])
    skin = Spheres(hand.skin.centers * flip, hand.skin.radii)
    # An axis of rotation is mirrored, then turned about: so that an angle keeps its meaning.
    signs = jnp.where(hand.slides[:, None], 1, -1)
    return Hand(
        hand.origins * flip,
        flip[:, None] * hand.rests * flip,
        signs * hand.axes * flip,
        hand.lower,
        hand.upper,
        skin,
        hand.parents,
        hand.joints,
        hand.links,
        hand.sliding,
        hand.torque_max,
    )


def _add_finger(parts: _FingerParts, name: str, finger: Finger, length: float, breadth: float, palm_pads: bool) -> None:
    scale = np.array([length, breadth])
    base, knuckle = (np.append(scale * origin, 0) for origin in (finger.base, finger.knuckle))
    radii = np.array(finger.breadths) * breadth / 2
    palm = PALM_BREADTH * (radii[0] + radii[1]) / 2
    if palm_pads:
        hollow = np.array([0, 0, -ARCH[name] * breadth])
        middle = (base + knuckle) / 2
        _add_link(parts, Link(name, "heel", -1), base + hollow, middle + hollow, palm, palm)
        _add_link(parts, Link(name, "palm", -1), middle + hollow, knuckle + hollow, palm, palm)
    else:
        _add_link(parts, Link(name, "palm", -1), base, knuckle, palm, palm)
    _add_joint(parts, f"{name} abduction", -1, knuckle, np.eye(3), (0, 0, TOWARDS_THUMB[name]), finger.abduction)
    origin = np.zeros(3)
    limits = (LIMITS["MP"], LIMITS["PIP"], (finger.distal, 90))
    for i, phalanx in enumerate(("proximal", "middle", "distal")):
        _add_joint(parts, f"{name} {('MP', 'PIP', 'DIP')[i]}", _last(parts), origin, np.eye(3), (0, 1, 0), limits[i])
        origin = np.array([finger.lengths[i] * length, 0, 0])
        # The last sphere ends at the tip; the others meet at the joints.
        end = origin - [radii[3], 0, 0] if phalanx == "distal" else origin
        _add_link(parts, Link(name, phalanx, _last(parts)), np.zeros(3), end, radii[i], radii[i + 1])


def _add_thumb(parts: _FingerParts, length: float, breadth: float) -> None:
    radial, palmar, roll = np.radians(THUMB_ATTITUDE)
    attitude = _about(2, radial) @ _about(1, palmar) @ _about(0, -roll)
    radii = np.array(THUMB_BREADTHS) * breadth / 2
    origin, rest_rotation = np.array([THUMB_BASE[0] * length, THUMB_BASE[1] * breadth, 0]), attitude
    joints = (("abduction", (0, 0, 1)), ("MP", (0, 1, 0)), ("IP", (0, 1, 0)))
    for i, phalanx in enumerate(("metacarpal", "proximal", "distal")):
        name = f"thumb {joints[i][0]}"
        _add_joint(parts, name, _last(parts), origin, rest_rotation, joints[i][1], LIMITS[name])
        origin, rest_rotation = np.array([THUMB_LENGTHS[i] * length, 0, 0]), np.eye(3)
        end = origin - [radii[3], 0, 0] if phalanx == "distal" else origin
        # The metacarpal's flesh ends as thin as the next phalanx begins.
        _add_link(
            parts, Link("thumb", phalanx, _last(parts)), np.zeros(3), end, radii[i] * (1 if i else 0.6), radii[i + 1]
        )


def _last(parts: _FingerParts) -> int:
    return len(parts.joints) - 1


def _add_joint(parts: _FingerParts, name: str, parent: int, origin, rest_rotation, axis, limits) -> None:
    parts.joints.append(name)
    parts.parents.append(parent)
    parts.origins.append(origin)
    parts.rests.append(rest_rotation)
    parts.axes.append(axis)
    parts.limits.append(np.radians(limits))


def _add_link(parts: _FingerParts, link: Link, start: np.ndarray, end: np.ndarray, first: float, last: float) -> None:
    along = np.linspace(0, 1, LEAVES)[:, None]
    parts.links.append(link)
    parts.spheres.append((start + along * (end - start), (first + along * (last - first))[:, 0]))


def _assemble(parts: _FingerParts) -> Hand:
    limits = np.array(parts.limits)
    centers, radii = (np.stack(arrays) for arrays in zip(*parts.spheres, strict=True))
    return Hand(
        jnp.array(parts.origins),
        jnp.array(parts.rests),
        jnp.array(parts.axes, float),
        jnp.array(limits[:, 0]),
        jnp.array(limits[:, 1]),
        Spheres(jnp.array(centers), jnp.array(radii)),
        tuple(parts.parents),
        tuple(parts.joints),
        tuple(parts.links),
    )


def _about(axis: int, angle: float) -> np.ndarray:
    """Return the rotation matrix about a coordinate axis by an angle [rad]."""
    # Imported here, since it takes a quarter of a second, which few users of a hand need.
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("xyz"[axis], angle).as_matrix()
