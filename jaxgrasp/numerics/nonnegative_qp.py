"""Small quadratic programs over numbers that are zero or more."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

STEPS = 60
SHORT_OF = 0.995
"""How much of the way to the boundary a step may go."""


class _Iterate(NamedTuple):
    x: Array
    slope: Array
    """Gradient of the quadratic at x; at the minimum zero where x is not."""
    size: Array
    """Mean of their products: the gap."""
    steps: Array


def minimise_nonnegative(matrix: Array, linear: Array) -> Array:
    """x >= 0 that minimises x.matrix x / 2 + linear.x, by Mehrotra's interior point method.

    Args:
        matrix: symmetric, positive semidefinite ``(m, m)``; a row of zeros leaves its unknown at zero.
        linear: ``(m,)``, in the range of the matrix but for a part that is positive.
    """
    diagonal = jnp.diagonal(matrix)
    used = diagonal > 0
    scale = jnp.where(used, 1 / jnp.sqrt(jnp.where(used, diagonal, 1)), 1)
    scaled = jnp.where(used, linear * scale, 1)
    unit = jnp.maximum(jnp.max(jnp.abs(scaled)), jnp.finfo(matrix.dtype).tiny)
    q = jnp.where(jnp.eye(len(linear)) > 0, 1, matrix * scale * scale[:, None])
    b = scaled / unit
    least = jnp.finfo(matrix.dtype).eps / 64

    def better(iterate: _Iterate) -> _Iterate:
        x, s = iterate.x, iterate.slope
        residual = q @ x + b - s
        system = q + jnp.diag(s / x)

        def direction(product: Array) -> tuple[Array, Array]:
            dx = jnp.linalg.solve(system, -residual + product / x)
            return dx, q @ dx + residual

        ahead, steeper = direction(-x * s)
        step = jnp.minimum(_room(x, ahead), _room(s, steeper))
        foreseen = jnp.mean((x + step * ahead) * (s + step * steeper))
        centred = iterate.size * (foreseen / iterate.size) ** 3
        dx, ds = direction(centred - x * s - ahead * steeper)
        step = SHORT_OF * jnp.minimum(_room(x, dx), _room(s, ds))
        size = jnp.mean((x + step * dx) * (s + step * ds))
        candidate = _Iterate(x + step * dx, s + step * ds, size, iterate.steps + 1)
        # At the end of its digits a step leads nowhere.
        sound = jnp.all(candidate.x > 0) & jnp.all(candidate.slope > 0) & jnp.isfinite(candidate.size)
        ended = iterate._replace(steps=jnp.int32(STEPS))
        return jax.tree.map(lambda new, old: jnp.where(sound, new, old), candidate, ended)

    unit_start = jnp.ones_like(b)
    start = _Iterate(unit_start, unit_start, jnp.asarray(1.0, b.dtype), jnp.int32(0))
    final = lax.while_loop(lambda iterate: (iterate.size > least) & (iterate.steps < STEPS), better, start)
    # Of x and its slope one is zero.
    return jnp.where(used & (final.x > final.slope), final.x * scale * unit, 0)


def _room(x: Array, step: Array) -> Array:
    """Return the largest part of a step, at most 1, that keeps every number positive."""
    return jnp.minimum(1, jnp.min(jnp.where(step < 0, -x / jnp.where(step < 0, step, -1), jnp.inf)))
