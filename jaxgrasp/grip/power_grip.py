"""Power grip: the hand is laid on an object, and closed around it."""

import jax.numpy as jnp
import numpy as np

from jaxgrasp.hand.closing import ClosingKinematics, close_hand, closing_kinematics
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.human_hand import is_human
from jaxgrasp.hand.posture_limits import ROUNDING, check_clear
from jaxgrasp.hand.shapes import Shape, check_shape
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.validation.checked import checked

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

    On an object that is too thick or too thin the hand closes as far as possible: check with
    [`jaxgrasp.grip.grip_type`][].

    Args:
        hand: a human hand, or one whose links [`jaxgrasp.hand.name_fingers`][] has named.
        shape: shape of the object; its z axis lies across the palm.
        depth: depth of the links in the object [m].
        closing: closing kinematics, from [`jaxgrasp.hand.closing_kinematics`][]; found by it where not given.

    Returns:
        The posture, with the wrist at the world's origin and the palm down; the object's pose in the world; and the
        contacts.

    Raises:
        ValueError: for a hand without palm and fingers, and for one that is not human and starts inside the object.
    """
    check_shape(shape)
    if not (np.isfinite(depth) and depth >= 0):
        raise ValueError(f"depth is {depth}: expected a number, 0 or more [m]")
    closing = closing_kinematics(hand) if closing is None else closing
    posture, placed = lay_on(hand, shape, depth, closing)
    if not is_human(hand):
        # The thumb of another hand is clear of the object only if the caller's open angles put it aside.
        check_clear(hand, posture, shape, placed, depth + ROUNDING)
    closed, contacts = close_hand(
        hand, posture, shape, placed, depth, towards=jnp.asarray(closing.closed), fingers_apart=True
    )
    return closed, placed, contacts
