"""Semismooth Newton ascent on the dual, all lanes of a tile in step, each with a line search of its own.

One evaluation gives value, gradient and Hessian at the trial point; a lane that accepts it takes a new
direction, one that refuses cuts its step. So no lane waits for another's line search.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force import dual, sixes
from jaxgrasp.force.answer import measure
from jaxgrasp.force.fours import Four
from jaxgrasp.force.lanes import Lanes
from jaxgrasp.force.pseudo_inverse import Metric, whitened_square
from jaxgrasp.force.sixes import Six
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.force.unknowns import Unknowns
from jaxgrasp.numerics import symmetric, vec

ARMIJO = 1e-4
SHORTEST_STEP = 1e-10
CUTS = (0.1, 0.5)
"""A refused step is cut to between these parts of its length."""
DAMPING, MOST_DAMPING = 0.03, 0.1
"""Damping of a direction by the residual, and its limit; in the metric of the unconstrained problem."""


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
    caution: Array
    """How many times the usual damping the next direction gets: more where the last ones overshot."""
    size2: Array
    """Squared residual at ``point``; 0 before anything was evaluated."""
    steps: Array
    done: Array
    """At the optimum as far as can be told from here, or stuck."""
    stuck: Array
    """Unable to move on."""


def ascend(
    lanes: Lanes,
    unknowns: Unknowns,
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
    state = Ascent(start, zero - jnp.inf, nothing, zero, zero, zero + 1, zero, steps, frozen, frozen)

    def unfinished(carry):
        count, state = carry
        return (count < limit) & ~jnp.all(state.done)

    def advance(carry):
        count, state = carry
        return count + 1, _advance(lanes, unknowns, metric, proximal, state)

    _, state = lax.while_loop(unfinished, advance, (jnp.int32(0), state))
    return state


def _advance(lanes: Lanes, unknowns: Unknowns, metric: Metric, proximal: Proximal | None, state: Ascent) -> Ascent:
    trial = state.point + state.length * state.direction
    at = dual.evaluate(lanes, trial, unknowns)
    value, ascent, curvature = at.value, at.gradient, at.curvature
    if proximal is not None:
        value, ascent, curvature = _pulled(at, trial, proximal)
    size2 = whitened_square(metric, ascent)
    accepted = _is_better(state, trial, value, size2) & ~state.done
    caution = _caution(state)
    direction = _direction(metric, curvature, ascent, _damping(size2, caution, proximal))
    arrived = has_converged(lanes, trial, ascent, size2, value, at.push)
    leap = ~arrived & _next_arrives(state, size2)
    length = jnp.where(accepted, 1, state.length * _cut(state, ascent))
    stuck = ~accepted & ~state.done & (length < SHORTEST_STEP)

    return Ascent(
        point=jnp.where(accepted, jnp.where(leap, trial + direction, trial), state.point),
        value=jnp.where(accepted, value, state.value),
        direction=jnp.where(accepted, direction, state.direction),
        slope=jnp.where(accepted, sixes.inner(ascent, direction), state.slope),
        length=jnp.where(state.done, state.length, length),
        caution=jnp.where(accepted, caution, state.caution),
        size2=jnp.where(accepted, size2, state.size2),
        # The look at the starting point, of length zero, is no step.
        steps=state.steps + (~state.done & (state.length > 0)) + (accepted & leap),
        done=state.done | stuck | (accepted & (arrived | leap)),
        stuck=state.stuck | stuck,
    )


def _is_better(state: Ascent, trial: Six, value: Array, size2: Array) -> Array:
    """Whether the value rises enough, rounding aside.

    It is a difference of numbers as large as the multiplier: where that hides the rise, a smaller residual shows it.
    """
    eps = jnp.finfo(value.dtype).eps
    rise = value - state.value - ARMIJO * state.length * state.slope
    noise = 8 * eps * (1 + jnp.abs(value))
    return (rise >= -noise) | ((rise >= -noise - 8 * eps * sixes.length(trial)) & (size2 < state.size2))


def _next_arrives(state: Ascent, size2: Array) -> Array:
    """Whether the next full step will land at the optimum, so that it can be taken without looking there.

    Close to the optimum the residual falls as its own square; the last step's fall gives the factor. Whoever
    reads the point judges it anyway.
    """
    wanted = 0.1 * tolerances(size2.dtype).gradient
    quadratic = size2**3 <= (wanted * state.size2) ** 2
    return (state.length == 1) & (size2 < 1e-8) & quadratic


def _caution(state: Ascent) -> Array:
    """More where only a part of the last step was any good, less again with every step that was good as a whole."""
    shortened = (state.length > 0) & (state.length < 1)
    more = state.caution / jnp.where(shortened, jnp.maximum(state.length, 1e-3), 1)
    return jnp.where(shortened, more, jnp.maximum(state.caution / 10, 1))


def _cut(state: Ascent, ascent: Six) -> Array:
    """How much to shorten a refused step.

    The slope along the line falls from positive to negative, and mostly late, beyond the kink that was not
    foreseen: where its chord meets zero, the value is still rising.
    """
    overshot = jnp.maximum(-sixes.inner(ascent, state.direction), state.slope)
    return jnp.clip(2 * vec.safe_divide(state.slope, state.slope + overshot), *CUTS)


def _pulled(at: dual.Value, trial: Six, proximal: Proximal):
    """Value, gradient and curvature with the proximal pull."""
    offset, rho = trial - proximal.centre, proximal.strength
    value = at.value - rho * sixes.inner(offset, offset) / 2
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
    return is_within(lanes, point, gradient, size2, value, push, slack * tol.gradient, slack * tol.gap)


def is_within(
    lanes: Lanes, point: Six, gradient: Six, size2: Array, value: Array, push: Array, residual: float, gap: float
) -> Array:
    """Whether the residual, beside the forces, and the duality gap, beside the objective, are as small as that."""
    balanced = size2 <= (residual * (1 + push)) ** 2
    scale = jnp.maximum(jnp.abs(value), dual.price_of_nothing(lanes))
    return balanced & (jnp.abs(sixes.inner(point, gradient)) <= gap * scale)


def is_optimal(lanes: Lanes, unknowns: Unknowns, metric: Metric, point: Six, best: Four, slack: float = 1.0) -> Array:
    """Whether the best forces for ``point`` balance the wrench, so that both are optimal."""
    found = measure(lanes, best, unknowns)
    rest = unknowns.wrench(*sixes.parts(found.rest))
    return has_converged(lanes, point, rest, whitened_square(metric, rest), found.objective, found.push, slack)


def _damping(size2: Array, caution: Array, proximal: Proximal | None) -> Array:
    """In proportion to the residual, so that a singular Hessian, as of contacts that have let go, gives a direction
    of sensible length.

    It vanishes with the residual: convergence stays quadratic. A proximal pull makes it needless, and
    where the multiplier must run far it would be in the way.
    """
    floor = 16 * jnp.finfo(size2.dtype).eps
    if proximal is not None:
        # Unless kinks keep cutting the steps short.
        return floor + jnp.minimum(proximal.strength * (caution - 1), MOST_DAMPING)
    return floor + jnp.minimum(DAMPING * caution * jnp.sqrt(size2), MOST_DAMPING)


def _direction(metric: Metric, curvature: symmetric.Lower, gradient: Six, damping: Array) -> Six:
    """Newton's direction, damped in the metric of the unconstrained problem."""
    damped = [list(row) for row in curvature]
    for i in range(3):
        damped[i][i] = damped[i][i] + damping
        for j in range(i + 1):
            damped[3 + i][3 + j] = damped[3 + i][3 + j] + damping * metric.inertia[i][j]
    return dual.solve(symmetric.factor(damped), gradient)
