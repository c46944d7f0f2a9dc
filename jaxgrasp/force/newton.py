"""Semismooth Newton ascent on the dual, all lanes of a tile in step, each with a line search of its own.

One evaluation gives value, gradient and Hessian at the trial point; a lane that accepts it takes a new
direction, one that refuses halves its step. So no lane waits for another's line search.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force import dual
from jaxgrasp.force.dual import Six
from jaxgrasp.force.lanes import Lanes
from jaxgrasp.force.pseudo_inverse import Metric, whitened_square
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.numerics import symmetric
from jaxgrasp.numerics.vec import Vec

ARMIJO = 1e-4
SHORTEST_STEP = 1e-10


class Proximal(NamedTuple):
    """The pull -strength/2 |x - centre|^2 that makes a degenerate dual strongly concave."""

    strength: Array
    centre: Six


class Ascent(NamedTuple):
    """Where each lane stands."""

    point: Six
    value: Array
    direction: Six
    slope: Array
    length: Array
    """Step length to try next."""
    steps: Array
    done: Array
    """Converged, or unable to move on."""
    converged: Array


def ascend(
    lanes: Lanes,
    stretch: Vec,
    metric: Metric,
    start: Six,
    frozen: Array,
    limit: int | Array,
    proximal: Proximal | None = None,
) -> Ascent:
    """Maximise the dual (less the proximal pull) from ``start`` in at most ``limit`` evaluations.

    Lanes that are ``frozen`` stay where they are.
    """
    # A grasp that many wrenches share has one column here; where each lane stands is its own.
    frozen = jnp.broadcast_to(frozen, start[:1].shape)
    zero = jnp.zeros_like(start[:1])
    nothing = jnp.zeros_like(start)
    steps = jnp.zeros_like(frozen, jnp.int32)
    state = Ascent(start, zero - jnp.inf, nothing, zero, zero, steps, frozen, frozen)

    def unfinished(carry):
        count, state = carry
        return (count < limit) & ~jnp.all(state.done)

    def advance(carry):
        count, state = carry
        return count + 1, _advance(lanes, stretch, metric, proximal, state)

    _, state = lax.while_loop(unfinished, advance, (jnp.int32(0), state))
    return state


def _advance(lanes: Lanes, stretch: Vec, metric: Metric, proximal: Proximal | None, state: Ascent) -> Ascent:
    trial = state.point + state.length * state.direction
    at = dual.evaluate(lanes, trial, stretch)
    value, ascent, curvature = at.value, at.gradient, at.curvature
    if proximal is not None:
        value, ascent, curvature = _pulled(at, trial, proximal)
    eps = jnp.finfo(value.dtype).eps
    noise = 8 * eps * (1 + jnp.abs(value))
    better = value >= state.value + ARMIJO * state.length * state.slope - noise
    accepted = better & ~state.done
    size2 = whitened_square(metric, ascent)
    converged = has_converged(lanes, trial, ascent, size2, value, at.push)
    direction = _direction(metric, curvature, ascent, _damping(size2, proximal))
    slope = dual.inner(ascent, direction)
    halved = jnp.where(accepted, 1, state.length / 2)
    stuck = ~accepted & (halved < SHORTEST_STEP)

    return Ascent(
        point=jnp.where(accepted, trial, state.point),
        value=jnp.where(accepted, value, state.value),
        direction=jnp.where(accepted, direction, state.direction),
        slope=jnp.where(accepted, slope, state.slope),
        length=jnp.where(state.done, state.length, halved),
        # The look at the starting point, of length zero, is no step.
        steps=state.steps + (~state.done & (state.length > 0)).astype(jnp.int32),
        done=state.done | stuck | (accepted & converged),
        converged=state.converged | (accepted & converged),
    )


def _pulled(at: dual.Value, trial: Six, proximal: Proximal):
    """Value, gradient and curvature with the proximal pull."""
    offset, rho = trial - proximal.centre, proximal.strength
    value = at.value - rho * dual.inner(offset, offset) / 2
    gradient = at.gradient - rho * offset
    curvature = [list(row) for row in at.curvature]
    for i in range(6):
        curvature[i][i] = curvature[i][i] + rho
    return value, gradient, curvature


def has_converged(
    lanes: Lanes, point: Six, gradient: Six, size2: Array, value: Array, push: Array, slack: float = 1.0
) -> Array:
    """Whether residual and duality gap are at the rounding that forces of this size allow, times ``slack``."""
    tol = tolerances(value.dtype)
    gap = jnp.abs(dual.inner(point, gradient))
    own = jnp.sum(dual.spread(lanes, Vec(*(jnp.zeros_like(c) for c in lanes.normals))), 0, keepdims=True)
    balanced = size2 <= (slack * tol.gradient * (1 + push)) ** 2
    return balanced & (gap <= slack * tol.gap * jnp.maximum(jnp.abs(value), own))


def _damping(size2: Array, proximal: Proximal | None) -> Array:
    """In proportion to the residual, so that a singular Hessian bends the direction only mildly.

    It vanishes with the residual: convergence stays quadratic. A proximal pull makes it needless, and
    where the multiplier must run far it would be in the way.
    """
    floor = 16 * jnp.finfo(size2.dtype).eps
    return floor + (jnp.zeros_like(size2) if proximal else jnp.minimum(1e-3, 1e-3 * jnp.sqrt(size2)))


def _direction(metric: Metric, curvature: symmetric.Lower, gradient: Six, damping: Array) -> Six:
    """Newton's direction, damped in the metric of the unconstrained problem."""
    damped = [list(row) for row in curvature]
    for i in range(3):
        damped[i][i] = damped[i][i] + damping
        for j in range(i + 1):
            damped[3 + i][3 + j] = damped[3 + i][3 + j] + damping * metric.inertia[i][j]
    return jnp.concatenate(symmetric.solve(symmetric.factor(damped), [gradient[i : i + 1] for i in range(6)]))
