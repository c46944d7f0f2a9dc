"""Array types of the public surface."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

AnyArray = jax.Array | np.ndarray
Lists = list | tuple
"""Nested lists of numbers."""

__all__ = ["AnyArray", "Float", "Int", "Lists", "from_lists"]


def from_lists(name: str, value: Any) -> Any:
    """A list or tuple of numbers as an array; anything else as it is, since transformations put their own there."""
    if not isinstance(value, list | tuple):
        return value
    try:
        return jnp.asarray(value, float)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} is no array and no nested lists of numbers of equal lengths: {error}") from None
