"""All forces that give a wrench, in JAX: the pseudo-inverse part, and the projection onto internal forces."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.literature.scaled_batch import ScaledBatch
from jaxgrasp.model.wrench import grasp_matrix

RANK_CUT = 1e-11
"""Singular values of the scaled grasp matrix below this share of the largest count as zero."""
REACH = 1e-9
"""Part of a wrench that forces may leave unbalanced, relative to it, before it counts as out of reach."""


class Internal(NamedTuple):
    """All solutions for one problem of n contacts: forces ``particular + projection @ h`` for any h, flat ``(3n,)``."""

    matrix: Array
    """The grasp matrix ``(6, 3n)``, zero for absent contacts."""
    inverse: Array
    """Its pseudo-inverse."""
    particular: Array
    projection: Array
    """Orthogonal, onto internal forces of contacts that are present ``(3n, 3n)``."""
    reached: Array
    """Whether any forces, allowed or not, give the wrench."""

    def balanced(self, forces: Array, wrench: Array) -> Array:
        """Forces that balance the wrench nearly, moved the least so that they do to rounding."""
        return forces + self.inverse @ (wrench - self.matrix @ forces)


def internal(problem: ScaledBatch) -> Internal:
    """The general solution of G f = w for one problem, by a singular value decomposition."""
    there = jnp.repeat(problem.present, 3)
    matrix = grasp_matrix(problem.arms) * there
    left, sizes, right = jnp.linalg.svd(matrix, full_matrices=False)
    kept = sizes > RANK_CUT * jnp.maximum(sizes[0], jnp.finfo(sizes.dtype).tiny)
    rows = jnp.where(kept[:, None], right, 0)
    inverse = (rows.T * jnp.where(kept, 1 / jnp.where(kept, sizes, 1), 0)) @ left.T
    particular = inverse @ problem.wrench
    particular = particular + inverse @ (problem.wrench - matrix @ particular)
    rest = jnp.linalg.norm(problem.wrench - matrix @ particular)
    size = jnp.linalg.norm(problem.wrench)
    # The load is one, so that a wrench of a few roundings is none.
    reached = rest <= jnp.maximum(REACH * size, 64 * jnp.finfo(sizes.dtype).eps)
    return Internal(matrix, inverse, particular, jnp.diag(there) - rows.T @ rows, reached)
