"""How much harder or softer a hand may squeeze for method B alone to hold the load."""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.force.distribution import split_forces
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics import vec
from jaxgrasp.numerics.vec import Vec


def least_squeeze_factor(grasp: Grasp, wrench: Float[AnyArray, "*#batch 6"]) -> Float[Array, "..."]:
    """The least factor on all squeezing forces with which method B's forces lie inside the friction cones.

    Method B's manipulation forces do not depend on the factor, and its squeezing forces grow with it (eq. 16). So each
    contact is inside its cone for the factors of one interval, whose ends are roots of a quadratic.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].

    Returns:
        ``(...)``, 0 or more; below 1 the hand squeezes harder than it needs. +inf where no factor will do.

    Raises:
        ValueError: for shapes that do not fit.
    """
    split = split_forces(grasp, wrench)
    friction, normals = jnp.asarray(grasp.friction), jnp.asarray(grasp.normals)
    if grasp.present is not None:
        there = jnp.asarray(grasp.present) > 0.5
        friction, normals = jnp.where(there, friction, 0), jnp.where(there[..., None], normals, 0)
    inward = vec.unit(vec.from_axis(normals, -1))
    outer, outer_press = _parts(split.external, inward)
    inner, inner_press = _parts(split.internal, inward)
    low, high = _interval(outer, outer_press, inner, inner_press, friction)
    least, most = jnp.maximum(jnp.max(low, -1), 0), jnp.min(high, -1)
    return jnp.where(least <= most, least, jnp.inf)


def _parts(forces: Array, normals: Vec) -> tuple[Vec, Array]:
    """Across and along the normals."""
    force = vec.from_axis(forces, -1)
    along = vec.dot(force, normals)
    return vec.sub(force, vec.scale(along, normals)), along


def _interval(outer: Vec, outer_press: Array, inner: Vec, inner_press: Array, friction: Array) -> tuple[Array, Array]:
    """The factors x for which outer + x inner lies in its cone; from +inf to -inf where none does.

    Across less than friction times along, squared, is a x^2 + 2 b x + c <= 0; the presses choose the nappe.
    """
    square = friction * friction
    a = vec.dot(inner, inner) - square * inner_press * inner_press
    b = vec.dot(outer, inner) - square * outer_press * inner_press
    c = vec.dot(outer, outer) - square * outer_press * outer_press
    inf = jnp.full_like(a, jnp.inf)
    # Neither root loses its digits where the other is large.
    real = b * b - a * c >= 0
    lead = -b - jnp.where(b >= 0, 1, -1) * vec.safe_sqrt(jnp.where(real, b * b - a * c, 0))
    one, other = vec.safe_divide(lead, a), vec.safe_divide(c, lead)
    one = jnp.where(a == 0, other, one)
    first, last = jnp.minimum(one, other), jnp.maximum(one, other)
    between = real & (outer_press + (first + last) / 2 * inner_press >= 0)
    # Squeezing that leaves its own cone helps for a while at most; squeezing inside it helps in the end.
    low = jnp.where(a > 0, jnp.where(between, first, inf), jnp.where(inner_press > 0, last, -inf))
    high = jnp.where(a > 0, jnp.where(between, last, -inf), jnp.where(inner_press > 0, inf, first))
    idle = (a == 0) & (b == 0)
    inside = (c <= 0) & (outer_press >= 0)
    return jnp.where(idle, jnp.where(inside, -inf, inf), low), jnp.where(idle, jnp.where(inside, inf, -inf), high)
