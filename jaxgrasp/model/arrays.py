"""Array types of the public surface."""

import jax
import numpy as np
from jaxtyping import Float, Int

AnyArray = jax.Array | np.ndarray

__all__ = ["AnyArray", "Float", "Int"]
