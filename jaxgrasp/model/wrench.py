"""Wrenches: the grasp matrix that collects contact forces into one, and the one that holds a weight."""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arguments import check_sign
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.validation.checked import check_numbers


def grasp_matrix(points: Float[AnyArray, "*batch n 3"]) -> Float[Array, "*batch 6 3*n"]:
    """Return the grasp matrix G of eq. 1: G f is the wrench about the origin of contact forces f.

    Args:
        points: contact points [m].

    Returns:
        ``(..., 6, 3n)``: force rows over torque rows [m]; column 3i + j belongs to component j of force i.
    """
    check_numbers("points", points, ("n", 3))
    points = jnp.asarray(points)
    *batch, n, _ = points.shape
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    zero = jnp.zeros_like(x)
    arms = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*batch, n, 3, 3)
    identities = jnp.broadcast_to(jnp.eye(3, dtype=points.dtype), arms.shape)
    blocks = jnp.concatenate([identities, arms], -2)
    return jnp.moveaxis(blocks, -3, -2).reshape(*batch, 6, 3 * n)


def weight_wrench(
    mass: Float[AnyArray, "*#batch"] | float,
    center_of_mass: Float[AnyArray, "*#batch 3"],
    gravity: Float[AnyArray, "*#batch 3"],
) -> Float[Array, "*batch 6"]:
    """Return the wrench that contacts must exert to hold a weight.

    Args:
        mass: of the object [kg].
        center_of_mass: in the frame of the contact points [m].
        gravity: acceleration of free fall in that frame [m/s^2], such as (0, 0, -9.81).

    Returns:
        ``(..., 6)``: force [N], then torque about the frame's origin [N.m]; minus the weight's own.

    Example:
        Against gravity the hand pushes up:

        >>> import numpy as np
        >>> from jaxgrasp import weight_wrench
        >>> print(weight_wrench(0.5, np.zeros(3), np.array([0.0, 0.0, -10.0]))[:3] + 0.0)
        [0. 0. 5.]

    Raises:
        TypeError: for what is no array of real numbers.
        ValueError: for vectors of other than three components, or a mass below zero.
    """
    check_numbers("mass", mass)
    check_sign("mass", mass)
    check_numbers("center_of_mass", center_of_mass, (3,))
    check_numbers("gravity", gravity, (3,))
    center_of_mass, gravity = jnp.asarray(center_of_mass), jnp.asarray(gravity)
    force = -jnp.asarray(mass)[..., None] * gravity
    torque = jnp.cross(center_of_mass, force)
    return jnp.concatenate([jnp.broadcast_to(force, torque.shape), torque], -1)
