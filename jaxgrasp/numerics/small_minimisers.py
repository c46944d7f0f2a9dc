"""Small dense minimisations inside ``jit``: nonlinear least squares, and quadratics over numbers of zero or more.

Least squares go by Levenberg's damped steps. One evaluation a step, written down once: of residuals as large as a whole
hand's kinematics a solver that writes them down for each of its branches takes a minute to compile.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.scipy.linalg import solve_triangular

FIRST_DAMPING, GROWTH, DECAY = 1e-2, 4.0, 1 / 3
"""Damping of the first step, and its factors after a step that failed and after one that did not."""


class LeastSquaresResult(NamedTuple):
    """Minimiser of a sum of squares, and whether the search converged."""

    point: Array
    residuals: Array
    cost: Array
    """Sum of the squares."""


class _Step(NamedTuple):
    best: LeastSquaresResult
    jacobian: Array
    """At the best point."""
    proposed: Array
    damping: Array


def least_squares(residuals: Callable[[Array], Array], start: Array, steps: int) -> LeastSquaresResult:
    """Go down the sum of squares of residuals from a point, in so many steps; works under ``vmap``.

    Args:
        residuals: ``(n,)`` to ``(m,)``, in units such that all count alike.
        start: where it begins ``(n,)``, in units such that all unknowns may change alike.
        steps: each costs one Jacobian, whether it succeeds or not.
    """

    def look(point: Array) -> tuple[Array, Array]:
        value = residuals(point)
        return value, value

    def advance(step: _Step, _: None) -> tuple[_Step, None]:
        jacobian, value = jax.jacfwd(look, has_aux=True)(step.proposed)
        trial = LeastSquaresResult(step.proposed, value, jnp.sum(value**2))
        # A NaN is no improvement.
        better = trial.cost < step.best.cost
        best, jacobian = jax.tree.map(
            lambda new, old: jnp.where(better, new, old), (trial, jacobian), (step.best, step.jacobian)
        )
        damping = step.damping * jnp.where(better, DECAY, GROWTH)
        damped = jnp.concatenate([jacobian, jnp.sqrt(damping) * jnp.eye(len(start), dtype=value.dtype)])
        q, r = jnp.linalg.qr(damped)
        down = solve_triangular(r, q[: len(value)].T @ best.residuals)
        return _Step(best, jacobian, best.point - down, damping), None

    shape = jax.eval_shape(residuals, start)
    no_result = LeastSquaresResult(start, jnp.zeros(shape.shape, shape.dtype), jnp.asarray(jnp.inf, shape.dtype))
    first = _Step(
        no_result,
        jnp.zeros((*shape.shape, len(start)), shape.dtype),
        start,
        jnp.asarray(FIRST_DAMPING, shape.dtype),
    )
    last, _ = lax.scan(advance, first, length=steps)
    return last.best


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
