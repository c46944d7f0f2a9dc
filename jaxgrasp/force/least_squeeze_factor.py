"""Least factor on the squeezing forces for method B alone to hold the load."""

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force.distribution import closed_form, split_forces
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import is_balanced
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.no_derivative import nondifferentiable_where
from jaxgrasp.numerics.vec3 import Vec3

NOISE = 64
"""Roundings that are nothing."""


def least_squeeze_factor(grasp: Grasp, wrench: Float[AnyArray, "*#batch 6"]) -> Float[Array, "..."]:
    """Compute the least factor on all squeezing forces with which method B's forces lie inside the friction cones.

    Method B's manipulation forces do not depend on the factor, and its squeezing forces grow with it (eq. 16). So each
    contact is inside its cone for the factors of one interval, whose ends are roots of a quadratic.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].

    Returns:
        ``(...)``, 0 or more; below 1 the hand squeezes harder than it needs. +inf where no factor will do:
        where method B's forces balance nothing (out of range, no squeeze, bad data), too; there is no derivative there
        (NaN).

    Raises:
        ValueError: for soft fingers, or shapes that do not fit.
    """
    split, verdict = split_forces(grasp, wrench), closed_form(grasp, wrench).verdict
    balances = is_balanced(verdict)
    friction, normals = jnp.asarray(grasp.friction), jnp.asarray(grasp.normals)
    if grasp.present is not None:
        present = jnp.asarray(grasp.present) > 0.5
        friction, normals = jnp.where(present, friction, 0), jnp.where(present[..., None], normals, 0)
    inward = vec3.unit(vec3.from_axis(normals, -1))
    # Rounding of larger forces counts as zero: its sign would change the result, without friction its size too.
    # Forces that balance nothing have no derivative; not even zero times it may come in.
    external, internal = (
        jnp.where(balances[..., None, None], forces, 0) for forces in (split.external, split.internal)
    )
    size = jnp.max(jnp.abs(jnp.stack([external, internal])), (0, -2, -1))[..., None]
    noise = NOISE * jnp.finfo(size.dtype).eps * size
    outer, inner = _parts(external, inward, noise), _parts(internal, inward, noise)
    low, high = _interval(*outer, *inner, friction)
    least, most = jnp.maximum(jnp.max(low, -1), 0), jnp.min(high, -1)
    is_held = balances & (least <= most) & jnp.isfinite(least)
    friction = jnp.broadcast_to(friction, (*is_held.shape, friction.shape[-1]))
    return nondifferentiable_where(
        ~is_held, jnp.where(is_held, least, jnp.inf), (split.external, split.internal, friction)
    )


def _parts(forces: Array, normals: Vec3, noise: Array) -> tuple[Vec3, Array]:
    """Split forces into components across and along the normals; components within the noise are zero."""
    force = vec3.from_axis(forces, -1)
    along = vec3.dot(force, normals)
    across = vec3.sub(force, vec3.scale(along, normals))
    # A component that rounds to zero keeps its derivative: only its value is subtracted.
    *tangential, pressed = (
        part - lax.stop_gradient(jnp.where(jnp.abs(part) > noise, 0, part)) for part in (*across, along)
    )
    return Vec3(*tangential), pressed


def _interval(outer: Vec3, outer_press: Array, inner: Vec3, inner_press: Array, friction: Array) -> tuple[Array, Array]:
    """Compute the interval of factors x for which outer + x inner lies in its cone; low above high if empty.

    Across less than friction times along, squared, is a x^2 + 2 b x + c <= 0, a double cone; that outer_press + x
    inner_press is not negative chooses the nappe.
    """
    square = friction * friction
    a = vec3.dot(inner, inner) - square * inner_press * inner_press
    b = vec3.dot(outer, inner) - square * outer_press * inner_press
    c = vec3.dot(outer, outer) - square * outer_press * outer_press
    # Neither root loses its digits where the other is large.
    real = b * b - a * c >= 0
    lead = -b - jnp.where(b >= 0, 1, -1) * vec3.safe_sqrt(jnp.where(real, b * b - a * c, 0))
    # x = (-b -+ sqrt(b^2 - a c)) / a, the other root as c over the numerator of this one.
    first_root, second_root = vec3.safe_divide(lead, a), vec3.safe_divide(c, lead)
    first_root = jnp.where(a == 0, second_root, first_root)
    first, last = jnp.minimum(first_root, second_root), jnp.maximum(first_root, second_root)
    inf = jnp.full_like(a, jnp.inf)
    # Squeezing that leaves its own cone helps for a while at most; squeezing inside it helps in the end.
    within = [jnp.where(real, first, inf), jnp.where(real, last, -inf)]
    beyond = [jnp.where(inner_press > 0, last, -inf), jnp.where(inner_press > 0, inf, first)]
    along = [jnp.where(b < 0, last, -inf), jnp.where(b > 0, first, inf)]
    idle = [jnp.where(c <= 0, -inf, inf), jnp.where(c <= 0, inf, -inf)]
    low, high = (
        jnp.where(a > 0, convex, jnp.where(a < 0, concave, jnp.where(b != 0, linear, constant)))
        for convex, concave, linear, constant in zip(within, beyond, along, idle, strict=True)
    )
    edge = vec3.safe_divide(-outer_press, inner_press)
    never = (inner_press == 0) & (outer_press < 0)
    from_edge = jnp.where(never, inf, jnp.where(inner_press > 0, edge, -inf))
    return jnp.maximum(low, from_edge), jnp.minimum(high, jnp.where(inner_press < 0, edge, inf))
