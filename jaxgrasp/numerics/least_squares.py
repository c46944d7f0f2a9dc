"""Nonlinear least squares by Levenberg's damped steps.

One evaluation a step, written down once: of residuals as large as a whole hand's kinematics a solver that writes
them down for each of its branches takes a minute to compile.
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
