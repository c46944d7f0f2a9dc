"""A power grip from beginning to end: the hand laid on an object, closed, then lifted, turned, and opened."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.contact.closing import close_hand
from jaxgrasp.contact.detection import Contacts
from jaxgrasp.contact.shapes import Shape
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.numerics.vec import Vec
from jaxgrasp.prehension.motion import rotation_by

OPPOSITION = 0.6
"""Abduction of the thumb, with which its tip comes to face the fingers' [rad]."""
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
        ValueError: for a hand that is not a human one.
    """
    knuckles = [j for j, name in enumerate(hand.joints) if name in ("index abduction", "little abduction")]
    palm = [i for i, link in enumerate(hand.links) if link.finger == "middle" and link.phalanx == "palm"]
    if len(knuckles) != 2 or len(palm) != 1:
        raise ValueError("hand is not a human one: expected joints and links named as by human_hand")
    origins, rotation = np.asarray(hand.origins), np.array(ACROSS)
    above = float(shape._support(Vec(*jnp.asarray(rotation[2]))))
    x = float(origins[knuckles, 0].max())
    z = -(above + float(hand.skin.radii[palm[0], -1]) - depth)
    angles = np.array([OPPOSITION if name == "thumb abduction" else 0.0 for name in hand.joints])
    wrist = Pose(jnp.zeros(3), jnp.eye(3))
    return Posture(wrist, jnp.asarray(angles)), Pose(jnp.array([x, 0.0, z]), jnp.asarray(rotation))


def power_grip(hand: Hand, shape: Shape, depth: float = 1e-3) -> tuple[Posture, Pose, Contacts]:
    """A hand closed on an object that lies in its palm: posture, the object's place, and the contacts.

    Raises:
        ValueError: for a hand that is not a human one.
    """
    posture, placed = lay_on(hand, shape, depth)
    closed, contacts = close_hand(hand, posture, shape, placed, depth)
    return closed, placed, contacts


def lift_and_turn(
    closed: Posture, times: AnyArray, *, lift: float, turn: float, axis: AnyArray, release: Posture | None = None
) -> Posture:
    """What the hand does with what it holds: a quarter of the time each to hold, lift, turn, and hold or let go.

    Args:
        closed: the posture that holds, its wrist where it starts.
        times: ``(T,)``, ascending [s].
        lift: of the wrist, along the world's z [m].
        turn: about ``axis`` through the wrist [rad].
        axis: unit vector ``(3,)`` in the world.
        release: the posture whose angles let go; ``None`` to hold on.

    Returns:
        Postures of leading axis T, which start and stop smoothly.
    """
    way = (jnp.asarray(times) - times[0]) / (times[-1] - times[0]) * 4
    lifted, turned, opened = (_smooth(way - begin) for begin in (1.0, 2.0, 3.0))
    rotation = jax.vmap(rotation_by)(turn * turned[:, None] * jnp.asarray(axis)) @ closed.wrist.rotation
    origin = closed.wrist.origin + lift * lifted[:, None] * jnp.array([0.0, 0.0, 1.0])
    angles = jnp.broadcast_to(closed.angles, (len(way), closed.angles.shape[0]))
    if release is not None:
        angles = angles + opened[:, None] * (release.angles - closed.angles)
    return Posture(Pose(origin, rotation), angles)


def _smooth(way: jax.Array) -> jax.Array:
    """From 0 to 1 without a jump in speed or acceleration."""
    s = jnp.clip(way, 0, 1)
    return s**3 * (10 - 15 * s + 6 * s**2)
