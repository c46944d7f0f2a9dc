"""Rigid motions of bodies from one instant to the next: their fit to contacts, and their rest on a table.

Quasi-static: a held object follows its contacts; only a slipping or a free object moves by its own inertia.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.hand.shapes import Shape
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose
from jaxgrasp.numerics.geometry import cross_matrix, rotation_by
from jaxgrasp.numerics.vec3 import Vec3

PAD = 2e-3
"""Half the width of the pad that a contact holds [m]: a fingertip turns the object a little."""


class Body(eqx.Module):
    """A rigid object with its centre of mass at its frame's origin."""

    shape: Shape
    """Shape about the centre of mass: use [`jaxgrasp.hand.Shifted`][] where that is not its middle."""
    mass: float | AnyArray
    """[kg]"""
    inertia: Float[AnyArray, "3 3"] | None = None
    """Inertia tensor about the centre of mass, along the frame's axes [kg.m^2]; that of uniform density where not
    given."""

    def inertia_matrix(self) -> Float[Array, "3 3"]:
        """Return the inertia tensor about the centre of mass, along the frame's axes [kg.m^2]."""
        if self.inertia is not None:
            return jnp.asarray(self.inertia)
        moments = jnp.stack(jnp.broadcast_arrays(*self.shape._moments()))
        return jnp.asarray(self.mass) * jnp.diag(moments)


class Motion(NamedTuple):
    """Velocity of a body in the world: of its origin, and angular."""

    linear: Array
    """[m/s]"""
    angular: Array
    """[rad/s]"""


def spatial_inertia(body: Body, rotation: Float[AnyArray, "3 3"]) -> Float[Array, "6 6"]:
    """Return mass and inertia tensor about the body's origin, along the world's axes [kg, kg.m^2]."""
    # I_world = R I R'
    world_inertia = rotation @ body.inertia_matrix() @ rotation.T
    zero = jnp.zeros((3, 3))
    return jnp.block([[body.mass * jnp.eye(3), zero], [zero, world_inertia]])


def guide_at(guide: Float[AnyArray, "6 k"], origin: Float[AnyArray, "*batch 3"]) -> Float[Array, "*batch 6 k"]:
    """Shift a guide's twists from the world's origin to another reference point, along the same axes."""
    linear, angular = jnp.asarray(guide)[:3], jnp.asarray(guide)[3:]
    shifted = linear + jnp.cross(angular, jnp.asarray(origin)[..., None], axis=-2)
    return jnp.concatenate([shifted, jnp.broadcast_to(angular, shifted.shape)], -2)


def mobility(body: Body, placed: Pose, guide: AnyArray | None) -> Float[Array, "6 6"]:
    """Compute the motion for a unit of impulse about the body's origin, M^-1 [1/kg, 1/(kg.m), 1/(kg.m^2)]; with a guide
    F (F' M F)^+ F'."""
    inertia = spatial_inertia(body, placed.rotation)
    if guide is None:
        return jnp.linalg.inv(inertia)
    free = guide_at(guide, placed.origin)
    # Twists are scaled to unit energy, so that their lengths do not matter.
    size = jnp.sqrt(jnp.diagonal(free.T @ inertia @ free))
    free = free / jnp.where(size > 0, size, 1)
    return free @ jnp.linalg.pinv(free.T @ inertia @ free, hermitian=True) @ free.T


def follow(
    before: HandFrames, after: HandFrames, points: Float[AnyArray, "L 3"], weights: Float[AnyArray, "L"], placed: Pose
) -> Pose:
    """Compute the later pose of a held object: the rigid motion closest to that of its contacts.

    Weighted least squares over the contacts; each is a small pad that moves with its link.

    Args:
        before: frames of the hand.
        after: frames of the hand, an instant later.
        points: contact point of each link, before [m].
        weights: weight of each link; 0 without contact.
        placed: pose of the object, before.
    """
    return _fit(*_pads(before, after, points, weights), placed)


def follow_along(
    guide: Float[AnyArray, "6 k"],
    before: HandFrames,
    after: HandFrames,
    points: Float[AnyArray, "L 3"],
    weights: Float[AnyArray, "L"],
    placed: Pose,
    dt: float | AnyArray,
) -> Motion:
    """Compute the motion of an object along its guide that is closest to that of its contacts, fitted as by
    ``follow``."""
    old, new, share = _pads(before, after, points, weights)
    free = guide_at(guide, placed.origin)
    arms = (old - placed.origin)[:, :, None]
    # minimise sum w |(v_k + omega_k x r) q_k - (new - old) / dt|^2 over the coordinates q along the guide
    velocities = (free[:3] + jnp.cross(free[None, 3:], arms, axis=1)) * jnp.sqrt(share)[:, None, None]
    targets = (new - old) * jnp.sqrt(share)[:, None] / dt
    size = jnp.linalg.norm(free, axis=0)
    size = jnp.where(size > 0, size, 1)
    along = jnp.linalg.lstsq((velocities / size).reshape(-1, free.shape[1]), targets.reshape(-1))[0]
    twist = free @ (along / size)
    return Motion(twist[:3], twist[3:])


def _pads(before: HandFrames, after: HandFrames, points: AnyArray, weights: AnyArray) -> tuple[Array, Array, Array]:
    """Return the points of each contact's pad before and after, and their weights."""
    turns = after.links.rotation @ before.links.rotation.swapaxes(-1, -2)
    pads = PAD * jnp.concatenate([jnp.eye(3), -jnp.eye(3)])
    old = jnp.asarray(points)[:, None] + pads
    new = jnp.einsum("lij,lpj->lpi", turns, old - before.links.origin[:, None]) + after.links.origin[:, None]
    share = jnp.broadcast_to((weights / jnp.sum(weights))[:, None] / len(pads), old.shape[:2])
    return old.reshape(-1, 3), new.reshape(-1, 3), share.reshape(-1)


def _fit(old: Array, new: Array, share: Array, placed: Pose) -> Pose:
    """Apply Kabsch's rotation between two clouds of points to a pose."""
    old_mean, new_mean = share @ old, share @ new
    # Kabsch: R = U diag(1, 1, det(U V')) V' of the weighted covariance.
    u, _, vt = jnp.linalg.svd((new - new_mean).T @ (share[:, None] * (old - old_mean)))
    # The nearest proper rotation, never a reflection.
    turn = u @ jnp.diag(jnp.array([1.0, 1.0, 1.0]).at[2].set(jnp.linalg.det(u @ vt))) @ vt
    return Pose(new_mean + turn @ (placed.origin - old_mean), turn @ placed.rotation)


def motion_between(before: Pose, after: Pose, dt: float | AnyArray) -> Motion:
    """Compute the steady motion that leads from one pose to the other in ``dt`` seconds."""
    turn = after.rotation @ before.rotation.T
    # 2 sin(angle) axis from R - R', 1 + 2 cos(angle) from the trace
    twice_sine = jnp.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    size = jnp.linalg.norm(twice_sine)
    angle = jnp.arctan2(size, jnp.trace(turn) - 1)
    # For a small turn the angle equals the sine; the double where keeps the derivative finite at none.
    factor = jnp.where(size > 0, angle / jnp.where(size > 0, size, 1), 0.5)
    return Motion(jnp.asarray(after.origin - before.origin) / dt, factor * twice_sine / dt)


def moved(placed: Pose, motion: Motion, dt: float | AnyArray, guide: AnyArray | None = None) -> Pose:
    """Integrate a pose over ``dt`` seconds of a steady motion: a free body's centre moves on a straight line, a guided
    body moves by one twist, along which it never leaves its guide."""
    turn = rotation_by(motion.angular * dt)
    if guide is None:
        return Pose(placed.origin + motion.linear * dt, turn @ placed.rotation)
    # p + the translation of exp([omega x, v; 0, 0] dt)
    screw = jnp.zeros((4, 4)).at[:3, :3].set(cross_matrix(motion.angular))
    shift = jax.scipy.linalg.expm(screw.at[:3, 3].set(motion.linear) * dt)[:3, 3]
    return Pose(placed.origin + shift, turn @ placed.rotation)


def height_above(table: Pose, shape: Shape, placed: Pose) -> Array:
    """Compute the height of an object's lowest point above a table [m]."""
    up = jnp.asarray(table.rotation)[:, 2]
    return jnp.asarray(placed.origin - table.origin) @ up - shape._support(Vec3(*(-up @ placed.rotation)))
