"""The wrench that contacts can exert closest to a load, the furthest along a ray, and the least that they must press.

All come out of the same dual as the optimum, in a problem's coordinates. Let a wrench e be missed at a penalty of
t |e|^2 / 2: the dual is then pulled towards zero, by |x|^2 / 2t, and e = x / t. As the penalty rises e tends to the
shortest wrench that must be missed, while the multiplier x runs off along it. Or let theta be paid for at t: the dual
is then confined to the plane where the multiplier does work t along the ray. Or let each unit of normal force cost t,
which takes t off the multiplier's velocity along each normal. In all of them the forces' own cost holds the
answer back, by terms that fall with 1 / t for the forces, and with their square for the distance, theta and the total.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.iterate import iterate, varying_like
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.problem import friction_cone, spatial
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.dual import DualProblem

ARMIJO = 1e-4
STEPS_PER_LEVEL = 100
PENALTY_FACTOR = 10.0
"""Factor between one penalty and the next."""
FIRST_DAMPING = 10.0
"""Damping of the first step at each penalty, in units of 1 / t."""
DAMPING_FACTOR = 4.0
"""Less damping after a step that was good, more after one that was not."""
HIGHEST_DAMPING = 1e3
"""Relative to the largest curvature: no step that short is worth its time."""
RIDGE, RIDGE_EXPONENT = 1e-6, 0.7
"""Quadratic penalty in a search for theta or the least total, in units of 1 / t, at the most, and as an exponent of the
machine epsilon: it only keeps Newton's matrix regular. It holds back multipliers that have far to go, and so leaves
forces that miss their wrench: 1e-6 left one answer in six without a proof where friction was mixed or loads at their
limit."""
STRAIGHT_PATH = 1e-5
"""Bend of the path between two penalties, relative to the multiplier, that is none."""
PENALTY_ERROR = 1e4
"""What a higher penalty is worth against rounding: the error of theta at the penalty t, in units of (theta / t)^2."""
CHANGE_WEIGHT = 10.0
"""Weight of the change of the estimate between two penalties, of which its error is a known share, beside a wrench that
is missed aside, which shows in the estimate by its square only."""


class QuadraticPenalty(NamedTuple):
    """The term -strength/2 (x - centre).metric (x - centre), and a plane in which x must stay."""

    strength: Array
    centre: SpatialVec
    metric: Lower
    normal: SpatialVec | None
    """Normal of the plane, of length 1 or 0; None where there is no plane."""


class _MaximiserState(NamedTuple):
    """State of Newton's method in each problem: point, value, derivatives and damping."""

    point: SpatialVec
    value: Array
    gradient: SpatialVec
    curvature: Lower
    damping: Array
    done: Array


class PenaltyPath(NamedTuple):
    """The best point so far, and the one before it: in the end points lie on a straight line over their penalties."""

    penalty: Array
    point: SpatialVec
    estimate: Array
    penalty_before: Array
    point_before: SpatialVec
    error_estimate: Array
    ceiling: Array
    """The least total of forces at any of the penalties, with what they miss of the load; infinite for a theta."""
    done: Array


class _Attempt(NamedTuple):
    """A point for the next penalty."""

    point: SpatialVec
    estimate: Array
    """Theta or the least total by this point; 0 where neither is sought."""
    size: Array
    error_estimate: Array
    far_enough: Array
    """Whether the penalty may be high enough."""
    ceiling: Array
    """The total of these forces, and what exerting the wrench that they miss would add at the most, by the multiplier;
    infinite for a theta."""


class NearestWrench(NamedTuple):
    """The multiplier whose forces exert the wrench nearest to the load."""

    point: SpatialVec
    reached: Array
    """Whether nothing but rounding is missed, or the multiplier has come to rest, on its way to the optimum's. Where
    not it runs off, and the metric times it has the direction of what is missed."""


def largest_multiplier(dtype: np.dtype) -> float:
    """Return the size at which a multiplier that runs off is stopped: its rounding equals the penalty's error there."""
    return float(jnp.finfo(dtype).eps ** -0.55)


def ridge(dtype: np.dtype) -> float:
    """Return the ridge penalty of a precision, in units of 1 / t."""
    return min(RIDGE, float(jnp.finfo(dtype).eps) ** RIDGE_EXPONENT)


def identity(like: Array) -> Lower:
    """Return the 6x6 identity as a lower triangle."""
    unit, zero = jnp.ones_like(like), jnp.zeros_like(like)
    return [[unit if i == j else zero for j in range(i + 1)] for i in range(6)]


def nearest_wrench(
    problem: DualProblem, metric: Lower, frozen: Array, plane: SpatialVec | None = None
) -> NearestWrench:
    """Find the nearest wrench that the contacts can exert: the missed part e of the load minimises e.metric^-1 e.

    With a ``plane`` the metric must be the identity, and wrenches along the plane's normal cost nothing. Plane,
    metric and point are in the problem's coordinates.
    """
    zero = varying_like(jnp.zeros((6, frozen.shape[-1]), problem.data.squeeze.dtype), problem.data)

    def attempt(penalty: Array, predicted: SpatialVec, done: Array) -> _Attempt:
        term = QuadraticPenalty(1 / penalty, zero, metric, plane)
        point = maximise(problem, term, penalty, predicted, done)
        residual = wrench_residual(problem, point)
        if plane is not None:
            residual = _in_plane(plane, residual)
        ran_off = spatial.length(point) >= largest_multiplier(zero.dtype)
        squared_distance = spatial.inner(residual, solve_by(metric, residual))
        return _Attempt(point, zero[:1], zero[:1] + 1, squared_distance, ran_off, zero[:1] + jnp.inf)

    path = _follow(zero, frozen, attempt)
    settled = spatial.length(path.point) <= 2 * spatial.length(path.point_before)
    return NearestWrench(path.point, settled | (path.error_estimate <= tolerances(zero.dtype).range ** 2))


def ray_search(problem: DualProblem, ray: SpatialVec, start: SpatialVec, frozen: Array) -> tuple[Array, PenaltyPath]:
    """Find the largest theta with load + theta ray in reach, and the multipliers of its bound, scaled by their work.

    ``start`` does no work along the ``ray``, which has length 1. Problems where no theta is in reach, or all
    are, should be ``frozen``.
    """
    metric = identity(start[:1])

    def attempt(penalty: Array, predicted: SpatialVec, done: Array) -> _Attempt:
        predicted = predicted + (penalty - spatial.inner(ray, predicted)) * ray
        term = QuadraticPenalty(ridge(start.dtype) / penalty, predicted, metric, ray)
        point = maximise(problem, term, penalty, predicted, done)
        residual = wrench_residual(problem, point)
        # theta = -x.(load - G f) / t, since load - G f is -theta ray.
        # Along the multiplier neither its rounding nor what else is missed shows.
        theta = -spatial.inner(point, residual) / penalty
        size = 1 + jnp.abs(theta)
        # Bound of the work that is missed across the ray: |P r| |x| / t.
        missed_work = spatial.length(_in_plane(ray, residual)) * spatial.length(point) / penalty
        is_at_limit = penalty >= size * largest_multiplier(start.dtype)
        error_estimate = (missed_work / size) ** 2 + PENALTY_ERROR * (size / penalty) ** 2
        return _Attempt(point, theta, size, error_estimate, is_at_limit, jnp.full_like(theta, jnp.inf))

    path = _follow(start, frozen, attempt)
    return path.estimate, path


def least_normal_force(problem: DualProblem, frozen: Array) -> tuple[Array, PenaltyPath]:
    """Find the least total of normal forces that exert the load, and the multipliers of its bound, scaled by the cost.

    Problems that have no forces at all should be ``frozen``.
    """
    data, coordinates = problem.data, problem.coordinates
    zero = varying_like(jnp.zeros((6, frozen.shape[-1]), data.squeeze.dtype), data)
    metric = identity(zero[:1])

    def attempt(penalty: Array, predicted: SpatialVec, done: Array) -> _Attempt:
        costly = dual.PlainProblem(with_normal_cost(data, penalty), coordinates)
        term = QuadraticPenalty(ridge(zero.dtype) / penalty, predicted, metric, None)
        point = maximise(costly, term, penalty, predicted, done)
        forces = dual.candidate_forces(costly, point).forces
        residual = dual.residual(costly, forces)
        # total = sum of f_i.a_i + x.r / t.
        # What is missed of the load would have to be pushed too, along the multiplier.
        pressed = dual.total_normal_force(data, forces)
        total = pressed + spatial.inner(point, residual) / penalty
        size = 1 + total
        missed_work = spatial.length(residual) * spatial.length(point) / penalty
        is_at_limit = penalty >= size * largest_multiplier(zero.dtype)
        error_estimate = (missed_work / size) ** 2 + PENALTY_ERROR * (size / penalty) ** 2
        return _Attempt(point, total, size, error_estimate, is_at_limit, pressed + missed_work)

    path = _follow(zero, frozen, attempt)
    return path.estimate, path


def floor(problem: DualProblem, path: PenaltyPath) -> Array:
    """Return the largest total that the multipliers of a path prove to be needed ``(1, B)``; -inf where none is.

    Normal forces that add up to T do at most the work T max_i (v_n + mu |v_t|)_i along a twist, and have to do that of
    the load. Two twists are tried: that of the last penalty, and its limit by the secant.
    """
    data, load = problem.data, dual.required_wrench(problem)
    last = vec3.safe_divide(path.point, path.penalty)
    previous = vec3.safe_divide(path.point_before, path.penalty_before)
    share = vec3.safe_divide(path.penalty_before, path.penalty - path.penalty_before)
    best = jnp.full_like(path.penalty, -jnp.inf)
    for twist in (last, last + share * (last - previous)):
        velocity = dual.contact_velocities(problem, twist)
        rates = jnp.where(data.weights > 0, friction_cone.work_per_normal_force(velocity, data.cone), 0)
        rate, work = jnp.max(rates, 0, keepdims=True), spatial.inner(load, twist)
        # T >= w.d / max_i h_i(d)
        best = jnp.fmax(best, jnp.where(rate > 0, work / jnp.where(rate > 0, rate, 1), jnp.where(work > 0, jnp.inf, 0)))
    return best


def with_normal_cost(data: ContactData, normal_cost: Array) -> ContactData:
    """Return problems in which each unit of normal force has a cost, beside half its square over the weight."""
    return data._replace(normal_cost=normal_cost)


def _follow(start: SpatialVec, frozen: Array, attempt: Callable[[Array, SpatialVec, Array], _Attempt]) -> PenaltyPath:
    """Raise the penalty until every problem is far enough, or its digits come to their end."""
    zero = jnp.zeros_like(start[:1])
    eps = float(jnp.finfo(zero.dtype).eps)
    highest = 1 / (64 * eps)

    def rise(carry):
        penalty, path = carry
        predicted = _predicted(path, penalty)
        trial = attempt(penalty, predicted, path.done)
        # A higher penalty is better. Where it is not Newton's method has failed: the next one starts from before.
        error_estimate = trial.error_estimate + (CHANGE_WEIGHT * _bias(path, penalty, trial.estimate) / trial.size) ** 2
        better = ~path.done & (error_estimate <= (1 + eps**0.5) * path.error_estimate)
        # Where contacts resist only by enormous forces, the path bends late.
        straight = spatial.length(trial.point - predicted) <= STRAIGHT_PATH * spatial.length(trial.point)
        return PENALTY_FACTOR * penalty, PenaltyPath(
            penalty=jnp.where(better, penalty, path.penalty),
            point=jnp.where(better, trial.point, path.point),
            estimate=jnp.where(better, trial.estimate, path.estimate),
            penalty_before=jnp.where(better, path.penalty, path.penalty_before),
            point_before=jnp.where(better, path.point, path.point_before),
            error_estimate=jnp.where(better, error_estimate, path.error_estimate),
            ceiling=jnp.where(path.done, path.ceiling, jnp.fmin(path.ceiling, trial.ceiling)),
            done=path.done | (better & trial.far_enough & straight) | (penalty >= highest),
        )

    endless = zero + jnp.inf
    path = varying_like(PenaltyPath(zero, start, zero, zero, start, endless, endless, frozen), start, frozen)
    _, path = lax.while_loop(
        lambda carry: ~jnp.all(carry[1].done), rise, (jnp.asarray(PENALTY_FACTOR, zero.dtype), path)
    )
    return path


def _bias(path: PenaltyPath, penalty: Array, estimate: Array) -> Array:
    """Return the distance of the estimate from its limit, which falls with the square of the penalty."""
    is_positive = path.penalty > 0
    ratio = jnp.where(is_positive, penalty / jnp.where(is_positive, path.penalty, 1), PENALTY_FACTOR)
    # theta(t) = limit - C / t^2, so limit - theta = (theta - theta_before) / ((t / t_before)^2 - 1).
    return jnp.where(is_positive, (estimate - path.estimate) / (ratio**2 - 1), 0)


def _predicted(path: PenaltyPath, penalty: Array) -> SpatialVec:
    """Predict the point at a penalty by the secant: in the end the path is straight."""
    factor = vec3.safe_divide(penalty - path.penalty, path.penalty - path.penalty_before)
    return path.point + factor * (path.point - path.point_before)


def wrench_residual(problem: DualProblem, point: SpatialVec) -> SpatialVec:
    """Return w - G f for the candidate forces of ``point``."""
    return dual.residual(problem, dual.candidate_forces(problem, point).forces)


def maximise(
    problem: DualProblem, penalty_term: QuadraticPenalty, penalty: Array, start: SpatialVec, frozen: Array
) -> SpatialVec:
    """Maximise the dual less the penalty by Newton's method, damped as each problem needs it.

    The line search of ``newton.LineSearchNewton`` fails here: where the multiplier is large, most of Newton's
    direction lies where only the faint penalty bends the dual, and a kink in it soon ends the step. Damping turns
    the step away instead. The search stops where a step has nothing to gain but rounding, not by the gradient,
    which is rounding itself in all directions but those that matter.
    """
    method = _DampedNewton(problem, penalty_term, penalty)
    state = varying_like(method.init(start, frozen), problem, penalty_term, penalty)
    return iterate(method, state, STEPS_PER_LEVEL + 1).point


class _DampedNewton(NamedTuple):
    """Newton's method with adaptive damping (Levenberg-Marquardt), as a ``Method`` of ``numerics/iterate.py``."""

    problem: DualProblem
    penalty_term: QuadraticPenalty
    penalty: Array

    def init(self, start: SpatialVec, frozen: Array) -> _MaximiserState:
        """Return the state before the first step, which only evaluates the start: so that is compiled once."""
        nothing = jnp.zeros_like(start[:1])
        damping = nothing + DAMPING_FACTOR * FIRST_DAMPING / self.penalty
        return _MaximiserState(start, nothing - jnp.inf, jnp.zeros_like(start), identity(nothing), damping, frozen)

    @fused_cpu_kernel
    def step(self, state: _MaximiserState) -> _MaximiserState:
        """Take a damped step where it raises the value; less damping then, more where it does not."""
        step = _step(self.penalty_term, state)
        trial = state.point + step
        value, gradient, curvature = _evaluate(self.problem, self.penalty_term, trial)
        eps = jnp.finfo(value.dtype).eps
        # The value is a small difference where the multiplier is large.
        noise = 8 * eps * (1 + jnp.abs(value) + spatial.length(trial))
        gain = spatial.inner(state.gradient, step)
        better = value >= state.value + ARMIJO * gain - noise
        moves = better & ~state.done
        # Such a step doubles the digits, of which there are enough by then.
        last = moves & (gain <= noise) & (state.damping * self.penalty <= 1)
        damping = jnp.where(better, state.damping / DAMPING_FACTOR, DAMPING_FACTOR * state.damping)
        return _MaximiserState(
            point=jnp.where(moves, trial, state.point),
            value=jnp.where(moves, value, state.value),
            gradient=jnp.where(moves, gradient, state.gradient),
            curvature=jax.tree.map(lambda new, old: jnp.where(moves, new, old), curvature, state.curvature),
            damping=jnp.maximum(damping, 16 * eps),
            done=state.done | last | (state.damping > HIGHEST_DAMPING),
        )

    def terminate(self, state: _MaximiserState) -> Array:
        return state.done


def _step(penalty_term: QuadraticPenalty, state: _MaximiserState) -> SpatialVec:
    """Return Newton's damped step, within the plane: (H + damping I) d = g, n.d = 0."""
    rows = [[*row[:-1], row[-1] + state.damping] for row in state.curvature]
    factors = ldl.factor(rows)
    step = dual.solve(factors, state.gradient)
    if penalty_term.normal is None:
        return step
    # d - (n.d / n.H^-1 n) H^-1 n
    across = dual.solve(factors, penalty_term.normal)
    return (
        step
        - vec3.safe_divide(spatial.inner(penalty_term.normal, step), spatial.inner(penalty_term.normal, across))
        * across
    )


def _evaluate(
    problem: DualProblem, penalty_term: QuadraticPenalty, trial: SpatialVec
) -> tuple[Array, SpatialVec, Lower]:
    """Return value, gradient and minus Hessian of the dual less the penalty."""
    evaluation = dual.evaluate(problem, trial)
    offset = trial - penalty_term.centre
    # q(x) - rho / 2 (x - c).M (x - c): gradient less rho M (x - c), minus Hessian plus rho M.
    heavy = penalty_term.strength * times(penalty_term.metric, offset)
    curvature = [
        [h + penalty_term.strength * m for h, m in zip(*rows, strict=True)]
        for rows in zip(evaluation.curvature, penalty_term.metric, strict=True)
    ]
    return evaluation.value - spatial.inner(offset, heavy) / 2, evaluation.gradient - heavy, curvature


def _in_plane(normal: SpatialVec, x: SpatialVec) -> SpatialVec:
    """Return the part of x in the plane."""
    return x - spatial.inner(normal, x) * normal


def solve_by(metric: Lower, right: SpatialVec) -> SpatialVec:
    """Return metric^-1 right."""
    return dual.solve(ldl.factor(metric), right)


def times(metric: Lower, x: SpatialVec) -> SpatialVec:
    """Return metric x."""
    return jnp.concatenate(ldl.multiply(metric, [x[i : i + 1] for i in range(6)]))
