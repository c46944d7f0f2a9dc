"""Sixes: wrenches, twists and the dual's unknowns, batch-last."""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics.vec3 import Vec

Six = Array
"""``(6, B)``: linear components over angular ones."""


def six(linear: Vec, angular: Vec) -> Six:
    return jnp.concatenate(jnp.broadcast_arrays(*linear, *angular))


def parts(x: Six) -> tuple[Vec, Vec]:
    """The linear and the angular components, each ``(1, B)``."""
    rows = [x[i : i + 1] for i in range(6)]
    return Vec(*rows[:3]), Vec(*rows[3:])


def inner(a: Array, b: Array) -> Array:
    """Of six rows or more."""
    return sum(a[i : i + 1] * b[i : i + 1] for i in range(1, len(a))) + a[:1] * b[:1]


def length(x: Array) -> Array:
    return jnp.sqrt(inner(x, x))
