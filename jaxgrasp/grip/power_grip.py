"""Power grip: the hand is laid on an object, and closed around it."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.hand.closing import ClosingKinematics, close_hand, closing_kinematics
from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.human_hand import is_human
from jaxgrasp.hand.posture_limits import ROUNDING, check_clear
from jaxgrasp.hand.shapes import Shape, check_shape
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.numerics.compiled_code import jit_quickly
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.validation.checked import checked

STEP = 1e-3
"""Depth that a step of closing adds to a link at most [m]: a link that is deeper by more has started inside."""
THUMB_ABDUCTIONS, THUMB_EXTENSIONS = 22, (0.0, 0.5, 1.0)
"""Number of angles of the thumb's abduction, and shares of the way to its other joints' lower limits, that are tried
where it would start inside the object."""
ACROSS = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
"""An object's z axis across the palm, towards the little finger of a right hand."""


def lay_on(
    hand: Hand, shape: Shape, depth: float = 1e-3, closing: ClosingKinematics | None = None
) -> tuple[Posture, Pose]:
    """Place an open hand with its palm on an object below it: wrist at the world's origin, palm down.

    The object lies under the knuckles, its z axis across the palm.

    Args:
        hand: a human hand, or one whose fingers have names.
        shape: shape of the object.
        depth: depth of the palm in the object [m].
        closing: closing kinematics of the hand; found from its joints where not given.

    Raises:
        TypeError: for a hand or shape of another type.
        ValueError: for a hand without palm and fingers, a shape of no volume, or a depth below zero.
    """
    closing = closing_kinematics(hand) if closing is None else closing
    rotation = np.array(ACROSS)
    above = float(shape._support(Vec3(*jnp.asarray(rotation[2]))))
    # The palm's axes become the world's.
    frame = np.asarray(closing.frame)
    under = frame.T @ np.asarray(closing.seat) - np.array([0.0, 0.0, above - depth])
    wrist = Pose(jnp.zeros(3), jnp.asarray(frame.T))
    return Posture(wrist, jnp.asarray(closing.open)), Pose(jnp.asarray(under), jnp.asarray(rotation))


@checked
def power_grip(
    hand: Hand, shape: Shape, depth: float = 1e-3, closing: ClosingKinematics | None = None
) -> tuple[Posture, Pose, Contacts]:
    """Close a hand on an object that lies in its palm.

    A human thumb that would start inside the object is put outside first, and comes back until it touches. The object
    lies on the part of the palm that stands out farthest. On an object that is too thin the hand closes as far as
    possible, and around one that is nearly too thick, the thumb may not oppose the fingers: check with
    [`jaxgrasp.grip.grip_type`][] and [`jaxgrasp.constrained_optimum`][].

    Args:
        hand: a human hand, or one whose links [`jaxgrasp.hand.name_fingers`][] has named.
        shape: shape of the object; its z axis lies across the palm.
        depth: depth of the links in the object [m].
        closing: closing kinematics, from [`jaxgrasp.hand.closing_kinematics`][]; found by it where not given.

    Returns:
        The posture, with the wrist at the world's origin and the palm down; the object's pose in the world; and the
        contacts.

    Raises:
        ValueError: for a hand without palm and fingers, and for one that starts inside the object, where that is too
            thick.
    """
    check_shape(shape)
    if not (np.isfinite(depth) and depth > 0):
        raise ValueError(f"depth is {depth}: expected a positive number [m]")
    closing = closing_kinematics(hand) if closing is None else closing
    posture, placed = lay_on(hand, shape, depth, closing)
    if not is_human(hand):
        # The thumb of another hand is clear of the object only if the caller's open angles put it aside.
        check_clear(hand, posture, shape, placed, depth + ROUNDING)

    def close(posture: Posture, placed: Pose) -> tuple[Posture, Contacts]:
        towards = jnp.asarray(closing.closed)
        compiled = jit_quickly(close_hand, "fingers_apart")
        return compiled(hand, posture, shape, placed, depth, towards=towards, fingers_apart=True)

    closed, contacts = close(posture, placed)
    if not is_human(hand):
        return closed, placed, contacts
    is_palm = np.array([link.joint < 0 for link in hand.links])
    palm_excess = np.max(np.asarray(contacts.depths)[is_palm]) - depth
    if palm_excess > STEP:
        placed = Pose(placed.origin - jnp.array([0.0, 0.0, palm_excess]), placed.rotation)
        closed, contacts = close(posture, placed)
    if _started_inside(hand, contacts, depth).size:
        closed, contacts = close(_with_thumb_aside(hand, posture, shape, placed, depth), placed)
    for link in _started_inside(hand, contacts, depth):
        is_thumb = hand.links[link].finger == "thumb"
        raise ValueError(
            f"the link {hand.links[link].name} starts {float(contacts.depths[link]):.3g} m inside the object"
            f"{', however far the thumb is put aside' if is_thumb else ''}: expected at most {depth:.3g} m"
        )
    return closed, placed, contacts


def _started_inside(hand: Hand, contacts: Contacts, depth: float) -> np.ndarray:
    """Return the phalanges of a closed hand that were inside the object before it closed, the deepest first."""
    is_phalanx = np.array([link.joint >= 0 for link in hand.links])
    depths = np.asarray(contacts.depths)
    order = np.argsort(-depths)
    return order[is_phalanx[order] & (depths[order] > depth + STEP)]


def _with_thumb_aside(hand: Hand, posture: Posture, shape: Shape, placed: Pose, depth: float) -> Posture:
    """Return the posture with the thumb outside the object, and abducted as before if that can be; where it is inside
    at all angles, the least deep.

    It is rather opposed farther than less: beside the fingers it holds nothing against them.
    """
    start = np.asarray(posture.angles)
    abduction, *extended = (hand.joints.index(f"thumb {name}") for name in ("abduction", "MP", "IP"))
    tried = np.linspace(float(hand.lower[abduction]), float(hand.upper[abduction]), THUMB_ABDUCTIONS)
    angles = np.tile(start, (len(tried) * len(THUMB_EXTENSIONS), 1))
    angles[:, abduction] = np.repeat(tried, len(THUMB_EXTENSIONS))
    ways = np.asarray(hand.lower)[extended] - start[extended]
    angles[:, extended] += np.outer(np.tile(THUMB_EXTENSIONS, len(tried)), ways)
    wrist = jax.tree.map(lambda part: jnp.broadcast_to(part, (len(angles), *part.shape)), posture.wrist)
    postures = Posture(wrist, jnp.asarray(angles))
    depths = np.asarray(jit_quickly(find_contacts)(hand, postures, shape, placed).depths)
    is_thumb = np.array([link.finger == "thumb" for link in hand.links])
    too_deep = np.maximum(depths[:, is_thumb].max(1) - depth, 0)
    turned = angles[:, abduction] - start[abduction]
    best = np.lexsort((np.abs(angles - start).sum(1), np.abs(turned), turned < 0, too_deep))[0]
    return Posture(posture.wrist, jnp.asarray(angles[best]))
