"""With how little friction a grasp holds its load, if its normal forces may reach a total."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force.least_squeeze import bounded_total, total_tangent
from jaxgrasp.force.margin import bound_along
from jaxgrasp.model.arguments import check_arguments, check_sign
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics.no_derivative import without_derivative
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.numerics.zero_tangent import zero_tangent
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import Sharing
from jaxgrasp.solver.dispatch import dispatch
from jaxgrasp.solver.wrench_boundary import BoundaryPoint, work_along

WIDEST = 1e4
"""Factors beyond this, or below its inverse, are not looked for."""
STEPS = 60
TILE = 32
NEAR = 100
"""Bounds of a share that halving has found, within which the boundary must be: what is farther was not what bounds."""


def least_friction(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    total: Float[AnyArray, "*#batch"] | float | None = None,
) -> Float[Array, "..."]:
    """The least share of its friction with which a grasp holds its load by a total of normal forces.

    Its inverse is the grasp's reserve: as many times smaller may every friction coefficient be. An optimum with an
    active cone has no friction margin left, whatever reserve it has.

    It is the inverse of [`jaxgrasp.least_squeeze`][], to about 1e-9 of itself, and differentiable once, by the total
    too. Where less friction would not leave too little, but nothing that balances the wrench at all, it is found by
    halving, to 1e-6, and moves with the boundary of what the grasp can exert; NaN is the derivative where neither the
    total nor a boundary can be told to hold it. That is so, too, where friction is scaled to so little (below 1e-4 or
    so) that no forces are found though some exist: the share is then larger than the least.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][]; it matters only for contacts of weight zero.
        total: of the normal forces ``(...)`` [N]; where not given, that of the squeezing forces, which the hand means
            to exert.

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
    return dispatch(_least_share, grasp, wrench, sharing, tails=(("total", ()),), total=total)


def _least_share(problem: ProblemBatch, total: Array | None = None) -> Array:
    if total is None:
        there = 1.0 if problem.present is None else problem.present > 0.5
        total = jnp.broadcast_to(jnp.sum(jnp.where(there, problem.squeeze, 0), 1), (problem.size,))
    return _share(problem, total)


@jax.custom_jvp
def _share(problem: ProblemBatch, total: Array) -> Array:
    return jnp.exp(_searched(problem, total, evaluated=False)[0])


@_share.defjvp
def _share_tangent(primals, tangents):
    """At the share the least total is the one allowed and stays so, or the wrench is at its boundary and stays so."""
    (problem, total), (problem_moved, total_moved) = primals, tangents
    here, seen = _searched(problem, total, evaluated=True)
    share = jnp.exp(here)
    inside = jnp.isfinite(share) & (share > 0)
    # An infinite share times a derivative of zero would be no number, in one direction or the other.
    finite = jnp.where(inside, share, 1)
    scaled, scaled_moved = jax.jvp(lambda problem: _with_share(problem, jnp.log(finite)), (problem,), (problem_moved,))
    spent = jnp.isfinite(seen.excess) & (jnp.abs(seen.excess) <= _narrow(total))
    falls = spent & (seen.slope < 0)
    needed = jnp.where(falls, seen.needed, 1)
    rise = total_tangent(scaled, scaled_moved, seen.needed, seen.boundary) / needed
    rise = rise - total_moved / jnp.where(falls, total, 1)
    by_total = -rise / jnp.where(falls, seen.slope, 1)
    by_boundary, met = _boundary_tangent(scaled, scaled_moved)
    tangent = jnp.where(falls, by_total, jnp.where(met, by_boundary, 0))
    undefined = jnp.isinf(share) | (inside & ~(falls | (~spent & met)))
    return share, without_derivative(undefined, jnp.where(inside, finite * tangent, 0), primals, tangents)


def _boundary_tangent(problem: ProblemBatch, moved: ProblemBatch) -> tuple[Array, Array]:
    """How the logarithm of a share moves below which nothing balances, and whether a boundary was found.

    It is sought from the wrench away from that of pressing contacts, which lies inside of what they can exert.
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

    growing = eqx.tree_at(lambda p: p.friction, jax.tree.map(zero_tangent, problem), problem.friction)
    _, by_friction = jax.jvp(work, (problem,), (growing,))
    _, by_problem = jax.jvp(work, (problem,), (moved,))
    # The wrench lies at the boundary as far as halving has found the share; else nothing was found below for want of
    # digits, and the share moves with nothing that is known.
    distance = jnp.where(jnp.isfinite(theta), jnp.abs(theta), jnp.inf)
    met = (by_friction > 0) & (distance <= NEAR * _narrow(theta) * by_friction)
    return -by_problem / jnp.where(met, by_friction, 1), met


class _ShareEvaluation(NamedTuple):
    """What is known at a share of the friction; shares are logarithms."""

    excess: Array
    """Logarithm of the least total over the one allowed; infinite where no forces exist."""
    slope: Array
    """Its derivative; 0 where it has none."""
    needed: Array
    """The least total [N]."""
    boundary: BoundaryPoint
    """What bounds it."""


def _evaluate(problem: ProblemBatch, total: Array, share: Array) -> _ShareEvaluation:
    scaled = _with_share(problem, share)
    needed, boundary = bounded_total(scaled)
    still = jax.tree.map(jnp.zeros_like, scaled)
    growing = eqx.tree_at(lambda p: p.friction, still, scaled.friction)
    finite = jnp.isfinite(needed) & (needed > 0)
    slope = jnp.where(finite, total_tangent(scaled, growing, needed, boundary) / jnp.where(finite, needed, 1), 0)
    return _ShareEvaluation(_log_ratio(needed, total), slope, needed, boundary)


def _with_share(problem: ProblemBatch, share: Array) -> ProblemBatch:
    return eqx.tree_at(lambda p: p.friction, problem, problem.friction * jnp.exp(share)[:, None])


def _log_ratio(needed: Array, total: Array) -> Array:
    some = needed > 0
    ratio = jnp.log(jnp.where(some, needed, 1)) - jnp.log(jnp.maximum(total, 0))
    return jnp.where(some, ratio, -jnp.inf)


class _Bracket(NamedTuple):
    low: Array
    high: Array
    low_tried: Array
    high_tried: Array
    here: Array
    done: Array


def _searched(problem: ProblemBatch, total: Array, evaluated: bool) -> tuple[Array, _ShareEvaluation]:
    """Logarithms of the shares, and what is known there; where not ``evaluated``, what is known next to them."""
    # One tile's search ends when its own problems are done. It takes derivatives, which a count does not have.
    all_there = replace(problem, count=None)
    search = partial(_search, evaluated=evaluated)
    return over_tiles(lambda these: search(*these), (all_there, total), problem.size, TILE, problem.count)


def _search(problem: ProblemBatch, total: Array, *, evaluated: bool) -> tuple[Array, _ShareEvaluation]:
    """Where the excess falls to zero, or from infinity to below it."""
    widest = jnp.full_like(total, jnp.log(WIDEST))
    no = jnp.zeros_like(total, bool)
    start = _Bracket(-widest, widest, no, no, jnp.zeros_like(total), no)
    nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(_evaluate, problem, total, start.here))
    start, nothing = varying_like((start, nothing), problem, total)

    def step(carry):
        count, state, _, _ = carry
        seen = _evaluate(problem, total, state.here)
        stays = state.done | (count == STEPS)
        state = jax.tree.map(lambda old, new: jnp.where(stays, old, new), state, _step(state, seen))
        # Once all stay, each was seen where it is.
        over = jnp.all(stays) if evaluated else jnp.all(state.done) | (count == STEPS - 1)
        return count + 1, state, seen, over

    _, state, seen, _ = lax.while_loop(lambda c: ~c[3], step, (jnp.int32(0), start, nothing, jnp.asarray(False)))
    narrow = _narrow(total)
    always, never = state.high + widest <= narrow, widest - state.low <= narrow
    return jnp.where(always, -jnp.inf, jnp.where(never, jnp.inf, state.here)), seen


def _narrow(like: Array) -> float:
    """Bounds that are as good as one."""
    return float(jnp.finfo(like.dtype).eps) ** 0.4


def _step(state: _Bracket, seen: _ShareEvaluation) -> _Bracket:
    """Newton's, where forces exist; what leads out of the bounds is halved, once these have been tried."""
    eps = float(jnp.finfo(state.here.dtype).eps)
    enough = seen.excess <= 0
    low, high = jnp.where(enough, state.low, state.here), jnp.where(enough, state.here, state.high)
    low_tried, high_tried = state.low_tried | ~enough, state.high_tried | enough
    falls = jnp.isfinite(seen.excess) & (seen.slope < 0)
    newton = state.here - jnp.where(falls, seen.excess / jnp.where(falls, seen.slope, 1), 0)
    led = jnp.clip(newton, low, high)
    tried = ((led <= low) & low_tried) | ((led >= high) & high_tried)
    met, arrived = high - low <= _narrow(state.here), falls & (jnp.abs(newton - state.here) <= eps**0.6)
    share = jnp.where(arrived | (falls & ~tried), led, jnp.where(met, high, (low + high) / 2))
    return _Bracket(low, high, low_tried, high_tried, share, met | arrived)
