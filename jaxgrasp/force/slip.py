"""Slip angle and stability margin of each contact."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arguments import check_kind
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics import vec3
from jaxgrasp.validation.checked import check_numbers


def slip_angle(grasp: Grasp, forces: Float[AnyArray, "*batch n 3"]) -> Float[Array, "*batch n"]:
    """Compute the angle of each contact force to its inward normal [rad], 0 (pressing) to pi (pulling); NaN for NaN.

    A contact that carries no force has no angle: it is marked by -inf (its margins by +inf), so that the
    largest angle and the smallest margin of a grasp are those of its loaded contacts. The derivative
    there is zero.
    """
    _check(grasp, forces)
    force, normal = vec3.from_axis(jnp.asarray(forces), -1), vec3.from_axis(jnp.asarray(grasp.normals), -1)
    along = vec3.dot(force, normal)
    across = vec3.norm(vec3.cross(normal, force))
    # A force of NaN is not zero: its angle is NaN too.
    loaded = vec3.dot(force, force) != 0
    if grasp.present is not None:
        loaded = loaded & (jnp.asarray(grasp.present) > 0.5)
    # arctan2 keeps its digits at both ends, where arccos loses half of them.
    angle = jnp.arctan2(jnp.where(loaded, across, 0), jnp.where(loaded, along, 1))
    return jnp.where(loaded, angle, -jnp.inf)


def _check(grasp: Grasp, forces: AnyArray) -> None:
    check_kind(grasp)
    check_numbers("forces", forces, (np.shape(grasp.normals)[-2], 3))


def stability_margin(grasp: Grasp, forces: Float[AnyArray, "*batch n 3"]) -> Float[Array, "*batch n"]:
    """Compute the paper's margin, 90 degrees less the slip angle [rad]: negative if a contact pulls (section II-G)."""
    angle = slip_angle(grasp, forces)
    return jnp.pi / 2 - angle


def friction_margin(
    grasp: Grasp,
    forces: Float[AnyArray, "*batch n 3"],
    moments: Float[AnyArray, "*batch n"] | None = None,
) -> Float[Array, "*batch n"]:
    """Compute the friction angle atan(mu) less the slip angle [rad]: negative where a contact slips or pulls (eq. 2).

    ``moments`` of soft fingers count as the tangential force mu / gamma times as large would, beside it: friction
    resists both together. Where a finger is hard there can be none.

    Example:
        A force on its cone's edge has no margin left; one along the normal has atan(mu):

        >>> import numpy as np
        >>> from jaxgrasp import Grasp, friction_margin
        >>> grasp = Grasp(np.zeros((2, 3)), np.tile([0.0, 0, 1], (2, 1)), friction=np.ones(2), squeeze=np.ones(2))
        >>> np.degrees(friction_margin(grasp, np.array([[1.0, 0, 1], [0.0, 0, 1]]))).round(6).tolist()
        [0.0, 45.0]

    Raises:
        ValueError: for moments with a grasp that has no torsion, or soft fingers without.
    """
    angle = slip_angle(grasp, forces)
    loaded = angle > -jnp.inf
    # An absent contact may have any friction, NaN too.
    friction = jnp.where(loaded, jnp.asarray(grasp.friction), 0)
    spin = spin_force(grasp, moments)
    if spin is not None:
        force, normal = vec3.from_axis(jnp.asarray(forces), -1), vec3.from_axis(jnp.asarray(grasp.normals), -1)
        across = vec3.norm(vec3.cross(normal, force))
        tangential = vec3.safe_sqrt(jnp.where(loaded, across**2 + spin**2, 0))
        angle = jnp.where(loaded, jnp.arctan2(tangential, jnp.where(loaded, vec3.dot(force, normal), 1)), angle)
    return jnp.arctan(friction) - angle


def spin_force(grasp: Grasp, moments: Float[AnyArray, "*batch n"] | None) -> Float[Array, "*batch n"] | None:
    """Compute the tangential forces [N] that use as much friction as moments, mu / gamma times these; None for None.

    Raises:
        ValueError: for moments with a grasp that has no torsion, or soft fingers without.
    """
    if (moments is None) != (grasp.torsion is None):
        state = "None" if moments is None else "given"
        raise ValueError(f"moments is {state}: expected those of the soft fingers, and None where torsion is None")
    if moments is None or grasp.torsion is None:
        return None
    torsion = jnp.asarray(grasp.torsion)
    has_torsion = torsion > 0
    if grasp.present is not None:
        has_torsion = has_torsion & (jnp.asarray(grasp.present) > 0.5)
    ratio = jnp.where(has_torsion, grasp.friction, 0) / jnp.where(has_torsion, torsion, 1)
    return ratio * jnp.where(has_torsion, jnp.asarray(moments), 0)
