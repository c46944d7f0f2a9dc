"""Spatial vectors: wrenches, twists and coordinates of multipliers, batch-last."""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics.vec3 import Vec3

SpatialVec = Array
"""``(6, B)``: linear components over angular ones."""


def join(linear: Vec3, angular: Vec3) -> SpatialVec:
    return jnp.concatenate(jnp.broadcast_arrays(*linear, *angular))


def parts(x: SpatialVec) -> tuple[Vec3, Vec3]:
    """Split a vector into its linear and angular components, each ``(1, B)``."""
    rows = [x[i : i + 1] for i in range(6)]
    return Vec3(*rows[:3]), Vec3(*rows[3:])


def inner(a: Array, b: Array) -> Array:
    """Return the inner product of vectors of six rows or more."""
    return sum(a[i : i + 1] * b[i : i + 1] for i in range(1, len(a))) + a[:1] * b[:1]


def length(x: Array) -> Array:
    return jnp.sqrt(inner(x, x))
