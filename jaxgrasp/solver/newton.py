"""Semismooth Newton maximisation of the dual, all problems of a tile in step, each with a line search of its own.

One evaluation gives value, gradient and Hessian at the trial point; a problem that accepts it takes a new
direction, one that refuses shortens its step. So no problem waits for another's line search.
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
from jaxgrasp.problem.metric import Metric, squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.dual import DualEvaluation
from jaxgrasp.solver.result import Measurement, measure_forces

ARMIJO = 1e-4
SHORTEST_STEP = 1e-10
STEP_REDUCTIONS = (0.1, 0.5)
"""Least and largest factor by which a refused step is shortened."""
DAMPING, LARGEST_DAMPING = 0.01, 0.1
"""Damping of a direction by the residual, and its limit; in the metric of the unconstrained problem."""
LOOSE_FACTOR = 16.0
"""In the end an answer may be this much coarser: near the limit of what the contacts can exert, the multiplier is so
large that its own rounding stands in the way."""


class ProximalTerm(NamedTuple):
    """The term -strength/2 |x - centre|^2 that makes a degenerate dual strongly concave."""

    strength: Array
    """A scalar; 0 for the dual as it is."""
    centre: SpatialVec


@runtime_checkable
class ConcaveObjective(Protocol):
    """What is maximised: a concave function of a few coordinates, perhaps with a kink where one of them is zero."""

    def evaluate(self, point: Array) -> Any:
        """Value, gradient, minus Hessian and the sum of normal forces, named as in ``dual.DualEvaluation``."""
        ...

    def squared_norm(self, gradient: Array) -> Array:
        """Squared length ``(1, B)`` of a gradient in the inverse metric, g.(G W G^T)^-1 g."""
        ...

    def direction(self, at: Any, point: Array, damping_factor: Array) -> Array:
        """Newton's direction, with ``damping_factor`` times the usual damping, which goes with the gradient."""
        ...

    def converged(self, at: Any, point: Array) -> Array:
        """Whether the point is the maximum, as far as rounding lets it be told."""
        ...

    def clip_step(self, start: Array, trial: Array) -> Array:
        """The trial point, stopped at the kinks between it and the start."""
        ...


class DualObjective(NamedTuple):
    """The dual as an objective: it has no kinks."""

    problem: ScaledProblem
    proximal: ProximalTerm | None = None

    def evaluate(self, point: SpatialVec) -> DualEvaluation:
        at = dual.evaluate(self.problem, point)
        return at if self.proximal is None else _with_proximal_term(at, point, self.proximal)

    def squared_norm(self, gradient: SpatialVec) -> Array:
        return squared_norm(self.problem.metric, gradient)

    def direction(self, at: DualEvaluation, point: SpatialVec, damping_factor: Array) -> SpatialVec:
        damping = damping_of(self.squared_norm(at.gradient), damping_factor, self.proximal)
        return dual.solve(ldl.factor(damped(at.curvature, self.problem.metric, damping)), at.gradient)

    def converged(self, at: DualEvaluation, point: SpatialVec) -> Array:
        return has_converged(
            self.problem.data, point, at.gradient, self.squared_norm(at.gradient), at.value, at.total_normal_force
        )

    def clip_step(self, start: SpatialVec, trial: SpatialVec) -> SpatialVec:
        return trial


class NewtonState(NamedTuple):
    """State of Newton's method: ``point`` and ``direction`` ``(k, B)``, all else ``(1, B)``."""

    point: Array
    value: Array
    direction: Array
    slope: Array
    length: Array
    """Step length to try next."""
    damping_factor: Array
    """How many times the usual damping the next direction gets: more where the last ones overshot."""
    squared_norm: Array
    """Squared residual at ``point``; 0 before anything was evaluated."""
    steps: Array
    done: Array
    """At the optimum as far as can be told from here, or stalled."""
    stalled: Array
    """Unable to move on."""


def maximise(objective: ConcaveObjective, start: Array, frozen: Array, max_evaluations: int | Array) -> NewtonState:
    """Maximise from ``start`` in at most so many evaluations; problems that are ``frozen`` stay where they are."""
    # A grasp that many wrenches share has one column here; where each problem stands is its own.
    frozen = jnp.broadcast_to(frozen, start[:1].shape)
    return advance(objective, varying_like(at_start(start, frozen), start, objective), max_evaluations)


def at_start(point: Array, frozen: Array) -> NewtonState:
    """Before anything is evaluated."""
    zero = jnp.zeros_like(point[:1])
    steps = jnp.zeros_like(frozen, jnp.int32)
    return NewtonState(point, zero - jnp.inf, 0 * point, zero, zero, zero + 1, zero, steps, frozen, frozen)


def advance(objective: ConcaveObjective, state: NewtonState, max_evaluations: int | Array) -> NewtonState:
    """Maximise further, in at most so many evaluations."""

    def unfinished(carry: tuple[Array, NewtonState]) -> Array:
        evaluations, state = carry
        return (evaluations < max_evaluations) & ~jnp.all(state.done)

    def one(carry: tuple[Array, NewtonState]) -> tuple[Array, NewtonState]:
        evaluations, state = carry
        return evaluations + 1, _advance(objective, state)

    return lax.while_loop(unfinished, one, (jnp.int32(0), state))[1]


@fused_cpu_kernel
def _advance(objective: ConcaveObjective, state: NewtonState) -> NewtonState:
    trial = objective.clip_step(state.point, state.point + state.length * state.direction)
    at = objective.evaluate(trial)
    squared_norm = objective.squared_norm(at.gradient)
    accepted = _is_better(state, trial, at.value, squared_norm) & ~state.done
    damping_factor = _next_damping_factor(state)
    direction = objective.direction(at, trial, damping_factor)
    converged = objective.converged(at, trial)
    converges_next = ~converged & _converges_next(state, squared_norm)
    length = jnp.where(accepted, 1, state.length * _step_reduction(state, at.gradient))
    stalled = ~accepted & ~state.done & (length < SHORTEST_STEP)
    landed = jnp.where(converges_next, objective.clip_step(trial, trial + direction), trial)

    return NewtonState(
        point=jnp.where(accepted, landed, state.point),
        value=jnp.where(accepted, at.value, state.value),
        direction=jnp.where(accepted, direction, state.direction),
        slope=jnp.where(accepted, spatial.inner(at.gradient, direction), state.slope),
        length=jnp.where(state.done, state.length, length),
        damping_factor=jnp.where(accepted, damping_factor, state.damping_factor),
        squared_norm=jnp.where(accepted, squared_norm, state.squared_norm),
        # The evaluation of the starting point, of length zero, is no step.
        steps=state.steps + _as_count(~state.done & (state.length > 0)) + _as_count(accepted & converges_next),
        done=state.done | stalled | (accepted & (converged | converges_next)),
        stalled=state.stalled | stalled,
    )


def _as_count(condition: Array) -> Array:
    return condition.astype(jnp.int32)


def _is_better(state: NewtonState, trial: Array, value: Array, squared_norm: Array) -> Array:
    """Whether the value rises enough, rounding aside.

    It is a difference of numbers as large as the multiplier: where that hides the rise, a smaller residual shows it.
    """
    eps = jnp.finfo(value.dtype).eps
    rise = value - state.value - ARMIJO * state.length * state.slope
    noise = 8 * eps * (1 + jnp.abs(value))
    return (rise >= -noise) | ((rise >= -noise - 8 * eps * spatial.length(trial)) & (squared_norm < state.squared_norm))


def _converges_next(state: NewtonState, squared_norm: Array) -> Array:
    """Whether the next full step will land at the optimum, so that it can be taken without looking there.

    Close to the optimum the residual falls as its own square; the last step's fall gives the factor. The
    caller checks the point anyway.
    """
    wanted = 0.1 * tolerances(squared_norm.dtype).gradient
    quadratic = squared_norm**3 <= (wanted * state.squared_norm) ** 2
    return (state.length == 1) & (squared_norm < 1e-8) & quadratic


def _next_damping_factor(state: NewtonState) -> Array:
    """More where only a part of the last step was any good, less again with every step that was good as a whole."""
    shortened = (state.length > 0) & (state.length < 1)
    more = state.damping_factor / jnp.where(shortened, jnp.maximum(state.length, 1e-3), 1)
    return jnp.where(shortened, more, jnp.maximum(state.damping_factor / 10, 1))


def _step_reduction(state: NewtonState, gradient: Array) -> Array:
    """How much to shorten a refused step.

    The slope along the line falls from positive to negative, and mostly late, beyond a kink that the
    quadratic model did not foresee: where its chord meets zero, the value is still rising.
    """
    overshot = jnp.maximum(-spatial.inner(gradient, state.direction), state.slope)
    return jnp.clip(2 * vec3.safe_divide(state.slope, state.slope + overshot), *STEP_REDUCTIONS)


def _with_proximal_term(at: DualEvaluation, trial: SpatialVec, proximal: ProximalTerm) -> DualEvaluation:
    """Value, gradient and curvature with the proximal term."""
    offset, rho = trial - proximal.centre, proximal.strength
    curvature = [list(row) for row in at.curvature]
    for i in range(6):
        curvature[i][i] = curvature[i][i] + rho
    value = at.value - rho * spatial.inner(offset, offset) / 2
    return DualEvaluation(value, at.gradient - rho * offset, curvature, at.total_normal_force)


def has_converged(
    data: ContactData,
    point: SpatialVec,
    gradient: SpatialVec,
    squared_norm: Array,
    value: Array,
    total_normal_force: Array,
    slack: float = 1.0,
) -> Array:
    """Whether residual and duality gap are at the rounding that forces of this size allow, times ``slack``."""
    tol = tolerances(value.dtype)
    return is_within(
        data, point, gradient, squared_norm, value, total_normal_force, slack * tol.gradient, slack * tol.gap
    )


def is_within(
    data: ContactData,
    point: SpatialVec,
    gradient: SpatialVec,
    squared_norm: Array,
    value: Array,
    total_normal_force: Array,
    residual_tolerance: float,
    gap_tolerance: float,
) -> Array:
    """Whether the residual relative to the forces and the gap relative to the objective meet these tolerances."""
    small_gap = jnp.abs(spatial.inner(point, gradient)) <= gap_tolerance * dual.gap_scale(data, value)
    return is_small(squared_norm, total_normal_force, residual_tolerance) & small_gap


def is_small(squared_norm: Array, total_normal_force: Array, residual_tolerance: float) -> Array:
    """Whether a residual of that squared length meets the tolerance relative to forces of that size."""
    return squared_norm <= (residual_tolerance * (1 + total_normal_force)) ** 2


class OptimalityCheck(NamedTuple):
    """Whether a point is the optimum, by its forces."""

    forces: ContactVec
    optimal: Array
    loosely_optimal: Array
    """Whether it is but for ``LOOSE_FACTOR`` times the tolerances."""
    relative_residual: Array
    """The part of the load that the forces miss."""
    residual: Array
    """What they leave of the wrench, in the coordinates."""


def without_recomputation(forces: ContactVec) -> ContactVec:
    """Forces behind an optimisation barrier: XLA would recompute them, for the caller, with other rounding."""
    return lax.optimization_barrier(forces)


@fused_cpu_kernel
def check_optimality(problem: ScaledProblem, point: SpatialVec) -> OptimalityCheck:
    """Whether the forces of ``point`` balance the wrench, so that both are optimal."""
    best = without_recomputation(dual.candidate_forces(problem, point).forces)
    found = measure_forces(problem, best)
    residual = problem.coordinates.wrench(*spatial.parts(found.residual))
    return optimality_by(problem.data, best, point, residual, squared_norm(problem.metric, residual), found)


def optimality_by(
    data: ContactData, best: ContactVec, point: Array, residual: Array, squared_norm: Array, found: Measurement
) -> OptimalityCheck:
    """The check by what the candidate forces leave of the wrench, and the squared length of that."""

    def within(slack: float) -> Array:
        return has_converged(data, point, residual, squared_norm, found.objective, found.total_normal_force, slack)

    return OptimalityCheck(best, within(1.0), within(LOOSE_FACTOR), found.relative_residual, residual)


def damping_of(squared_norm: Array, damping_factor: Array, proximal: ProximalTerm | None) -> Array:
    """In proportion to the residual, so that a singular Hessian, as of contacts that have let go, gives a direction
    of sensible length.

    It vanishes with the residual: convergence stays quadratic. A proximal term makes it needless, and
    where the multiplier must run far it would be in the way.
    """
    damping = DAMPING * damping_factor * jnp.sqrt(squared_norm)
    if proximal is not None:
        # Unless kinks keep cutting the steps short.
        damping = jnp.where(proximal.strength > 0, proximal.strength * (damping_factor - 1), damping)
    return 16 * jnp.finfo(squared_norm.dtype).eps + jnp.minimum(damping, LARGEST_DAMPING)


def damped(curvature: Lower, metric: Metric, damping: Array) -> list[list[Array]]:
    """The curvature plus ``damping`` times the metric G W G^T, a lower triangle 6x6."""
    rows = [list(row) for row in curvature]
    for i in range(3):
        rows[i][i] = rows[i][i] + damping
        for j in range(i + 1):
            rows[3 + i][3 + j] = rows[3 + i][3 + j] + damping * metric.inertia[i][j]
    return rows
