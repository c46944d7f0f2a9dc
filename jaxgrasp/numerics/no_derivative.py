"""The tangent of what has no derivative: no number where anything asks for it, and zero where nothing does.

A derivative that is NaN outright would spoil a whole batch: a loss that leaves an element out pulls at it with zero,
and zero times NaN is NaN. So the rule here is a linear map by name only. What moves it, or is pulled through it, comes
out as NaN; zeros come out as zeros.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir


def _nan_for_any(array: Array) -> Array:
    return jnp.where(array == 0, array, jnp.nan)


_asked = Primitive("no_derivative")
_asked.def_impl(jax.jit(_nan_for_any))
_asked.def_abstract_eval(lambda aval: aval)
mlir.register_lowering(_asked, mlir.lower_fun(_nan_for_any, multiple_results=False))
batching.defvectorized(_asked)
ad.deflinear(_asked, lambda pulled: [_asked.bind(pulled)])


def without_derivative(undefined: Array, tangent: Any, moved: Any) -> Any:
    """A tangent ``(*batch, ...)``, made NaN for those ``undefined`` ``(*batch)`` that depend on what has moved.

    ``moved`` are the tangents of all that they depend on, whose leading axes broadcast against the batch's. Integers
    among them do not move; nor does a tangent of integers, which stays as it is.
    """
    if tangent.dtype == jax.dtypes.float0:
        return tangent
    floats = [leaf for leaf in jax.tree.leaves(moved) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    own = [jnp.sum(_asked.bind(leaf), tuple(range(undefined.ndim, leaf.ndim))) for leaf in floats]
    asked = sum(own, jnp.zeros(undefined.shape, tangent.dtype)).astype(tangent.dtype)

    def spread(array: Array) -> Array:
        return jnp.broadcast_to(array.reshape(*array.shape, *[1] * (tangent.ndim - array.ndim)), tangent.shape)

    # Asked by each of its elements, so that pulls that cancel each other are seen.
    return tangent + jnp.where(spread(undefined), _asked.bind(spread(asked)), 0)


@jax.custom_jvp
def underivable(undefined: Array, value: Array, sources: Any) -> Array:
    """The value, without a derivative by its ``sources`` where it is ``undefined``; axes as above."""
    return value


@underivable.defjvp
def _underivable_tangent(primals, tangents):
    undefined, value, _ = primals
    _, moved, sources_moved = tangents
    return value, without_derivative(undefined, moved, sources_moved)
