"""The tangent of what has no derivative: no number where anything asks for it, and zero where nothing does.

A derivative that is NaN outright would spoil a whole batch: a loss that leaves an element out pulls at it with zero,
and zero times NaN is NaN. So the rule here is a linear map by name only. What moves it, or is pulled through it, comes
out as NaN; zeros come out as zeros.

Tangents of what does not move, for derivatives that are given by hand.
"""

from collections.abc import Callable
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import zero_from_primal
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxgrasp.numerics.iterate import varying_like


def zero_tangent(array: Array) -> Array | np.ndarray:
    """Zeros, of the dtype that JAX gives to tangents of integers where it holds such."""
    if jnp.issubdtype(array.dtype, jnp.floating):
        return varying_like(jnp.zeros_like(array), array)
    return zero_from_primal(array)


def _nan_where_all_move(source: Array, *moves: Array) -> Array:
    """NaN where every one of the moves asks, and zero elsewhere, as without any.

    One move asks for a first derivative, two for a second, and so on: each derivative by the ``source`` is one more.
    """
    if not moves:
        return jnp.zeros_like(source)
    all_move = moves[0] != 0
    for move in moves[1:]:
        all_move = all_move & (move != 0)
    return jnp.where(all_move, jnp.asarray(jnp.nan, source.dtype), jnp.zeros_like(source))


def _tangent(primals, tangents):
    source, *moves = primals
    moved, *moves_moved = tangents
    outputs = [_moved_primitive.bind(source, *moves, moved)] if not isinstance(moved, ad.Zero) else []
    for position, move in enumerate(moves_moved):
        if not isinstance(move, ad.Zero):
            outputs.append(_moved_primitive.bind(source, *moves[:position], move, *moves[position + 1 :]))
    return _moved_primitive.bind(*primals), sum(outputs[1:], outputs[0])


def _transposed(pulled, source, *moves):
    outputs = [None] * (1 + len(moves))
    if not isinstance(pulled, ad.Zero):
        (position,) = [position for position, move in enumerate(moves) if ad.is_undefined_primal(move)]
        outputs[1 + position] = _moved_primitive.bind(source, *moves[:position], pulled, *moves[position + 1 :])
    return outputs


def _mapped(arrays, axes):
    ahead = [x[None] if axis is None else jnp.moveaxis(x, axis, 0) for x, axis in zip(arrays, axes, strict=True)]
    return _moved_primitive.bind(*jnp.broadcast_arrays(*ahead)), 0


_moved_primitive = Primitive("no_derivative")
_moved_primitive.def_impl(jax.jit(_nan_where_all_move))
_moved_primitive.def_abstract_eval(lambda source, *moves: source)
mlir.register_lowering(_moved_primitive, mlir.lower_fun(_nan_where_all_move, multiple_results=False))
batching.primitive_batchers[_moved_primitive] = _mapped
ad.primitive_jvps[_moved_primitive] = _tangent
ad.primitive_transposes[_moved_primitive] = _transposed


def nan_tangents_where(undefined: Array, tangents: Any, sources: Any, moved: Any) -> Any:
    """Tangents ``(*batch, ...)``, made NaN for those ``undefined`` ``(*batch)`` that depend on what has moved.

    ``sources`` are all that they depend on and ``moved`` their tangents, whose leading axes broadcast against the
    batch's. Integers among them do not move; nor do tangents of integers, which stay as they are.
    """

    def per_problem(leaves: list[Array]) -> Array:
        sums = (jnp.sum(leaf, tuple(range(undefined.ndim, leaf.ndim))) for leaf in leaves)
        return sum(sums, jnp.zeros(undefined.shape, leaves[0].dtype))

    # Zero, but what a tangent's own derivative by a source goes through.
    source = per_problem([_moved_primitive.bind(leaf) for leaf in _floats(sources)])
    is_moved = per_problem([_moved_primitive.bind(jnp.zeros_like(leaf), leaf) for leaf in _floats(moved)])

    def without(tangent: Any) -> Any:
        if tangent.dtype == jax.dtypes.float0:
            return tangent

        def spread(array: Array) -> Array:
            return jnp.broadcast_to(array.reshape(*array.shape, *[1] * (tangent.ndim - array.ndim)), tangent.shape)

        # Asked by each of its elements, so that pulls that cancel each other are seen.
        nan_tangent = _moved_primitive.bind(*(spread(array.astype(tangent.dtype)) for array in (source, is_moved)))
        return tangent + jnp.where(spread(undefined), nan_tangent, 0)

    return jax.tree.map(without, tangents)


def refusing(message: str) -> Callable[..., NoReturn]:
    """Return a derivative rule that raises ``message``."""

    def refuse(*_: Any) -> NoReturn:
        raise NotImplementedError(message)

    return refuse


def _floats(tree: Any) -> list[Array]:
    return [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]


@jax.custom_jvp
def nondifferentiable_where(undefined: Array, value: Array, sources: Any) -> Array:
    """Return the value, with a NaN derivative by its ``sources`` where it is ``undefined``; axes as above."""
    return value


@nondifferentiable_where.defjvp
def _underivable_tangent(primals, tangents):
    undefined, value, sources = primals
    _, moved, sources_moved = tangents
    return value, nan_tangents_where(undefined, moved, sources, sources_moved)
