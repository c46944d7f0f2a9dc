"""What contacts exert that may slip: each at most what its friction allows."""

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict


def applied_forces(solution: Solution) -> Float[Array, "*batch n 3"]:
    """A solution's forces as a hand applies them.

    Where they answer nothing, as of a grasp that slips, they have no derivative. A hand applies something even then:
    they count as those that stay as they are while it moves.
    """
    answers = solution.verdict <= Verdict.OUTSIDE_CONES
    return jnp.where(answers[..., None, None], solution.forces, lax.stop_gradient(solution.forces))


def cut_to_cones(grasp: Grasp, forces: Float[AnyArray, "*batch n 3"]) -> Float[Array, "*batch n 3"]:
    """Forces of hard fingers as sliding leaves them: pressed as hard, dragged by as much as friction holds (eq. 2),
    and none where a contact would have to pull (eq. 3)."""
    normals = jnp.asarray(grasp.normals)
    along = jnp.sum(forces * normals, -1)
    across = forces - along[..., None] * normals
    square = jnp.sum(across * across, -1)
    size = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)
    pressed = jnp.maximum(along, 0)
    limit = grasp.friction * pressed
    share = jnp.where(size > limit, limit / jnp.where(size > 0, size, 1), 1)
    return pressed[..., None] * normals + share[..., None] * across


def resultant(points: Float[AnyArray, "*batch n 3"], forces: Float[AnyArray, "*batch n 3"]) -> Float[Array, "*batch 6"]:
    """The wrench of forces at points, about the points' origin."""
    torque = jnp.cross(jnp.asarray(points), forces)
    return jnp.concatenate([jnp.sum(forces, -2), jnp.sum(torque, -2)], -1)
