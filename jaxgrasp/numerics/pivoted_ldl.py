"""Positive semidefinite matrices that may be singular: L D L^T with pivots, and a generalised inverse.

Axes are (row, column, batch). Each matrix chooses its own pivots, by masks instead of moves: the largest that
is left, since after a small one rounding would hide where the rank ends.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics.iterate import varying_like


class Factors(NamedTuple):
    """The steps of the elimination, along the first axis."""

    chosen: Array
    """``(k, k, B)``: 1 at the row of each step's pivot, 0 at all others."""
    columns: Array
    """``(k, k, B)``: the column of L of each step, without its 1."""
    inverses: Array
    """``(k, B)``: 1 / pivot; 0 where nothing is left but rounding."""


def factor(a: Array, least: float) -> Factors:
    """Factor ``a``, ``(k, k, B)``, with diagonal pivoting; pivots up to ``least`` count as zeros."""

    def eliminate(carry, _):
        left, free = carry
        diagonal = jnp.where(free > 0, jnp.einsum("iib->ib", left), -1)
        chosen = jax.nn.one_hot(jnp.argmax(diagonal, 0), len(a), axis=0, dtype=a.dtype)
        column = jnp.sum(chosen[None] * left, 1)
        pivot = jnp.sum(chosen * column, 0)
        real = pivot > least
        inverse = jnp.where(real, 1 / jnp.where(real, pivot, 1), 0)
        free = free * (1 - chosen)
        below = free * column * inverse[None]
        return (left - below[:, None] * column[None], free), Factors(chosen, below, inverse)

    _, factors = lax.scan(eliminate, (a, varying_like(jnp.ones(a.shape[1:], a.dtype), a)), length=len(a))
    return factors


def solve(factors: Factors, right: Array) -> Array:
    """x with a x = right, ``(k, B)``, where some x fits; else one that fits a part of it; zeros beyond the rank."""

    def forward(remainder, step):
        chosen, column, inverse = step
        part = jnp.sum(chosen * remainder, 0)
        return remainder - column * part[None], part * inverse

    def backward(x, step):
        (chosen, column, _), part = step
        return x + chosen * (part - jnp.sum(column * x, 0))[None], None

    _, parts = lax.scan(forward, varying_like(right, factors), factors)
    x, _ = lax.scan(backward, varying_like(jnp.zeros_like(right), parts, factors), (factors, parts), reverse=True)
    return x
