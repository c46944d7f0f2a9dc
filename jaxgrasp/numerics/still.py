"""Tangents of what does not move, for derivatives that are given by hand."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array


def still(array: Array) -> Array | np.ndarray:
    """Zeros, of the dtype that JAX gives to tangents of integers where it holds such."""
    if jnp.issubdtype(array.dtype, jnp.floating):
        return jnp.zeros_like(array)
    return np.zeros(array.shape, jax.dtypes.float0)
