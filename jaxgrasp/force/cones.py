"""The Coulomb cone of one contact: projection on it, the projection's derivative, and its support.

A force f is allowed when |f - (f.a) a| <= mu f.a (eqs. 2 and 3). Everything is written with the vectors
themselves, so that no tangent basis has to be chosen. A richer contact joins the solver by giving the
same four functions.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import vec
from jaxgrasp.numerics.vec import Vec


class Split(NamedTuple):
    """A vector against a cone: its parts, and on which side it lies."""

    along: Array
    """Component along the normal."""
    tangent: Vec
    """Unit tangential direction; zero where there is none."""
    size: Array
    """Length of the tangential part."""
    inside: Array
    polar: Array
    """Whether the vector lies in the polar cone, whose projection is the apex."""


def split(u: Vec, normal: Vec, friction: Array) -> Split:
    along = vec.dot(u, normal)
    across = vec.sub(u, vec.scale(along, normal))
    size = vec.norm(across)
    tangent = Vec(*(vec.safe_divide(c, size) for c in across))
    # The polar cone first: without friction a pull straight along the normal would pass for inside.
    polar = friction * size < -along
    # Without friction the cone is a ray, which has no inside: what lies on it may move along it alone.
    inside = jnp.logical_not(polar) & (size <= friction * along) & (friction > 0)
    return Split(along, tangent, size, inside, polar)


def contains(u: Vec, normal: Vec, friction: Array) -> Array:
    """Whether ``u`` lies in the cone, rounding aside."""
    along = vec.dot(u, normal)
    across = vec.sub(u, vec.scale(along, normal))
    slack = 8 * jnp.finfo(along.dtype).eps
    limit = friction * along + slack * (1 + friction) * jnp.abs(along)
    return (along >= 0) & (vec.dot(across, across) <= limit * limit)


def project(u: Vec, normal: Vec, friction: Array, parts: Split) -> Vec:
    """The closest point of the cone."""
    height = (parts.along + friction * parts.size) / (1 + friction**2)
    edge = vec.add(normal, vec.scale(friction, parts.tangent))
    zero = Vec(*(jnp.zeros_like(c) for c in u))
    return vec.where(parts.inside, u, vec.where(parts.polar, zero, vec.scale(height, edge)))


def derivative(normal: Vec, friction: Array, parts: Split) -> list[list[Array]]:
    """The projection's derivative by ``u``, a symmetric 3x3 matrix as its lower triangle.

    On the cone's surface and at its apex, where the projection has kinks, one of the limits from its
    sides: an element of the generalised Jacobian.
    """
    on_edge = jnp.logical_not(parts.inside | parts.polar)
    height = (parts.along + friction * parts.size) / (1 + friction**2)
    # The curvature of the cone: moving u across it turns the edge that carries the projection.
    turning = jnp.where(on_edge, vec.safe_divide(friction * height, parts.size), 0)
    along_edge = jnp.where(on_edge, 1 / (1 + friction**2), 0)
    edge = vec.add(normal, vec.scale(friction, parts.tangent))
    isotropic = jnp.where(parts.inside, 1, turning)
    t, a = parts.tangent, normal
    matrix = []
    for i in range(3):
        row = [along_edge * edge[i] * edge[j] - turning * (a[i] * a[j] + t[i] * t[j]) for j in range(i + 1)]
        row[i] = row[i] + isotropic
        matrix.append(row)
    return matrix


def support(direction: Vec, normal: Vec, friction: Array) -> Array:
    """How fast a force of unit normal component can do work along ``direction``: at most this, and zero.

    Scaling the force scales the work, so the cone's support function is zero where this is not positive
    and infinite elsewhere.
    """
    along = vec.dot(direction, normal)
    across = vec.sub(direction, vec.scale(along, normal))
    return along + friction * vec.norm(across)
