"""Semismooth Newton maximisation of the dual, all problems of a tile in step, each with its own line search.

One evaluation gives value, gradient and Hessian at the trial point. A problem that accepts it takes a new direction,
one that refuses it shortens its step, so no problem waits for another's line search.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.iterate import iterate, varying_like
from jaxgrasp.problem import spatial
from jaxgrasp.problem.coordinates import add_damping, squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.dual import DualEvaluation
from jaxgrasp.solver.infeasibility import find_certificate
from jaxgrasp.solver.optimality import OptimalityCheck, OptimalityMeasures, check_optimality, has_converged
from jaxgrasp.solver.result import Certificate

ARMIJO = 1e-4
SHORTEST_STEP = 1e-10
STEP_REDUCTIONS = (0.1, 0.5)
"""Least and largest factor by which a refused step is shortened."""
DAMPING, LARGEST_DAMPING = 0.01, 0.1
"""Damping of a direction by the residual, and its limit; in the metric of the unconstrained problem."""


class ProximalTerm(NamedTuple):
    """The term -strength/2 |x - centre|^2, which makes a degenerate dual strongly concave."""

    strength: Array
    """Strength ``(1, B)``; 0 for the dual without the term."""
    centre: SpatialVec


@runtime_checkable
class ConcaveObjective(Protocol):
    """A dual to be maximised: concave in a few coordinates, with a kink where one of them is zero for joint rates."""

    def with_proximal_term(self, proximal: ProximalTerm) -> "ConcaveObjective":
        """Return the objective with a proximal term added."""
        ...

    def evaluate(self, point: Array) -> Any:
        """Return value, gradient, minus Hessian and the sum of normal forces, named as in ``dual.DualEvaluation``."""
        ...

    def squared_norm(self, gradient: Array) -> Array:
        """Return the squared length ``(1, B)`` of a gradient in the inverse metric, g.(G W G^T)^-1 g."""
        ...

    def direction(self, evaluation: Any, point: Array, damping_factor: Array) -> Array:
        """Return Newton's direction; ``damping_factor`` multiplies the damping that goes with the gradient."""
        ...

    def converged(self, evaluation: Any, point: Array) -> Array:
        """Return a mask of the points that are the maximum, as far as rounding lets it be told."""
        ...

    def clip_step(self, start: Array, trial: Array) -> Array:
        """Return the trial point, stopped at the kinks between it and the start."""
        ...

    def check_optimality(self, point: Array) -> OptimalityCheck:
        """Return the forces of a point, and whether they are the optimum."""
        ...

    def find_certificate(self, check: OptimalityCheck, displacement: Array) -> Certificate:
        """Return a proof that no allowed forces exist, from a point's residual or the multiplier's displacement."""
        ...


class DualObjective(NamedTuple):
    """The dual of problems whose contacts are limited one by one; it has no kinks."""

    problem: ScaledProblem
    proximal: ProximalTerm | None = None

    def with_proximal_term(self, proximal: ProximalTerm) -> "DualObjective":
        return self._replace(proximal=proximal)

    def evaluate(self, point: SpatialVec) -> DualEvaluation:
        evaluation = dual.evaluate(self.problem, point)
        return evaluation if self.proximal is None else _with_proximal_term(evaluation, point, self.proximal)

    def squared_norm(self, gradient: SpatialVec) -> Array:
        return squared_norm(self.problem.metric, gradient)

    def direction(self, evaluation: DualEvaluation, point: SpatialVec, damping_factor: Array) -> SpatialVec:
        # (H + damping M) d = g, with M = G W G^T the metric
        damping = residual_damping(self.squared_norm(evaluation.gradient), damping_factor, self.proximal)
        return dual.solve(
            ldl.factor(add_damping(evaluation.curvature, self.problem.metric, damping)), evaluation.gradient
        )

    def converged(self, evaluation: DualEvaluation, point: SpatialVec) -> Array:
        norm = self.squared_norm(evaluation.gradient)
        return has_converged(
            OptimalityMeasures(
                self.problem.data, point, evaluation.gradient, norm, evaluation.value, evaluation.total_normal_force
            )
        )

    def clip_step(self, start: SpatialVec, trial: SpatialVec) -> SpatialVec:
        return trial

    def check_optimality(self, point: SpatialVec) -> OptimalityCheck:
        return check_optimality(self.problem, point)

    def find_certificate(self, check: OptimalityCheck, displacement: SpatialVec) -> Certificate:
        return find_certificate(self.problem, check.residual, displacement)


class NewtonState(NamedTuple):
    """State of Newton's method: ``point`` and ``direction`` ``(k, B)``, all else ``(1, B)``."""

    point: Array
    value: Array
    direction: Array
    slope: Array
    """Gradient times direction at ``point``."""
    length: Array
    """Step length to try next."""
    damping_factor: Array
    """Factor on the damping of the next direction: larger where the last directions overshot."""
    squared_norm: Array
    """Squared residual at ``point``; 0 before the first evaluation."""
    steps: Array
    done: Array
    """At the optimum as far as can be told from here, or stalled."""
    stalled: Array
    """Unable to move on."""


class LineSearchNewton(NamedTuple):
    """Newton's method with a backtracking line search, as a ``Method`` of ``numerics/iterate.py``."""

    objective: ConcaveObjective

    @staticmethod
    def init(point: Array, frozen: Array) -> NewtonState:
        """Return the state before the first evaluation; problems that are ``frozen`` stay at ``point``."""
        zero = jnp.zeros_like(point[:1])
        steps = jnp.zeros_like(frozen, jnp.int32)
        return NewtonState(point, zero - jnp.inf, 0 * point, zero, zero, zero + 1, zero, steps, frozen, frozen)

    @fused_cpu_kernel
    def step(self, state: NewtonState) -> NewtonState:
        """Evaluate the trial point; accept it and find the next direction, or shorten the step."""
        objective = self.objective
        # x + t d
        trial = objective.clip_step(state.point, state.point + state.length * state.direction)
        evaluation = objective.evaluate(trial)
        squared_norm = objective.squared_norm(evaluation.gradient)
        accepted = _is_better(state, trial, evaluation.value, squared_norm) & ~state.done
        damping_factor = _next_damping_factor(state)
        direction = objective.direction(evaluation, trial, damping_factor)
        converged = objective.converged(evaluation, trial)
        converges_next = ~converged & _converges_next(state, squared_norm)
        length = jnp.where(accepted, 1, state.length * _step_reduction(state, evaluation.gradient))
        # `not >=` rather than `<`, so that a NaN ends the search too.
        stalled = ~accepted & ~state.done & ~(length >= SHORTEST_STEP)
        landed = jnp.where(converges_next, objective.clip_step(trial, trial + direction), trial)

        return NewtonState(
            point=jnp.where(accepted, landed, state.point),
            value=jnp.where(accepted, evaluation.value, state.value),
            direction=jnp.where(accepted, direction, state.direction),
            slope=jnp.where(accepted, spatial.inner(evaluation.gradient, direction), state.slope),
            length=jnp.where(state.done, state.length, length),
            damping_factor=jnp.where(accepted, damping_factor, state.damping_factor),
            squared_norm=jnp.where(accepted, squared_norm, state.squared_norm),
            # The evaluation of the starting point, of length zero, is no step.
            steps=state.steps + _as_count(~state.done & (state.length > 0)) + _as_count(accepted & converges_next),
            done=state.done | stalled | (accepted & (converged | converges_next)),
            stalled=state.stalled | stalled,
        )

    def terminate(self, state: NewtonState) -> Array:
        return state.done


def maximise(objective: ConcaveObjective, start: Array, frozen: Array, max_evaluations: int | Array) -> NewtonState:
    """Maximise from ``start`` in at most ``max_evaluations``; problems that are ``frozen`` stay at the start."""
    # A grasp that many wrenches share has one column here; each problem has its own multiplier.
    frozen = jnp.broadcast_to(frozen, start[:1].shape)
    method = LineSearchNewton(objective)
    return iterate(method, varying_like(method.init(start, frozen), start, objective), max_evaluations)


def _as_count(condition: Array) -> Array:
    return condition.astype(jnp.int32)


def _is_better(state: NewtonState, trial: Array, value: Array, squared_norm: Array) -> Array:
    """Return a mask of trials whose value rises enough (Armijo), rounding aside.

    The value is a difference of numbers as large as the multiplier: where that hides the rise, a smaller residual shows
    it.
    """
    eps = jnp.finfo(value.dtype).eps
    # q(x + t d) - q(x) - c t g.d, which Armijo's condition wants above zero.
    rise = value - state.value - ARMIJO * state.length * state.slope
    noise = 8 * eps * (1 + jnp.abs(value))
    return (rise >= -noise) | ((rise >= -noise - 8 * eps * spatial.length(trial)) & (squared_norm < state.squared_norm))


def _converges_next(state: NewtonState, squared_norm: Array) -> Array:
    """Return a mask of problems whose next full step lands at the optimum, so that it needs no evaluation.

    Close to the optimum the residual falls as its own square; the last step's fall gives the factor. The
    caller checks the point anyway.
    """
    target = 0.1 * tolerances(squared_norm.dtype).gradient
    # |g_next| = |g| (|g| / |g_last|)^2 <= target, in squares.
    quadratic = squared_norm**3 <= (target * state.squared_norm) ** 2
    return (state.length == 1) & (squared_norm < 1e-8) & quadratic


def _next_damping_factor(state: NewtonState) -> Array:
    """Return a larger factor after a shortened step, a smaller one after a full step."""
    shortened = (state.length > 0) & (state.length < 1)
    raised = state.damping_factor / jnp.where(shortened, jnp.maximum(state.length, 1e-3), 1)
    return jnp.where(shortened, raised, jnp.maximum(state.damping_factor / 10, 1))


def _step_reduction(state: NewtonState, gradient: Array) -> Array:
    """Return the factor that shortens a refused step.

    The slope along the line falls from positive to negative, and mostly late, beyond a kink that the
    quadratic model did not foresee: where its chord meets zero, the value is still rising.
    """
    overshot = jnp.maximum(-spatial.inner(gradient, state.direction), state.slope)
    # Twice the share of the step at which the chord is zero, s_0 / (s_0 - s_1).
    return jnp.clip(2 * vec3.safe_divide(state.slope, state.slope + overshot), *STEP_REDUCTIONS)


def _with_proximal_term(evaluation: DualEvaluation, trial: SpatialVec, proximal: ProximalTerm) -> DualEvaluation:
    """Return the evaluation with -rho/2 |x - c|^2 added: gradient -rho (x - c), Hessian -rho I."""
    offset, rho = trial - proximal.centre, proximal.strength
    curvature = [list(row) for row in evaluation.curvature]
    for i in range(6):
        curvature[i][i] = curvature[i][i] + rho
    value = evaluation.value - rho * spatial.inner(offset, offset) / 2
    return DualEvaluation(value, evaluation.gradient - rho * offset, curvature, evaluation.total_normal_force)


def residual_damping(squared_norm: Array, damping_factor: Array, proximal: ProximalTerm | None) -> Array:
    """Return the damping of a direction, in proportion to the residual.

    It gives directions of sensible length where the Hessian is singular, as with contacts that have let go, and
    vanishes with the residual, so that convergence stays quadratic. A proximal term makes it needless, and where the
    multiplier must run far it would be in the way.
    """
    # c |g|, as in a regularised Newton's method.
    damping = DAMPING * damping_factor * jnp.sqrt(squared_norm)
    if proximal is not None:
        # Unless kinks keep cutting the steps short.
        damping = jnp.where(proximal.strength > 0, proximal.strength * (damping_factor - 1), damping)
    return 16 * jnp.finfo(squared_norm.dtype).eps + jnp.minimum(damping, LARGEST_DAMPING)
