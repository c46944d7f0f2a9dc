"""Closing of a hand on an object: direction of each joint, axes of the palm, and fingers that flex until they press.

Finger and phalanx of each link: given by the user, or read from the link's name where that is clear.
"""

import re
from collections.abc import Mapping
from functools import partial
from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.human_hand import is_human, open_angles
from jaxgrasp.hand.kinematics import ancestry, pose_hand
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, HandFrames, Link, Pose, Posture
from jaxgrasp.validation.checked import checked


@checked
@partial(jax.jit, static_argnames=("fingers_apart", "steps"))
def close_hand(
    hand: Hand,
    posture: Posture,
    shape: Shape,
    placed: Pose,
    depth: float | AnyArray = 1e-3,
    *,
    towards: Float[AnyArray, "*#batch J"] | None = None,
    fingers_apart: bool = False,
    steps: int = 200,
) -> tuple[Posture, Contacts]:
    """Turn the joints until the links press into the object.

    All joints turn together, each by its share of the way. A joint stops where a link that it carries has reached
    the depth, or at its limit; those beyond it go on, so that a finger wraps around what it meets. Joints that are
    coupled (``Hand.coupling``) go and stop together, from where the law has those that follow others. A hand that
    starts inside the object stays there: [`jaxgrasp.hand.check_clear`][] finds out.

    Args:
        hand: one for all postures.
        posture: where it starts; any leading axes.
        shape: what it closes on.
        placed: where that stands, and stays.
        depth: of penetration at which a link has pressed enough [m].
        towards: angles at the end of an unhindered way [rad]; the flexions' upper limits where not given, the
            other joints as they are.
        fingers_apart: whether fingers also stop where they meet one another, to within a step; else they pass through.
            It looks at every pair of spheres, which takes longer than all else.
        steps: of equal size to go there in.

    Returns:
        The closed posture, and its contacts.
    """
    start = jnp.asarray(posture.angles)
    towards = flexed(hand, start) if towards is None else jnp.asarray(towards)
    moves, coupling = jnp.asarray(ancestry(hand)), hand.coupling
    if coupling is None:
        stride = (towards - start) / steps
    else:
        # Independent joints stop, for a link that any of their followers carries, and take these with them.
        start, moves = coupling.angles(start), moves @ (jnp.asarray(coupling.matrix) != 0).astype(float) > 0
        stride = (towards - start)[..., list(coupling.independent)] / steps

    def contacts_at(angles: Array) -> Contacts:
        return find_contacts(hand, Posture(posture.wrist, angles), shape, placed)

    pairs = phalanx_pairs(hand) if fingers_apart else np.zeros((0, 2), int)
    pair_moves = moves[pairs].any(1)
    initial_overlaps = link_overlaps(hand, Posture(posture.wrist, start), pairs)

    def advance(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        angles, free = carry
        # A link that presses enough already stops its joints before they move.
        pressed = contacts_at(angles).depths >= depth
        free = free & ~jnp.any(moves & pressed[..., None], -2)
        if len(pairs):
            collides = link_overlaps(hand, Posture(posture.wrist, angles), pairs) > jnp.maximum(initial_overlaps, 0)
            free = free & ~jnp.any(pair_moves & collides[..., None], -2)
        step = jnp.where(free, stride, 0)
        return (angles + (step if coupling is None else step @ jnp.asarray(coupling.matrix).T), free), None

    (angles, _), _ = lax.scan(advance, (start, jnp.ones(stride.shape, bool)), length=steps)
    return Posture(posture.wrist, angles), contacts_at(angles)


def flexed(hand: Hand, angles: Float[AnyArray, "*batch J"]) -> Float[Array, "*batch J"]:
    """Return the angles [rad] with all flexions at their upper limits and the other joints unchanged."""
    flexes = np.array(["abduction" not in name for name in hand.joints])
    return jnp.where(flexes, hand.upper, angles)


def phalanx_pairs(hand: Hand) -> np.ndarray:
    """Return the pairs ``(P, 2)`` of links of different fingers, which may meet."""
    phalanges = [k for k, link in enumerate(hand.links) if link.phalanx and link.joint >= 0]
    pairs = [(i, j) for i, j in combinations(phalanges, 2) if hand.links[i].finger != hand.links[j].finger]
    return np.array(pairs, int).reshape(-1, 2)


def link_overlaps(hand: Hand, posture: Posture, pairs: np.ndarray) -> Array:
    """Compute the overlap ``(..., P)`` of the two links of each pair; negative where they are apart [m]."""
    links = pose_hand(hand, posture).links
    centers = jnp.einsum("...lij,lmj->...lmi", links.rotation, hand.skin.centers) + links.origin[..., None, :]
    return sphere_overlaps(centers, hand.skin.radii, pairs)


def sphere_overlaps(centers: AnyArray, radii: AnyArray, pairs: np.ndarray) -> Array:
    """Compute the overlap ``(..., P)`` of pairs of rows of spheres ``(..., L, m, 3)``; negative where apart [m]."""
    centers, radii = jnp.asarray(centers), jnp.asarray(radii)
    first, second = pairs.T
    offset = centers[..., first, :, None, :] - centers[..., second, None, :, :]
    is_sphere = (radii[first, :, None] > 0) & (radii[second, None, :] > 0)
    # r_i + r_j - |c_i - c_j|
    overlap = radii[first, :, None] + radii[second, None, :] - jnp.sqrt(jnp.sum(offset**2, -1))
    return jnp.max(jnp.where(is_sphere, overlap, -jnp.inf), (-2, -1))


FINGER_PREFIXES = {
    "thumb": ("thumb", "th"),
    "index": ("index", "ff"),
    "middle": ("middle", "mf"),
    "ring": ("ring", "rf"),
    "little": ("little", "pinky", "pinkie", "lf"),
}
"""Names of the fingers in files; the letters are Shadow's: first, middle, ring and little finger, and thumb."""
PHALANGES = {
    "palm": ("metacarpal", "palm"),
    "proximal": ("proximal",),
    "middle": ("middle", "medial", "intermediate"),
    "distal": ("distal",),
}
PALM = ("middle", "palm")
"""Finger and phalanx of a palm that is one body."""


def _alternatives(words: Mapping[str, tuple[str, ...]], group: str) -> str:
    return f"(?P<{group}>{'|'.join(word for synonyms in words.values() for word in synonyms)})"


_LINK = re.compile(
    rf"{_alternatives(FINGER_PREFIXES, 'finger')}[ _.-]?{_alternatives(PHALANGES, 'phalanx')}(?:[ _.-]?link)?"
)
_PALM = re.compile(r"palm(?:[ _.-]?link)?")


@checked
def name_fingers(hand: Hand, names: Mapping[str, tuple[str, str]] | None = None) -> Hand:
    """Return the hand with its links named by finger and phalanx, as grips and their contributions need them.

    For links that are not in ``names``, names such as ``robot0:ffproximal``, ``index_distal_link`` or ``palm``
    decide; a thumb of three phalanges has a metacarpal, a proximal and a distal one. Other links keep their
    names, and take part in no grip that knows fingers.

    Args:
        hand: such as [`jaxgrasp.interop.hand_from_mujoco`][] reads.
        names: finger (thumb, index, middle, ring, little) and phalanx (palm, metacarpal, proximal, middle, distal) by
            the link's present name, such as ``{"link_3.0": ("index", "distal")}``.

    Raises:
        ValueError: for a name that the hand lacks, or a finger or phalanx that there is none of.
    """
    link_names = [link.name for link in hand.links]
    overrides = dict(names or {})
    for name, (finger, phalanx) in overrides.items():
        if name not in link_names:
            raise ValueError(f"names has {name!r}: expected links of the hand, such as {', '.join(link_names[:5])}")
        if finger not in FINGER_PREFIXES or phalanx not in (*PHALANGES, "metacarpal"):
            raise ValueError(
                f"names[{name!r}] is {(finger, phalanx)}: expected one of {', '.join(FINGER_PREFIXES)}, "
                f"and one of {', '.join((*PHALANGES, 'metacarpal'))}"
            )
    parsed = {name: overrides.get(name) or _parse_name(name) for name in link_names}
    if ("thumb", "middle") in parsed.values():
        shifted = {("thumb", "proximal"): ("thumb", "metacarpal"), ("thumb", "middle"): ("thumb", "proximal")}
        parsed = {
            name: pair if name in overrides or pair is None else shifted.get(pair, pair)
            for name, pair in parsed.items()
        }
    links = tuple(link if (pair := parsed[link.name]) is None else Link(*pair, link.joint) for link in hand.links)
    return Hand(**{**vars(hand), "links": links})


def _parse_name(name: str) -> tuple[str, str] | None:
    """Return the finger and phalanx in a link's name, or None where it has none."""
    text = name.rpartition(":")[2].lower().strip()
    if _PALM.fullmatch(text):
        return PALM
    match = _LINK.fullmatch(text)
    if match is None:
        return None
    finger, phalanx = (
        next(key for key, words in kinds.items() if match[group] in words)
        for group, kinds in (("finger", FINGER_PREFIXES), ("phalanx", PHALANGES))
    )
    return finger, "metacarpal" if (finger, phalanx) == ("thumb", "palm") else phalanx


OPPOSED_FINGERS = ("index", "middle", "ring", "little")
ACROSS = 0.7
"""Cosine of the angle between a finger's joint and the line of the knuckles, from which the joint flexes."""


class ClosingKinematics(NamedTuple):
    """An open hand, a closed one, and the palm between them."""

    open: Float[AnyArray, "J"]
    """Angles of the open hand, the thumb opposite the fingers [rad]."""
    closed: Float[AnyArray, "J"]
    """Angles at the end of an unhindered way; as open where a joint takes no part [rad]."""
    frame: Float[AnyArray, "3 3"]
    """Axes of the palm in the wrist's frame, as columns: x towards the fingers, z out of the back of the hand."""
    seat: Float[AnyArray, "3"]
    """A point of the palm's skin under the knuckles, in the wrist's frame [m]: an object lies there."""


@checked
def closing_kinematics(
    hand: Hand, *, open: Mapping[str, float] | None = None, closed: Mapping[str, float] | None = None
) -> ClosingKinematics:
    """Compute the open and the closed angles of a hand with named fingers, and the palm between them.

    A human hand has fixed angles and a fixed palm. Other hands are open where every angle is as near to zero as its
    limits let it. The fingers' joints that are about parallel to the line of the knuckles flex, to the limit that is
    further away; the thumb's last two joints flex to the limit that brings its tip nearer to the knuckles. The palm
    faces the direction in which the fingertips move. The thumb's angles opposite the fingers differ from hand to hand:
    give them by ``open``.

    Args:
        hand: links named as by [`jaxgrasp.hand.human_hand`][], such as [`jaxgrasp.hand.name_fingers`][] names them: a
            palm, and two fingers at least, with a proximal and a distal link each.
        open: angles of joints where the hand is open, by name, for those that should not be at zero [rad].
        closed: angles of joints at the end of their way, by name, for those that should not be at their limit [rad].

    Raises:
        ValueError: for a joint that the hand lacks, an angle beyond its limits, or a hand without palm and fingers.
    """
    start = open_angles(hand) if is_human(hand) else np.clip(0.0, np.asarray(hand.lower), np.asarray(hand.upper))
    start = _with_changes(hand, "open", start, open)
    if is_human(hand):
        flexes = np.array(["abduction" not in name for name in hand.joints])
        end = _with_changes(hand, "closed", np.where(flexes, np.asarray(hand.upper), start), closed)
        return ClosingKinematics(start, end, np.eye(3), _human_seat(hand))
    palm, fingers = _palm(hand), [finger for finger in OPPOSED_FINGERS if _has_finger(hand, finger)]
    if not palm or len(fingers) < 2:
        missing = "no palm" if not palm else f"{len(fingers)} fingers with a proximal and a distal link"
        raise ValueError(
            f"hand has {missing}: expected links named by finger and phalanx, as name_fingers does, of a palm and two "
            "fingers at least"
        )
    at_start = Posture(Pose(jnp.zeros(3), jnp.eye(3)), jnp.asarray(start))
    frames = jax.device_get(pose_hand(hand, at_start))
    end = _flexed(hand, start, frames, fingers)
    for joint in _last_thumb_joints(hand).tolist():
        end[joint] = _limit_nearer_to(hand, start, joint, _knuckles(hand, frames, fingers).mean(0))
    frame = _palm_axes(hand, frames, fingers, np.sign(end - start))
    end = _with_changes(hand, "closed", end, closed)
    if hand.coupling is not None:
        start, end = (np.asarray(hand.coupling.angles(angles)) for angles in (start, end))
    return ClosingKinematics(start, end, frame, _seat(hand, frames, fingers, palm, frame))


def _with_changes(hand: Hand, field: str, angles: np.ndarray, changes: Mapping[str, float] | None) -> np.ndarray:
    lower, upper = np.asarray(hand.lower), np.asarray(hand.upper)
    angles = angles.copy()
    for name, angle in (changes or {}).items():
        if name not in hand.joints:
            raise ValueError(f"{field} has {name!r}: expected joints of the hand, such as {', '.join(hand.joints[:5])}")
        joint = hand.joints.index(name)
        if not lower[joint] <= angle <= upper[joint]:
            raise ValueError(f"{field}[{name!r}] is {angle}: expected {lower[joint]:.6g} to {upper[joint]:.6g}")
        angles[joint] = angle
    return angles


def _has_finger(hand: Hand, finger: str) -> bool:
    phalanges = {link.phalanx for link in hand.links if link.finger == finger and link.joint >= 0}
    return {"proximal", "distal"} <= phalanges


def _palm(hand: Hand) -> list[int]:
    return [i for i, link in enumerate(hand.links) if link.phalanx in ("palm", "heel")]


def _link(hand: Hand, finger: str, phalanx: str) -> int:
    return next(i for i, link in enumerate(hand.links) if (link.finger, link.phalanx) == (finger, phalanx))


def _knuckles(hand: Hand, frames: HandFrames, fingers: list[str]) -> np.ndarray:
    """Return the centres ``(F, 3)`` of the fingers' first joints."""
    joints = [hand.links[_link(hand, finger, "proximal")].joint for finger in fingers]
    return np.asarray(frames.joints.origin)[joints]


def _centers(hand: Hand, frames: HandFrames, link: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres ``(m, 3)`` and radii ``(m,)`` of the spheres of a link."""
    radii = np.asarray(hand.skin.radii[link])
    rotation, origin = np.asarray(frames.links.rotation)[link], np.asarray(frames.links.origin)[link]
    centers = origin + np.asarray(hand.skin.centers[link]) @ rotation.T
    return centers[radii > 0], radii[radii > 0]


def _tips(hand: Hand, frames: HandFrames, fingers: list[str]) -> np.ndarray:
    """Compute the mean centres ``(F, 3)`` of the distal links' spheres."""
    return np.array([_centers(hand, frames, _link(hand, finger, "distal"))[0].mean(0) for finger in fingers])


def _flexed(hand: Hand, start: np.ndarray, frames: HandFrames, fingers: list[str]) -> np.ndarray:
    """Return the angles ``(J,)`` with the fingers' flexions at the limit that is further away."""
    knuckles, moves = _knuckles(hand, frames, fingers), ancestry(hand)
    line = _unit(knuckles[-1] - knuckles[0])
    flexes = np.zeros(len(hand.joints), bool)
    for finger in fingers:
        chain = moves[_link(hand, finger, "distal")] & ~hand.slides
        flexes |= chain & (np.abs(np.asarray(frames.axes) @ line) >= ACROSS)
    lower, upper = np.asarray(hand.lower), np.asarray(hand.upper)
    return np.where(flexes, np.where(upper - start >= start - lower, upper, lower), start)


def _last_thumb_joints(hand: Hand) -> np.ndarray:
    """Return the indices of the thumb's last two joints; none where there is no thumb."""
    names = [(link.finger, link.phalanx) for link in hand.links]
    if ("thumb", "distal") not in names:
        return np.zeros(0, int)
    return np.flatnonzero(ancestry(hand)[names.index(("thumb", "distal"))])[-2:]


def _limit_nearer_to(hand: Hand, start: np.ndarray, joint: int, point: np.ndarray) -> float:
    """Return the limit of a thumb joint at which the thumb's tip is nearer to a point [rad]."""
    limits = np.array([np.asarray(hand.lower)[joint], np.asarray(hand.upper)[joint]])
    angles = np.stack([start, start])
    angles[:, joint] = limits
    frames = jax.device_get(pose_hand(hand, Posture(Pose(jnp.zeros(3), jnp.eye(3)), angles)))
    tips = [_tips(hand, jax.tree.map(lambda x, i=i: x[i], frames), ["thumb"])[0] for i in range(2)]
    return float(limits[np.argmin(np.linalg.norm(np.array(tips) - point, axis=-1))])


def _palm_axes(hand: Hand, frames: HandFrames, fingers: list[str], signs: np.ndarray) -> np.ndarray:
    """Compute the palm's axes: fingers point along x, and their tips move along -z as they flex."""
    tips, knuckles, moves = _tips(hand, frames, fingers), _knuckles(hand, frames, fingers), ancestry(hand)
    x = _unit(np.mean([_unit(tip - knuckle) for tip, knuckle in zip(tips, knuckles, strict=True)], 0))
    velocities = []
    for finger, tip in zip(fingers, tips, strict=True):
        for joint in np.flatnonzero(moves[_link(hand, finger, "distal")] & (signs != 0)):
            velocities.append(signs[joint] * np.cross(frames.axes[joint], tip - frames.joints.origin[joint]))
    towards = np.mean(velocities, 0)
    z = -_unit(towards - (towards @ x) * x)
    return np.stack([x, np.cross(z, x), z], -1)


def _seat(hand: Hand, frames: HandFrames, fingers: list[str], palm: list[int], frame: np.ndarray) -> np.ndarray:
    """Compute the point under the middle of the line of the knuckles, at the level of the palm's skin [m]."""
    spheres = [_centers(hand, frames, link) for link in palm]
    centers, radii = (np.concatenate(parts) for parts in zip(*spheres, strict=True))
    palm_centers, knuckles = centers @ frame, _knuckles(hand, frames, fingers) @ frame
    return frame @ np.array([knuckles[:, 0].max(), knuckles[:, 1].mean(), (palm_centers[:, 2] - radii).min()])


def _human_seat(hand: Hand) -> np.ndarray:
    knuckles = [hand.joints.index(name) for name in ("index abduction", "little abduction")]
    palm = [link.name for link in hand.links].index("middle palm")
    return np.array([float(np.asarray(hand.origins)[knuckles, 0].max()), 0.0, -float(hand.skin.radii[palm, -1])])


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
