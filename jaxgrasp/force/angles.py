"""How far each contact is from slipping."""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics import vec


def slip_angle(grasp: Grasp, forces: Float[AnyArray, "*batch n 3"]) -> Float[Array, "*batch n"]:
    """Angle between each contact force and its inward normal [rad], from 0 (pressing) to pi (pulling).

    A contact that carries no force has no angle: it is marked by -inf (its margins by +inf), so that the
    largest angle and the smallest margin of a grasp are those of its loaded contacts. The derivative
    there is zero.
    """
    force, normal = vec.from_axis(jnp.asarray(forces), -1), vec.from_axis(jnp.asarray(grasp.normals), -1)
    along = vec.dot(force, normal)
    across = vec.norm(vec.cross(normal, force))
    loaded = vec.dot(force, force) > 0
    if grasp.present is not None:
        loaded = loaded & (jnp.asarray(grasp.present) > 0.5)
    # arctan2 keeps its digits at both ends, where arccos loses half of them.
    angle = jnp.arctan2(jnp.where(loaded, across, 0), jnp.where(loaded, along, 1))
    return jnp.where(loaded, angle, -jnp.inf)


def stability_margin(grasp: Grasp, forces: Float[AnyArray, "*batch n 3"]) -> Float[Array, "*batch n"]:
    """The paper's margin, 90 degrees less the slip angle [rad]: negative where a contact pulls (section II-G)."""
    angle = slip_angle(grasp, forces)
    return jnp.pi / 2 - angle


def friction_margin(grasp: Grasp, forces: Float[AnyArray, "*batch n 3"]) -> Float[Array, "*batch n"]:
    """Friction angle atan(mu) less the slip angle [rad]: negative where a contact slips or pulls (eq. 2)."""
    angle = slip_angle(grasp, forces)
    # An absent contact may have any friction, NaN too.
    friction = jnp.where(jnp.isfinite(angle), jnp.asarray(grasp.friction), 0)
    return jnp.arctan(friction) - angle
