"""Points about their centroid, in units of their radius; and two directions across a normal."""

from typing import Any, NamedTuple

import jax.numpy as jnp

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
