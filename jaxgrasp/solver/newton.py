"""Semismooth Newton ascent on the dual, all lanes of a tile in step, each with a line search of its own.

One evaluation gives value, gradient and Hessian at the trial point; a lane that accepts it takes a new
direction, one that refuses cuts its step. So no lane waits for another's line search.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.coordinates import Coordinates
from jaxgrasp.solver.dual import DualEvaluation
from jaxgrasp.solver.pseudo_inverse import Metric, squared_norm
from jaxgrasp.solver.result import Measurement, measure_forces

ARMIJO = 1e-4
SHORTEST_STEP = 1e-10
STEP_REDUCTIONS = (0.1, 0.5)
"""A refused step is cut to between these parts of its length."""
DAMPING, LARGEST_DAMPING = 0.03, 0.1
"""Damping of a direction by the residual, and its limit; in the metric of the unconstrained problem."""
LOOSE_FACTOR = 16.0
"""In the end an answer may be this much coarser: near the limit of what the contacts can exert, the multiplier is so
large that its own rounding stands in the way."""


class ProximalTerm(NamedTuple):
    """The pull -strength/2 |x - centre|^2 that makes a degenerate dual strongly concave."""

    strength: Array
    """A scalar; 0 for the dual as it is."""
    centre: SpatialVec


@runtime_checkable
class ConcaveObjective(Protocol):
    """What is climbed: a concave function of a few unknowns in each lane, perhaps with a ridge along some of them."""

    def look(self, point: Array) -> Any:
        """Value, gradient, minus Hessian and the sum of normal forces, by the names that ``dual.Value`` has."""
        ...

    def size2(self, gradient: Array) -> Array:
        """Squared length of a gradient, as the contacts see it."""
        ...

    def direction(self, at: Any, point: Array, caution: Array) -> Array:
        """Newton's, damped by the gradient and ``caution`` times more than usual."""
        ...

    def arrived(self, at: Any, point: Array) -> Array:
        """Whether the point is the top, as far as rounding lets it be told."""
        ...

    def onto(self, start: Array, trial: Array) -> Array:
        """The trial point, stopped at the ridges between it and the start."""
        ...


class DualObjective(NamedTuple):
    """The dual as a hill, which has no ridges."""

    lanes: ContactData
    unknowns: Coordinates
    metric: Metric
    proximal: ProximalTerm | None = None

    def look(self, point: SpatialVec) -> DualEvaluation:
        at = dual.evaluate(self.lanes, point, self.unknowns)
        return at if self.proximal is None else _with_proximal_term(at, point, self.proximal)

    def size2(self, gradient: SpatialVec) -> Array:
        return squared_norm(self.metric, gradient)

    def direction(self, at: DualEvaluation, point: SpatialVec, caution: Array) -> SpatialVec:
        damping = damping_of(self.size2(at.gradient), caution, self.proximal)
        return dual.solve(ldl.factor(damped(at.curvature, self.metric, damping)), at.gradient)

    def arrived(self, at: DualEvaluation, point: SpatialVec) -> Array:
        return has_converged(self.lanes, point, at.gradient, self.size2(at.gradient), at.value, at.push)

    def onto(self, start: SpatialVec, trial: SpatialVec) -> SpatialVec:
        return trial


class NewtonState(NamedTuple):
    """Where each lane stands."""

    point: Array
    value: Array
    direction: Array
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


def maximise(hill: ConcaveObjective, start: Array, frozen: Array, limit: int | Array) -> NewtonState:
    """Climb from ``start`` in at most ``limit`` evaluations; lanes that are ``frozen`` stay where they are."""
    # A grasp that many wrenches share has one column here; where each lane stands is its own.
    frozen = jnp.broadcast_to(frozen, start[:1].shape)
    zero = jnp.zeros_like(start[:1])
    nothing = jnp.zeros_like(start)
    steps = jnp.zeros_like(frozen, jnp.int32)
    state = NewtonState(start, zero - jnp.inf, nothing, zero, zero, zero + 1, zero, steps, frozen, frozen)
    state = varying_like(state, start, hill)

    def unfinished(carry):
        count, state = carry
        return (count < limit) & ~jnp.all(state.done)

    def advance(carry):
        count, state = carry
        return count + 1, _advance(hill, state)

    _, state = lax.while_loop(unfinished, advance, (jnp.int32(0), state))
    return state


@fused_cpu_kernel
def _advance(hill: ConcaveObjective, state: NewtonState) -> NewtonState:
    trial = hill.onto(state.point, state.point + state.length * state.direction)
    at = hill.look(trial)
    size2 = hill.size2(at.gradient)
    accepted = _is_better(state, trial, at.value, size2) & ~state.done
    caution = _next_damping_factor(state)
    direction = hill.direction(at, trial, caution)
    arrived = hill.arrived(at, trial)
    leap = ~arrived & _converges_next(state, size2)
    length = jnp.where(accepted, 1, state.length * _step_reduction(state, at.gradient))
    stuck = ~accepted & ~state.done & (length < SHORTEST_STEP)
    landed = jnp.where(leap, hill.onto(trial, trial + direction), trial)

    return NewtonState(
        point=jnp.where(accepted, landed, state.point),
        value=jnp.where(accepted, at.value, state.value),
        direction=jnp.where(accepted, direction, state.direction),
        slope=jnp.where(accepted, spatial.inner(at.gradient, direction), state.slope),
        length=jnp.where(state.done, state.length, length),
        caution=jnp.where(accepted, caution, state.caution),
        size2=jnp.where(accepted, size2, state.size2),
        # The look at the starting point, of length zero, is no step.
        steps=state.steps + _as_count(~state.done & (state.length > 0)) + _as_count(accepted & leap),
        done=state.done | stuck | (accepted & (arrived | leap)),
        stuck=state.stuck | stuck,
    )


def _as_count(condition: Array) -> Array:
    return condition.astype(jnp.int32)


def _is_better(state: NewtonState, trial: Array, value: Array, size2: Array) -> Array:
    """Whether the value rises enough, rounding aside.

    It is a difference of numbers as large as the multiplier: where that hides the rise, a smaller residual shows it.
    """
    eps = jnp.finfo(value.dtype).eps
    rise = value - state.value - ARMIJO * state.length * state.slope
    noise = 8 * eps * (1 + jnp.abs(value))
    return (rise >= -noise) | ((rise >= -noise - 8 * eps * spatial.length(trial)) & (size2 < state.size2))


def _converges_next(state: NewtonState, size2: Array) -> Array:
    """Whether the next full step will land at the optimum, so that it can be taken without looking there.

    Close to the optimum the residual falls as its own square; the last step's fall gives the factor. Whoever
    reads the point judges it anyway.
    """
    wanted = 0.1 * tolerances(size2.dtype).gradient
    quadratic = size2**3 <= (wanted * state.size2) ** 2
    return (state.length == 1) & (size2 < 1e-8) & quadratic


def _next_damping_factor(state: NewtonState) -> Array:
    """More where only a part of the last step was any good, less again with every step that was good as a whole."""
    shortened = (state.length > 0) & (state.length < 1)
    more = state.caution / jnp.where(shortened, jnp.maximum(state.length, 1e-3), 1)
    return jnp.where(shortened, more, jnp.maximum(state.caution / 10, 1))


def _step_reduction(state: NewtonState, ascent: Array) -> Array:
    """How much to shorten a refused step.

    The slope along the line falls from positive to negative, and mostly late, beyond the kink that was not
    foreseen: where its chord meets zero, the value is still rising.
    """
    overshot = jnp.maximum(-spatial.inner(ascent, state.direction), state.slope)
    return jnp.clip(2 * vec3.safe_divide(state.slope, state.slope + overshot), *STEP_REDUCTIONS)


def _with_proximal_term(at: DualEvaluation, trial: SpatialVec, proximal: ProximalTerm) -> DualEvaluation:
    """Value, gradient and curvature with the proximal pull."""
    offset, rho = trial - proximal.centre, proximal.strength
    curvature = [list(row) for row in at.curvature]
    for i in range(6):
        curvature[i][i] = curvature[i][i] + rho
    value = at.value - rho * spatial.inner(offset, offset) / 2
    return DualEvaluation(value, at.gradient - rho * offset, curvature, at.push)


def has_converged(
    lanes: ContactData,
    point: SpatialVec,
    gradient: SpatialVec,
    size2: Array,
    value: Array,
    push: Array,
    slack: float = 1.0,
) -> Array:
    """Whether residual and duality gap are at the rounding that forces of this size allow, times ``slack``."""
    tol = tolerances(value.dtype)
    return is_within(lanes, point, gradient, size2, value, push, slack * tol.gradient, slack * tol.gap)


def is_within(
    lanes: ContactData,
    point: SpatialVec,
    gradient: SpatialVec,
    size2: Array,
    value: Array,
    push: Array,
    residual: float,
    gap: float,
) -> Array:
    """Whether the residual, beside the forces, and the duality gap, beside the objective, are as small as that."""
    balanced = size2 <= (residual * (1 + push)) ** 2
    scale = jnp.maximum(jnp.abs(value), dual.objective_of_no_force(lanes))
    return balanced & (jnp.abs(spatial.inner(point, gradient)) <= gap * scale)


class OptimalityCheck(NamedTuple):
    """Whether a point is the optimum, by its forces."""

    forces: ContactVec
    optimal: Array
    nearly: Array
    """Whether it is but for ``LAST_SLACK`` times the tolerances."""


def as_returned(forces: ContactVec) -> ContactVec:
    """Forces whose judge sees them to the bit as they are handed out: computed anew they might round otherwise."""
    return lax.optimization_barrier(forces)


@fused_cpu_kernel
def check_optimality(lanes: ContactData, unknowns: Coordinates, metric: Metric, point: SpatialVec) -> OptimalityCheck:
    """Whether the best forces for ``point`` balance the wrench, so that both are optimal."""
    best = as_returned(dual.candidate_forces(lanes, point, unknowns).forces)
    found = measure_forces(lanes, best, unknowns)
    rest = unknowns.wrench(*spatial.parts(found.rest))
    return optimality_by(lanes, best, point, rest, squared_norm(metric, rest), found)


def optimality_by(
    lanes: ContactData, best: ContactVec, point: Array, rest: Array, size2: Array, found: Measurement
) -> OptimalityCheck:
    """By what the best forces leave of the wrench, and the squared length of that."""

    def within(slack: float) -> Array:
        return has_converged(lanes, point, rest, size2, found.objective, found.push, slack)

    return OptimalityCheck(best, within(1.0), within(LOOSE_FACTOR))


def damping_of(size2: Array, caution: Array, proximal: ProximalTerm | None) -> Array:
    """In proportion to the residual, so that a singular Hessian, as of contacts that have let go, gives a direction
    of sensible length.

    It vanishes with the residual: convergence stays quadratic. A proximal pull makes it needless, and
    where the multiplier must run far it would be in the way.
    """
    damping = DAMPING * caution * jnp.sqrt(size2)
    if proximal is not None:
        # Unless kinks keep cutting the steps short.
        damping = jnp.where(proximal.strength > 0, proximal.strength * (caution - 1), damping)
    return 16 * jnp.finfo(size2.dtype).eps + jnp.minimum(damping, LARGEST_DAMPING)


def damped(curvature: Lower, metric: Metric, damping: Array) -> list[list[Array]]:
    """The curvature and so many times the metric of the unconstrained problem."""
    rows = [list(row) for row in curvature]
    for i in range(3):
        rows[i][i] = rows[i][i] + damping
        for j in range(i + 1):
            rows[3 + i][3 + j] = rows[3 + i][3 + j] + damping * metric.inertia[i][j]
    return rows
