"""A power grip: the hand laid on an object, and closed around it."""

import jax.numpy as jnp
import numpy as np

from jaxgrasp.hand.closing import close_hand
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.human_hand import check_human, open_angles
from jaxgrasp.hand.shapes import Shape, check_shape
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.validation.checked import checked

ACROSS = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
"""An object's z axis across the palm, towards the little finger of a right hand."""


def lay_on(hand: Hand, shape: Shape, depth: float = 1e-3) -> tuple[Posture, Pose]:
    """An open hand, its palm on an object below it: wrist at the world's origin, palm down.

    The object lies under the knuckles, its z axis across the palm.

    Args:
        hand: a human hand.
        shape: of the object.
        depth: at which the palm presses into it [m].

    Raises:
        TypeError: for what is no hand, or no shape.
        ValueError: for a hand that is not a human one, a shape of no volume, or a depth below zero.
    """
    check_human(hand)
    knuckles = [hand.joints.index(name) for name in ("index abduction", "little abduction")]
    palm = [link.name for link in hand.links].index("middle palm")
    origins, rotation = np.asarray(hand.origins), np.array(ACROSS)
    above = float(shape._support(Vec3(*jnp.asarray(rotation[2]))))
    x = float(origins[knuckles, 0].max())
    z = -(above + float(hand.skin.radii[palm, -1]) - depth)
    wrist = Pose(jnp.zeros(3), jnp.eye(3))
    return Posture(wrist, jnp.asarray(open_angles(hand))), Pose(jnp.array([x, 0.0, z]), jnp.asarray(rotation))


@checked
def power_grip(hand: Hand, shape: Shape, depth: float = 1e-3) -> tuple[Posture, Pose, Contacts]:
    """A hand closed on an object that lies in its palm.

    What is too thick or too thin for the hand is closed on as far as it goes: [`jaxgrasp.grip.grip_type`][] tells.

    Args:
        hand: a human hand.
        shape: of the object; its z axis goes across the palm.
        depth: at which links press into it [m].

    Returns:
        The posture, its wrist at the world's origin and its palm down; where the object lies in the world; and the
        contacts.

    Raises:
        ValueError: for a hand that is not a human one.
    """
    check_shape(shape)
    if not (np.isfinite(depth) and depth >= 0):
        raise ValueError(f"depth is {depth}: expected a number of metres, zero or more")
    posture, placed = lay_on(hand, shape, depth)
    closed, contacts = close_hand(hand, posture, shape, placed, depth)
    return closed, placed, contacts
