"""Forces and velocities of contacts: three components and, of soft fingers, a fourth about the normal.

The fourth, the spin, is the moment over the finger's spin radius gamma / mu, and the speed of turning times it: in
these units tangential force and moment use the same friction, so that a soft finger's limit is a round cone in four
dimensions.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.vec3 import Vec3


class ContactVec(NamedTuple):
    """A force or a velocity of every contact."""

    linear: Vec3
    spin: Array | None = None
    """None where all contacts are hard."""


def add(a: ContactVec, b: ContactVec) -> ContactVec:
    return ContactVec(vec3.add(a.linear, b.linear), None if a.spin is None or b.spin is None else a.spin + b.spin)


def sub(a: ContactVec, b: ContactVec) -> ContactVec:
    return ContactVec(vec3.sub(a.linear, b.linear), None if a.spin is None or b.spin is None else a.spin - b.spin)


def scale(factor: Array, a: ContactVec) -> ContactVec:
    return ContactVec(vec3.scale(factor, a.linear), None if a.spin is None else factor * a.spin)


def dot(a: ContactVec, b: ContactVec) -> Array:
    linear = vec3.dot(a.linear, b.linear)
    return linear if a.spin is None or b.spin is None else linear + a.spin * b.spin


def norm(a: ContactVec) -> Array:
    """Length; zero has derivative zero instead of NaN."""
    return vec3.safe_sqrt(dot(a, a))


def where(condition: Array, a: ContactVec, b: ContactVec) -> ContactVec:
    spin = None if a.spin is None or b.spin is None else jnp.where(condition, a.spin, b.spin)
    return ContactVec(vec3.where(condition, a.linear, b.linear), spin)


def along(size: Array, a: Vec3, like: ContactVec) -> ContactVec:
    """``size`` along the unit vectors ``a``, without spin, in as many components as ``like`` has."""
    return ContactVec(vec3.scale(size, a), None if like.spin is None else jnp.zeros_like(like.spin))


def components(a: ContactVec) -> tuple[Array, ...]:
    return (*a.linear,) if a.spin is None else (*a.linear, a.spin)


def of_components(parts: tuple[Array, ...] | list[Array]) -> ContactVec:
    return ContactVec(Vec3(*parts[:3]), parts[3] if len(parts) == 4 else None)
