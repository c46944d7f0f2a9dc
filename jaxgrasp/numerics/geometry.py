"""Rotation matrices, points about their centroid in units of their radius, and two directions across a normal."""

from typing import Any, NamedTuple

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


Module = Any
"""``jax.numpy`` or ``numpy``, whose arrays are handed in and out."""
BLUR = 16
"""Roundings of where points are that a distance between them has to exceed."""


class Centred(NamedTuple):
    """Points of each problem about a point of their own."""

    middle: Any
    """``(..., 3)``."""
    arms: Any
    """Points less the middle ``(..., n, 3)``; zero where one is absent."""
    radius: Any
    """Root of the mean square of the arms ``(...)``; 0 where that is only rounding of the middle."""


def centred(points: Any, present: Any, middle: Any = None, numpy: Module = jnp) -> Centred:
    """Return the present points about their mean, or about a given ``middle``."""
    count = numpy.maximum(numpy.sum(present, -1), 1)
    points = numpy.where(present[..., None], points, 0)
    if middle is None:
        middle = numpy.sum(points, -2) / count[..., None]
    arms = numpy.where(present[..., None], points - middle[..., None, :], 0)
    square = numpy.sum(arms**2, (-1, -2)) / count
    blur = BLUR * numpy.finfo(square.dtype).eps * numpy.sqrt(numpy.sum(middle**2, -1))
    # Points that coincide but for the rounding of their mean have no radius of their own.
    spread = square > blur**2
    # The root's derivative at zero is no number.
    return Centred(middle, arms, numpy.where(spread, numpy.sqrt(numpy.where(spread, square, 1)), 0))


def tangents(normals: Any, numpy: Module = jnp) -> tuple[Any, Any]:
    """Two unit vectors across each normal ``(..., 3)``, the first one across the coordinate axis least along it.

    Both are zero where the normal is.
    """
    axis = numpy.eye(3, dtype=normals.dtype)[numpy.argmin(numpy.abs(normals), -1)]
    across = numpy.cross(normals, axis)
    square = numpy.sum(across**2, -1, keepdims=True)
    first = across / numpy.sqrt(numpy.where(square > 0, square, 1))
    return first, numpy.cross(normals, first)
