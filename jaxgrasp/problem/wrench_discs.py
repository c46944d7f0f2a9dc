"""What a contact exerts for each newton of its normal force: a disc of wrenches, in units where torques are forces.

A contact of normal force 1 exerts c + B u, |u| <= 1. c is the wrench of its normal; the columns of B are those of its
friction along two tangents, and of a soft finger's moment about the normal. Along a twist d it works at most at the
rate c.d + |B^T d|, its support. Every measure of this package is a question about these discs, and none knows more
of a contact.

Wrenches are taken about a point and their torques are divided by a length; twists are of that point, and their
angular velocities are multiplied by it. So both have the units of their first three components, and a product of the
two is still power.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics.geometry import centred, tangents
from jaxgrasp.numerics.no_derivative import nondifferentiable_where

Length = Float[AnyArray, "..."] | float | None
About = Float[AnyArray, "... 3"] | None
Ellipsoid = Float[AnyArray, "... 6 6"] | None


class WrenchDiscs(eqx.Module):
    """Discs of the contacts of a batch of grasps; those of absent contacts are zeros."""

    centres: Float[AnyArray, "*batch n 6"]
    """c: (normal, torque of the normal / length) [1]."""
    spans: Float[AnyArray, "*batch n 6 3"]
    """B: columns for two tangents, and for the moment about the normal [1]."""
    about: Float[AnyArray, "*batch 3"]
    """Where torques are taken [m]."""
    length: Float[AnyArray, "*batch"]
    """What torques are divided by [m]."""


def discs(grasp: Grasp, length: Length = None, about: About = None) -> WrenchDiscs:
    """Return the discs of a grasp, differentiable by every argument.

    Args:
        grasp: contacts ``(..., n)``.
        length: ``(...)`` > 0 [m]. Where not given the root of the mean square of the distances of the present
            contacts from ``about``, or 1 m where they all lie there.
        about: ``(..., 3)`` [m]; where not given the mean of the present contacts' points.
    """
    is_present = jnp.ones(grasp.friction.shape, bool) if grasp.present is None else jnp.asarray(grasp.present) > 0.5
    points = jnp.asarray(grasp.points)
    normals = jnp.where(is_present[..., None], grasp.normals, jnp.eye(3, dtype=points.dtype)[2])
    normals = normals / jnp.sqrt(jnp.sum(normals**2, -1, keepdims=True))
    friction = jnp.where(is_present, grasp.friction, 0)
    torsion = 0 if grasp.torsion is None else jnp.where(is_present & (friction > 0), grasp.torsion, 0)
    centre = None if about is None else jnp.broadcast_to(jnp.asarray(about, points.dtype), (*points.shape[:-2], 3))
    middle, arms, radius = centred(points, is_present, centre)
    unit = jnp.where(radius > 0, radius, 1) if length is None else jnp.asarray(length, points.dtype)
    unit = jnp.broadcast_to(unit, points.shape[:-2])
    arms = arms / unit[..., None, None]

    def wrench(force: Array) -> Array:
        return jnp.concatenate([force, jnp.cross(arms, force)], -1)

    first, second = tangents(normals)
    moment = jnp.concatenate([jnp.zeros_like(normals), normals], -1) * (torsion / unit[..., None])[..., None]
    sliding = [friction[..., None] * wrench(tangent) for tangent in (first, second)]
    return WrenchDiscs(
        centres=jnp.where(is_present[..., None], wrench(normals), 0),
        spans=jnp.stack([*sliding, moment], -1),
        about=middle,
        length=unit,
    )


def measured_discs(
    grasp: Grasp, length: Length, about: About, ellipsoid: Ellipsoid
) -> tuple[WrenchDiscs, Float[Array, "..."]]:
    """Return the discs in coordinates where an ellipsoid of wrenches, if given, is the ball of radius 1.

        Args:
            grasp: contacts ``(..., n)``.
            length: as for ``discs``; without effect beside an ellipsoid.
            about: likewise; the ellipsoid is about it too.
            ellipsoid: its semi-axes [N, N.m] as columns ``(..., 6, 6)``.

        Returns:
    The discs; and the factor by which these coordinates enlarge rounding, relative to the largest disc.
    """
    if ellipsoid is None:
        shapes = discs(grasp, length, about)
        return shapes, jnp.ones_like(shapes.length)
    plain = discs(grasp, 1.0, about)
    columns = jnp.concatenate([jnp.asarray(plain.centres)[..., None], plain.spans], -1)
    axes = jnp.asarray(ellipsoid, columns.dtype)
    inverse = jnp.broadcast_to(jnp.linalg.inv(axes), (*plain.length.shape, 6, 6))
    turned = jnp.einsum("...ij,...njk->...nik", inverse, columns, precision=lax.Precision.HIGHEST)
    before, after = (jnp.sqrt(jnp.max(jnp.sum(a**2, (-1, -2)), -1, initial=0)) for a in (columns, turned))
    growth = jnp.sqrt(jnp.sum(inverse**2, (-1, -2))) * before / jnp.where(after > 0, after, 1)
    shapes = WrenchDiscs(turned[..., 0], turned[..., 1:], plain.about, plain.length)
    return shapes, jnp.maximum(growth, 1)


def scaled_wrench(wrench: Any, about: Any, length: Any, library: Any) -> Any:
    """Wrenches ``(..., 6)`` about other points ``(..., 3)``, their torques divided by lengths, by NumPy or JAX."""
    torque = wrench[..., 3:] - library.cross(about, wrench[..., :3])
    return library.concatenate([wrench[..., :3], torque / length[..., None]], -1)


def work(shapes: WrenchDiscs, normal_force: AnyArray, tangential: AnyArray, direction: AnyArray) -> Array:
    """Power along scaled twists ``(..., 6)`` of normal forces (..., n) and tangential ones (..., n, 3).

    A tangential force is in units of the friction coefficient: its length is at most the normal force.
    """
    along = jnp.einsum("...nj,...j->...n", shapes.centres, direction)
    across = jnp.einsum("...njk,...j->...nk", shapes.spans, direction)
    return jnp.sum(normal_force * along + jnp.sum(tangential * across, -1), -1)


def differentiable_where(defined: Array, value: Array, shapes: WrenchDiscs) -> Array:
    """Return a value ``(...)`` of discs whose derivative by them is NaN where it is not ``defined``."""
    undefined = jnp.broadcast_to(~defined, value.shape)
    centres = jnp.broadcast_to(shapes.centres, value.shape + shapes.centres.shape[-2:])
    spans = jnp.broadcast_to(shapes.spans, value.shape + shapes.spans.shape[-3:])
    return nondifferentiable_where(undefined, value, (centres, spans))
