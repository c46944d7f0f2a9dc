"""Least friction with which a grasp holds its load, if its normal forces may reach a given total."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force.least_squeeze import bounded_total, held_total, total_tangent
from jaxgrasp.force.margin import bound_along
from jaxgrasp.model.arguments import Progress, check_arguments, check_sign
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.no_derivative import nan_tangents_where, zero_tangent
from jaxgrasp.numerics.tiling import beside, over_chosen
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import Sharing
from jaxgrasp.solver.dispatch import dispatch
from jaxgrasp.solver.friction_factor import LARGEST_FACTOR, least_friction_factor
from jaxgrasp.solver.wrench_boundary import BoundaryPoint, with_unit_weights, work_along

FIRST = (10.0, 1.0, 100.0)
"""Factors to begin with, one after the other."""
STEPS = 60
FARTHER = 16.0
"""Times as far for each further look, where a place that was found at once is not the answer."""
TILE = 32
NEAR = 100
"""Bounds of a factor at a boundary, within which the boundary must be: what is farther was not what bounds."""


def least_friction(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    total: Float[AnyArray, "*#batch"] | float | None = None,
    progress: Progress | None = None,
) -> Float[Array, "..."]:
    """Compute the least factor on all friction coefficients with which a grasp holds its load by a total normal force.

    Its inverse is the grasp's reserve: as many times smaller may every friction coefficient be. An optimum with an
    active cone has no friction margin left, whatever reserve it has.

    It is the inverse of [`jaxgrasp.least_squeeze`][], to about 1e-9 of itself, and differentiable once, by the total
    too. Where no forces at all balance the wrench below the factor, it is an upper bound to 1e-6 and moves with the
    boundary of what the grasp can exert; NaN is the derivative where neither the total nor that boundary is known to
    bind.

    One search finds most factors, with a proof on either side; a bracketed Newton's method finds the rest, to the same
    tolerance, but its factor may be too large where it lies below 1e-4 or so and no forces are found though some exist.
    A thousand grasps take 0.3 to 0.6 seconds of the processor once compiled (``python -m benchmarks.margins``).

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][]; it matters only for contacts of weight zero.
        total: of the normal forces ``(...)`` [N]; where not given, that of the squeezing forces, which the hand means
            to exert.
        progress: told how many more problems are done, as ``tqdm.update`` is, a thousand at a time; between them
            the call can be interrupted. Not inside other programs.

    Returns:
        ``(...)``, a factor of every contact's coefficient. Zero, as are its derivatives, where a ten-thousandth is
        enough; +inf, without a derivative (NaN), where ten thousand times as much is not.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {"total": (total, ())})
    if total is not None:
        check_sign("total", total)
    return dispatch(
        _least_factor, grasp, wrench, sharing, trailing_shapes=(("total", ()),), total=total, progress=progress
    )


def _least_factor(problem: ProblemBatch, total: Array | None = None) -> Array:
    if total is None:
        present = 1.0 if problem.present is None else problem.present > 0.5
        total = jnp.broadcast_to(jnp.sum(jnp.where(present, problem.squeeze, 0), 1), (problem.size,))
    return _factor(problem, total)


@jax.custom_jvp
def _factor(problem: ProblemBatch, total: Array) -> Array:
    estimate = _interior_point_estimates(problem, total)
    # The search of a tile ends when its own problems are done.
    inputs = replace(problem, count=None), total, estimate
    log_factor = over_chosen(
        lambda inputs, _: _search(*inputs, None)[0], inputs, estimate.factor, estimate.unproven, TILE
    )
    return jnp.exp(log_factor)


def _evaluated_factor(problem: ProblemBatch, total: Array) -> tuple[Array, "_FactorEvaluation"]:
    """Compute the factor and its evaluation, the last of the search, so that it is compiled only once."""
    estimate = _interior_point_estimates(problem, total)
    no_evaluation = varying_like(_empty_evaluation(problem, total), problem, total)
    inputs, initial = (replace(problem, count=None), total, estimate), (estimate.factor, no_evaluation)
    factor, evaluation = over_chosen(
        lambda inputs, initial: _search(*inputs, initial[1]), inputs, initial, _is_not_padding(problem), TILE
    )
    return jnp.exp(factor), evaluation


def _is_not_padding(problem: ProblemBatch) -> Array:
    """Return the mask ``(B,)`` of problems that are not padding."""
    return jnp.arange(problem.size) < (problem.size if problem.count is None else problem.count)


def _interior_point_estimates(problem: ProblemBatch, total: Array) -> "_FactorEstimate":
    """Run interior-point searches from several starts, each for the problems without a proven factor."""
    # It takes derivatives, which a count does not have.
    inputs = replace(problem, count=None), total
    estimate = varying_like(_FactorEstimate(jnp.zeros_like(total), _is_not_padding(problem)), problem, total)

    def attempt(index: Array, estimate: _FactorEstimate) -> _FactorEstimate:
        first = jnp.asarray(FIRST, total.dtype)[index]
        return over_chosen(partial(_interior_point_attempt, first), inputs, estimate, estimate.unproven, TILE)

    # A loop rather than several calls: the attempts are one piece of compiled code.
    return lax.fori_loop(0, len(FIRST), attempt, estimate)


class _FactorEstimate(NamedTuple):
    """Logarithms of factors."""

    factor: Array
    unproven: Array
    """True if the factor is not proven: it is a start of the search, and may be NaN."""


def _interior_point_attempt(
    first: Array, inputs: tuple[ProblemBatch, Array], estimate: _FactorEstimate
) -> _FactorEstimate:
    """Search by one interior-point run, which proves its factors but for a few problems at the end of its digits."""
    problem, total = inputs
    unit_weight = with_unit_weights(problem)
    data, allowed_total = unit_weight.data, (total - held_total(problem))[None] / unit_weight.scaling.force_unit
    loaded = spatial.length(spatial.join(data.force, data.torque)) > 0
    searched = unit_weight.valid & loaded & (allowed_total > 0) & jnp.any(data.weights > 0, 0, keepdims=True)
    best = least_friction_factor(
        unit_weight, jnp.where(searched, allowed_total, 1), ~(searched & estimate.unproven[None]), first
    )
    # At a boundary of what can be exerted no arithmetic tells whether forces exist: a little beyond they do.
    factor = jnp.log(best.factor) + jnp.where(best.spent, 0, _bracket_tolerance(total) / 2)
    factor = jnp.where(
        best.lower >= LARGEST_FACTOR, jnp.inf, jnp.where(best.factor <= 1 / LARGEST_FACTOR, -jnp.inf, factor)
    )
    needs_none = unit_weight.valid & ~loaded & (allowed_total >= 0)
    factor = jnp.where(searched[0], factor, jnp.where(needs_none[0], -jnp.inf, jnp.inf))
    return _FactorEstimate(factor, searched[0] & ~best.proven)


@_factor.defjvp
def _factor_tangent(primals, tangents):
    """Differentiate the factor: there the least total stays the one allowed, or the wrench stays at its boundary."""
    (problem, total), (problem_moved, total_moved) = primals, tangents
    factor, evaluation = _evaluated_factor(problem, total)
    inside = jnp.isfinite(factor) & (factor > 0)
    # An infinite factor times a derivative of zero would be no number, in one direction or the other.
    finite = jnp.where(inside, factor, 1)
    log_factor = jnp.log(finite)
    scaled, scaled_moved = jax.jvp(lambda problem: _with_factor(problem, log_factor), (problem,), (problem_moved,))
    spent = jnp.isfinite(evaluation.excess) & (jnp.abs(evaluation.excess) <= _bracket_tolerance(total))
    falls = spent & (evaluation.slope < 0)
    needed = jnp.where(falls, evaluation.needed, 1)
    # e(x, p) = log total(x, p) - log allowed = 0 along the tangent: dx = -(d total / total - d allowed / allowed) / e'.
    rise = total_tangent(scaled, scaled_moved, evaluation.needed, evaluation.boundary) / needed
    rise = rise - total_moved / jnp.where(falls, total, 1)
    by_total = -rise / jnp.where(falls, evaluation.slope, 1)
    by_boundary, is_at_boundary = _boundary_tangent(scaled, scaled_moved)
    tangent = jnp.where(falls, by_total, jnp.where(is_at_boundary, by_boundary, 0))
    undefined = jnp.isinf(factor) | (inside & ~(falls | (~spent & is_at_boundary)))
    return factor, nan_tangents_where(undefined, jnp.where(inside, finite * tangent, 0), primals, tangents)


def _boundary_tangent(problem: ProblemBatch, moved: ProblemBatch) -> tuple[Array, Array]:
    """Compute the tangent of the logarithm of a factor below which nothing balances, and the mask of its validity.

    The boundary is sought from the wrench away from that of pressing contacts, which lies inside the reachable set.
    """
    points, pushes = problem.points, problem.normals
    if problem.present is not None:
        points, pushes = (jnp.where(problem.present[..., None] > 0.5, array, 0) for array in (points, pushes))
    torques = jnp.cross(points, pushes)
    pressing = jnp.concatenate([jnp.sum(pushes, 1), jnp.sum(torques, 1)], 1)
    direction = lax.stop_gradient(jnp.broadcast_to(-pressing, problem.wrench.shape))
    theta, boundary = bound_along(lax.stop_gradient(problem), direction)

    def work(problem: ProblemBatch) -> Array:
        return work_along(problem, problem.wrench, boundary)

    # Work W(x, p) = 0 at the boundary: dx = -dW/dp / (dW/dx), with d friction / dx = friction.
    growing = eqx.tree_at(lambda p: p.friction, jax.tree.map(zero_tangent, problem), problem.friction)
    _, by_friction = jax.jvp(work, (problem,), (growing,))
    _, by_problem = jax.jvp(work, (problem,), (moved,))
    # The wrench lies at the boundary as far as the factor was found; else nothing was found below for want of
    # digits, and the factor moves with nothing that is known.
    distance = jnp.where(jnp.isfinite(theta), jnp.abs(theta), jnp.inf)
    is_at_boundary = (by_friction > 0) & (distance <= NEAR * _bracket_tolerance(theta) * by_friction)
    return -by_problem / jnp.where(is_at_boundary, by_friction, 1), is_at_boundary


class _FactorEvaluation(NamedTuple):
    """Evaluation of the least total at a factor of the friction; factors are logarithms."""

    excess: Array
    """Logarithm of the least total over the one allowed; infinite where no forces exist."""
    slope: Array
    """Derivative of the excess by the factor; 0 where it has none."""
    needed: Array
    """The least total [N]."""
    boundary: BoundaryPoint
    """Boundary point that bounds the least total."""


def _empty_evaluation(problem: ProblemBatch, total: Array) -> _FactorEvaluation:
    """Return zeros of the shapes of an evaluation, with a row per problem also where all share one grasp."""
    size, contacts = total.shape[0], problem.points.shape[1]
    centre, twist = jnp.zeros((size, 3), total.dtype), jnp.zeros((size, 6), total.dtype)
    per_contact, vectors = jnp.zeros((size, contacts), total.dtype), jnp.zeros((size, contacts, 3), total.dtype)
    boundary = BoundaryPoint(centre, twist, per_contact, vectors, None if problem.torsion is None else per_contact)
    zeros = jnp.zeros_like(total)
    return _FactorEvaluation(zeros, zeros, zeros, boundary)


def _evaluate(problem: ProblemBatch, total: Array, factor: Array) -> _FactorEvaluation:
    scaled = _with_factor(problem, factor)
    needed, boundary = bounded_total(scaled)
    # A total that is not proven is not known to be enough.
    needed = jnp.where(jnp.isnan(needed), jnp.inf, needed)
    zero_tangents = jax.tree.map(jnp.zeros_like, scaled)
    growing = eqx.tree_at(lambda p: p.friction, zero_tangents, scaled.friction)
    finite = jnp.isfinite(needed) & (needed > 0)
    slope = jnp.where(finite, total_tangent(scaled, growing, needed, boundary) / jnp.where(finite, needed, 1), 0)
    return _FactorEvaluation(_log_ratio(needed, total), slope, needed, boundary)


def _with_factor(problem: ProblemBatch, factor: Array) -> ProblemBatch:
    return eqx.tree_at(lambda p: p.friction, problem, problem.friction * jnp.exp(factor)[:, None])


def _log_ratio(needed: Array, total: Array) -> Array:
    is_positive = needed > 0
    ratio = jnp.log(jnp.where(is_positive, needed, 1)) - jnp.log(jnp.maximum(total, 0))
    return jnp.where(is_positive, ratio, -jnp.inf)


class _Bracket(NamedTuple):
    low: Array
    high: Array
    low_tried: Array
    high_tried: Array
    current: Array
    apart: Array
    """Distance from one bound at which the other is sought first."""
    done: Array


EvaluationT = TypeVar("EvaluationT", bound=_FactorEvaluation | None)


def _search(
    problem: ProblemBatch, total: Array, estimate: _FactorEstimate, no_evaluation: EvaluationT
) -> tuple[Array, EvaluationT]:
    """Search for the factor where the excess falls to zero, or from infinity to below it, factor by factor.

    Returns logarithms of factors, and the evaluations there; None if ``no_evaluation`` is None.
    """
    widest = jnp.full_like(total, jnp.log(LARGEST_FACTOR))
    none_yet, has_estimate = jnp.zeros_like(total, bool), jnp.abs(estimate.factor) < widest
    apart = jnp.where(has_estimate, 0.9 * _bracket_tolerance(total), 2 * widest)
    start = _Bracket(
        -widest, widest, none_yet, none_yet, jnp.where(has_estimate, estimate.factor, 0), apart, ~estimate.unproven
    )

    def step(carry):
        count, state, is_evaluated, last = carry
        evaluation = _evaluate(problem, total, state.current)
        moved = jax.tree.map(lambda old, new: jnp.where(state.done, old, new), state, _step(state, evaluation))
        if last is None:
            return count + 1, moved, moved.done, None
        # Whatever is done has its last look, at its factor.
        last = jax.tree.map(lambda old, new: jnp.where(beside(is_evaluated, new), old, new), last, evaluation)
        return count + 1, moved, state.done, last

    is_evaluated = start.done if no_evaluation is None else none_yet
    initial = (jnp.int32(0), *varying_like((start, is_evaluated, no_evaluation), problem, total))
    _, state, _, last = lax.while_loop(lambda c: (c[0] < STEPS) & ~jnp.all(c[2]), step, initial)
    narrow = _bracket_tolerance(total)
    always, never = state.high + widest <= narrow, widest - state.low <= narrow
    factor = jnp.where(always, -jnp.inf, jnp.where(never, jnp.inf, state.current))
    return jnp.where(estimate.unproven, factor, estimate.factor), last


def _bracket_tolerance(like: Array) -> float:
    """Return the distance of logarithmic bounds at which they count as equal."""
    return float(jnp.finfo(like.dtype).eps) ** 0.4


def _step(state: _Bracket, evaluation: _FactorEvaluation) -> _Bracket:
    """Take a step of Newton's method where forces exist; bisect if it leaves bounds that were tried, or otherwise."""
    eps = float(jnp.finfo(state.current.dtype).eps)
    is_enough = evaluation.excess <= 0
    low, high = jnp.where(is_enough, state.low, state.current), jnp.where(is_enough, state.current, state.high)
    low_tried, high_tried = state.low_tried | ~is_enough, state.high_tried | is_enough
    falls = jnp.isfinite(evaluation.excess) & (evaluation.slope < 0)
    # Newton's step x - e(x) / e'(x) for the excess e of the logarithm x of the factor.
    newton = state.current - jnp.where(falls, evaluation.excess / jnp.where(falls, evaluation.slope, 1), 0)
    trial = jnp.clip(newton, low, high)
    is_rejected = (
        ((trial <= low) & low_tried) | ((trial >= high) & high_tried) | (jnp.abs(trial - state.current) > state.apart)
    )
    # Close to where it was looked for first; then farther and farther off.
    middle = (low + high) / 2
    middle = jnp.where(low_tried, middle, jnp.maximum(high - state.apart, middle))
    middle = jnp.where(high_tried, middle, jnp.minimum(low + state.apart, middle))
    is_narrow = high - low <= _bracket_tolerance(state.current)
    converged = falls & (jnp.abs(newton - state.current) <= eps**0.6)
    factor = jnp.where(converged | (falls & ~is_rejected), trial, jnp.where(is_narrow, high, middle))
    return _Bracket(low, high, low_tried, high_tried, factor, FARTHER * state.apart, is_narrow | converged)
