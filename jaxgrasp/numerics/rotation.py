"""Rotation matrices."""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike


def rotation_by(vector: Array) -> Array:
    """Return the rotation about a vector by its length [rad]."""
    x, y, z = vector
    cross = cross_matrix(vector)
    angle2 = x * x + y * y + z * z
    angle = jnp.sqrt(angle2)
    small = angle < 1e-6
    safe = jnp.where(small, 1, angle)
    sine = jnp.where(small, 1 - angle2 / 6, jnp.sin(safe) / safe)
    cosine = jnp.where(small, 0.5 - angle2 / 24, (1 - jnp.cos(safe)) / safe**2)
    return jnp.eye(3) + sine * cross + cosine * cross @ cross


def rotation_about(axis: ArrayLike, angle: ArrayLike) -> Array:
    """Return the rotation about an axis of any length; smooth in the angle, at zero too."""
    cross = cross_matrix(unit(axis))
    return jnp.eye(3) + jnp.sin(angle) * cross + (1 - jnp.cos(angle)) * cross @ cross


def cross_matrix(vector: Array) -> Array:
    """Return the matrix whose product with another vector is the cross product."""
    x, y, z = vector
    return jnp.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def unit(vector: ArrayLike) -> Array:
    """Return a vector's direction; the vector must not be zero."""
    vector = jnp.asarray(vector)
    return vector / jnp.linalg.norm(vector)


def is_rotation(matrices: np.ndarray, rounding: float) -> np.ndarray | np.bool_:
    """Return a mask of the matrices ``(..., 3, 3)`` that are rotations, up to ``rounding`` in products of columns."""
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.abs(matrices @ matrices.swapaxes(-1, -2) - np.eye(3)).max((-1, -2))
        return (square <= rounding) & (np.linalg.det(matrices) > 0)
