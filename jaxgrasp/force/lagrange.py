"""The closed form by the paper's first route: the whole Lagrange system, by Gaussian elimination."""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.wrench import grasp_matrix
from jaxgrasp.problem.flatten import refuse_soft_fingers
from jaxgrasp.validation.checked import checked


@checked
def lagrange_forces(
    grasp: Grasp, wrench: Float[AnyArray, "*batch 6"], weights: Float[AnyArray, "*batch n"] | None = None
) -> tuple[Float[Array, "*batch n 3"], Float[Array, "*batch 6"]]:
    """Solve eqs. 7 to 9 for forces and multiplier as one system of 3n + 6 unknowns.

    It shares nothing with [`jaxgrasp.closed_form`][] but the problem, costs O(n^3), and needs a grasp
    matrix of rank 6: on a singular grasp the numbers mean nothing. Absent contacts are not supported.

    Args:
        grasp: contacts ``(..., n)``.
        wrench: what the contacts must exert ``(..., 6)``.
        weights: sharing weights ``(..., n)``; all one (method A) where not given.
    """
    refuse_soft_fingers(grasp)
    points, normals = jnp.asarray(grasp.points), jnp.asarray(grasp.normals)
    squeeze, wrench = jnp.asarray(grasp.squeeze), jnp.asarray(wrench)
    *batch, n, _ = points.shape
    weight = jnp.ones_like(squeeze) if weights is None else jnp.asarray(weights)
    matrix = grasp_matrix(points)
    weighted_rows = jnp.repeat(weight, 3, -1)[..., None] * jnp.swapaxes(matrix, -1, -2)
    identity = jnp.broadcast_to(jnp.eye(3 * n, dtype=points.dtype), (*batch, 3 * n, 3 * n))
    corner = jnp.zeros((*batch, 6, 6), points.dtype)
    system = jnp.block([[identity, -weighted_rows], [matrix, corner]])
    squeezing = (squeeze[..., None] * normals).reshape(*batch, 3 * n)
    right = jnp.concatenate([squeezing, jnp.broadcast_to(wrench, (*batch, 6))], -1)
    coordinates = jnp.linalg.solve(system, right[..., None])[..., 0]
    return coordinates[..., : 3 * n].reshape(*batch, n, 3), coordinates[..., 3 * n :]
