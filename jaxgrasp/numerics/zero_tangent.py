"""Tangents of what does not move, for derivatives that are given by hand."""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import zero_from_primal

from jaxgrasp.numerics.shard_map_loop import varying_like


def zero_tangent(array: Array) -> Array | np.ndarray:
    """Zeros, of the dtype that JAX gives to tangents of integers where it holds such."""
    if jnp.issubdtype(array.dtype, jnp.floating):
        return varying_like(jnp.zeros_like(array), array)
    return zero_from_primal(array)
