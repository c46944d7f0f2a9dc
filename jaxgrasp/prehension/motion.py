"""How bodies move from one instant to the next: rigid motions, their fit to contacts, and what gravity does.

Quasi-static: a held object goes where its contacts go; only a slipping or a free one has an inertia of its own.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jaxgrasp.contact.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose
from jaxgrasp.numerics.vec import Vec

PAD = 2e-3
"""Half the width of what a contact holds on to [m]: a fingertip turns what it touches, if only a little."""


class Body(eqx.Module):
    """A rigid object of uniform density, its centre of mass at its frame's origin."""

    shape: Shape
    mass: float | AnyArray
    """[kg]"""


class Motion(NamedTuple):
    """Velocity of a body: of its origin, and about it, in the world."""

    linear: Array
    """[m/s]"""
    angular: Array
    """[rad/s]"""


def spatial_inertia(body: Body, rotation: Float[AnyArray, "3 3"]) -> Float[Array, "6 6"]:
    """Mass, and moments about the body's origin along the world's axes [kg, kg.m^2]."""
    moments = jnp.diag(jnp.stack(jnp.broadcast_arrays(*body.shape._moments())))
    turned = body.mass * rotation @ moments @ rotation.T
    zero = jnp.zeros((3, 3))
    return jnp.block([[body.mass * jnp.eye(3), zero], [zero, turned]])


def follow(
    before: HandFrames, after: HandFrames, points: Float[AnyArray, "L 3"], weights: Float[AnyArray, "L"], placed: Pose
) -> Pose:
    """Where an object goes that is held: the rigid motion that comes closest to that of its contacts.

    Least squares over the contacts, by their weights; each counts as a small pad, which goes with its link.

    Args:
        before: of the hand's frames.
        after: of the hand's frames, an instant later.
        points: where each link touches, before [m].
        weights: 0 for links that do not touch.
        placed: where the object stood.
    """
    turns = after.links.rotation @ before.links.rotation.swapaxes(-1, -2)
    pads = PAD * jnp.concatenate([jnp.eye(3), -jnp.eye(3)])
    old = jnp.asarray(points)[:, None] + pads
    new = jnp.einsum("lij,lpj->lpi", turns, old - before.links.origin[:, None]) + after.links.origin[:, None]
    share = jnp.broadcast_to((weights / jnp.sum(weights))[:, None] / len(pads), old.shape[:2])
    return _fit(old.reshape(-1, 3), new.reshape(-1, 3), share.reshape(-1), placed)


def _fit(old: Array, new: Array, share: Array, placed: Pose) -> Pose:
    """Kabsch's rotation between two clouds of points, applied to a pose."""
    middle, goal = share @ old, share @ new
    left, _, right = jnp.linalg.svd((new - goal).T @ (share[:, None] * (old - middle)))
    # The nearest proper rotation, never a reflection.
    turn = left @ jnp.diag(jnp.array([1.0, 1.0, 1.0]).at[2].set(jnp.linalg.det(left @ right))) @ right
    return Pose(goal + turn @ (placed.origin - middle), turn @ placed.rotation)


def motion_between(before: Pose, after: Pose, dt: float | AnyArray) -> Motion:
    """The steady motion that leads from one pose to the other in ``dt`` seconds."""
    turn = after.rotation @ before.rotation.T
    twice_sine = jnp.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    size = jnp.linalg.norm(twice_sine)
    angle = jnp.arctan2(size, jnp.trace(turn) - 1)
    # Of a small turn the angle is the sine.
    factor = jnp.where(size > 0, angle / jnp.where(size > 0, size, 1), 0.5)
    return Motion(jnp.asarray(after.origin - before.origin) / dt, factor * twice_sine / dt)


def moved(placed: Pose, motion: Motion, dt: float | AnyArray) -> Pose:
    """A pose after ``dt`` seconds of a steady motion."""
    turn = rotation_by(motion.angular * dt)
    return Pose(placed.origin + motion.linear * dt, turn @ placed.rotation)


def rotation_by(vector: Array) -> Array:
    """The rotation about a vector by its length [rad]."""
    x, y, z = vector
    cross = jnp.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle2 = x * x + y * y + z * z
    angle = jnp.sqrt(angle2)
    small = angle < 1e-6
    safe = jnp.where(small, 1, angle)
    sine = jnp.where(small, 1 - angle2 / 6, jnp.sin(safe) / safe)
    cosine = jnp.where(small, 0.5 - angle2 / 24, (1 - jnp.cos(safe)) / safe**2)
    return jnp.eye(3) + sine * cross + cosine * cross @ cross


def rest_on(table: Pose, shape: Shape, placed: Pose, motion: Motion) -> tuple[Pose, Motion, Array]:
    """An object lifted out of the table's half space, and whether it had to be; what stands on a table has stopped."""
    up = jnp.asarray(table.rotation)[:, 2]
    height = jnp.asarray(placed.origin - table.origin) @ up - shape._support(Vec(*(-up @ placed.rotation)))
    stands = height <= 0
    lifted = placed.origin - jnp.minimum(height, 0) * up
    stopped = Motion(*(jnp.where(stands, 0, part) for part in motion))
    return Pose(lifted, placed.rotation), stopped, stands
