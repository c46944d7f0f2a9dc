"""The wrench that contacts can exert closest to a load, the furthest along a ray, and the least that they must press.

All come out of the same dual as the optimum, in a lane's coordinates. Let a wrench e be missed at a price of
t |e|^2 / 2: the dual is then pulled towards zero, by |x|^2 / 2t, and e = x / t. As the price rises e tends to the
shortest wrench that must be missed, while the multiplier x runs off along it. Or let theta be paid for at t: the dual
is then confined to the plane where the multiplier does work t along the ray. Or let each unit of normal force cost a
toll t, which takes t off the multiplier's velocity along each normal. In all of them the forces' own cost holds the
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
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.scaling import Scaling
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.coordinates import Coordinates, plain_axes

ARMIJO = 1e-4
STEPS_PER_LEVEL = 100
PENALTY_FACTOR = 10.0
"""Factor between one price and the next."""
FIRST_DAMPING = 10.0
"""Of the first step at each price, in units of 1 / t."""
DAMPING_FACTOR = 4.0
"""Less damping after a step that was good, more after one that was not."""
HIGHEST_DAMPING = 1e3
"""Relative to the largest curvature: no step that short is worth its time."""
RAY_PENALTY = 1e-6
"""Pull along a ray, in units of 1 / t: it only keeps Newton's matrix regular."""
STRAIGHT_PATH = 1e-5
"""Bend of the path between two prices, relative to the multiplier, that is none."""
PENALTY_ERROR = 1e4
"""What a higher price is worth against rounding: the error of theta at the price t, in units of (theta / t)^2."""
CHANGE_WEIGHT = 10.0
"""The same, measured: what is sought is off by a known share of its change between two prices. So much more than a
wrench that is missed aside, which shows in what is sought by its square only."""


class QuadraticPenalty(NamedTuple):
    """The pull -strength/2 (x - centre).metric (x - centre), and a plane that x may not leave."""

    strength: Array
    centre: SpatialVec
    metric: Lower
    normal: SpatialVec | None
    """Of the plane, of length 1 or 0; None where there is none."""
    unknowns: Coordinates
    """What x stands for."""


class _MaximiserState(NamedTuple):
    """Where each lane stands, and what Newton's method knows there."""

    point: SpatialVec
    value: Array
    gradient: SpatialVec
    curvature: Lower
    damping: Array
    done: Array


class PenaltyPath(NamedTuple):
    """The best point so far, and the one before it: in the end points lie on a straight line over their prices."""

    price: Array
    point: SpatialVec
    sought: Array
    price_before: Array
    point_before: SpatialVec
    badness: Array
    done: Array


class _Attempt(NamedTuple):
    """A point for the next price."""

    point: SpatialVec
    sought: Array
    """What the point says of theta or the least total, beside its size; 0 where neither is sought."""
    size: Array
    badness: Array
    far: Array
    """Whether the price may be high enough."""


class NearestWrench(NamedTuple):
    """The multiplier whose forces exert the wrench nearest to the load."""

    point: SpatialVec
    reached: Array
    """Whether nothing but rounding is missed, or the multiplier has come to rest, on its way to the optimum's. Where
    not it runs off, and the metric times it has the direction of what is missed."""


def largest_multiplier(dtype: np.dtype) -> float:
    """Where a multiplier that runs off is stopped: its rounding then weighs as much as what the price is short of."""
    return float(jnp.finfo(dtype).eps ** -0.55)


def identity(like: Array) -> Lower:
    one, zero = jnp.ones_like(like), jnp.zeros_like(like)
    return [[one if i == j else zero for j in range(i + 1)] for i in range(6)]


def nearest_wrench(
    lanes: ContactData,
    metric: Lower,
    frozen: Array,
    plane: SpatialVec | None = None,
    unknowns: Coordinates | None = None,
) -> NearestWrench:
    """The nearest wrench, what is missed of the load, e, being measured by e.metric^-1 e.

    With a ``plane`` the metric must be the identity, and wrenches along the plane's normal cost nothing. Plane,
    metric and point are those of the ``unknowns``: where they are not given, of the twist as it is.
    """
    unknowns = plain_axes(lanes.force.x) if unknowns is None else unknowns
    zero = varying_like(jnp.zeros((6, frozen.shape[-1]), lanes.squeeze.dtype), lanes)

    def attempt(price: Array, foreseen: SpatialVec, done: Array) -> _Attempt:
        point = maximise(lanes, QuadraticPenalty(1 / price, zero, metric, plane, unknowns), price, foreseen, done)
        rest = missed_wrench(lanes, point, unknowns)
        if plane is not None:
            rest = _in_plane(plane, rest)
        far = spatial.length(point) >= largest_multiplier(zero.dtype)
        return _Attempt(point, zero[:1], zero[:1] + 1, spatial.inner(rest, solve_by(metric, rest)), far)

    path = _follow(zero, frozen, attempt)
    settled = spatial.length(path.point) <= 2 * spatial.length(path.point_before)
    return NearestWrench(path.point, settled | (path.badness <= tolerances(zero.dtype).range ** 2))


def ray_search(lanes: ContactData, ray: SpatialVec, start: SpatialVec, frozen: Array) -> tuple[Array, PenaltyPath]:
    """The largest theta with load + theta ray in reach, and the multipliers of what bounds it, by their work.

    ``start`` does no work along the ``ray``, which has length 1. Lanes where no theta is in reach, or all
    are, should be ``frozen``.
    """
    metric, plain = identity(start[:1]), plain_axes(start[:1])

    def attempt(price: Array, foreseen: SpatialVec, done: Array) -> _Attempt:
        foreseen = foreseen + (price - spatial.inner(ray, foreseen)) * ray
        point = maximise(
            lanes, QuadraticPenalty(RAY_PENALTY / price, foreseen, metric, ray, plain), price, foreseen, done
        )
        rest = missed_wrench(lanes, point, plain)
        # load - G f is -theta ray. Along the multiplier neither its rounding nor what else is missed shows.
        theta = -spatial.inner(point, rest) / price
        size = 1 + jnp.abs(theta)
        aside = spatial.length(_in_plane(ray, rest)) * spatial.length(point) / price
        enough = price >= size * largest_multiplier(start.dtype)
        return _Attempt(point, theta, size, (aside / size) ** 2 + PENALTY_ERROR * (size / price) ** 2, enough)

    path = _follow(start, frozen, attempt)
    return path.sought, path


def least_normal_force(lanes: ContactData, frozen: Array) -> tuple[Array, PenaltyPath]:
    """The least total of normal forces that exert the load, and the multipliers of what bounds it, by the toll.

    Lanes that have no forces at all should be ``frozen``.
    """
    zero = varying_like(jnp.zeros((6, frozen.shape[-1]), lanes.squeeze.dtype), lanes)
    metric, plain = identity(zero[:1]), plain_axes(zero[:1])

    def attempt(price: Array, foreseen: SpatialVec, done: Array) -> _Attempt:
        point = maximise(
            with_normal_cost(lanes, price),
            QuadraticPenalty(RAY_PENALTY / price, foreseen, metric, None, plain),
            price,
            foreseen,
            done,
        )
        forces = dual.candidate_forces(with_normal_cost(lanes, price), point, plain).forces
        rest = dual.residual(lanes, forces, plain)
        # What is missed of the load would have to be pushed too, along the multiplier.
        total = dual.total_normal_force(lanes, forces) + spatial.inner(point, rest) / price
        size = 1 + total
        aside = spatial.length(rest) * spatial.length(point) / price
        enough = price >= size * largest_multiplier(zero.dtype)
        return _Attempt(point, total, size, (aside / size) ** 2 + PENALTY_ERROR * (size / price) ** 2, enough)

    path = _follow(zero, frozen, attempt)
    return path.sought, path


def with_normal_cost(lanes: ContactData, toll: Array) -> ContactData:
    """Lanes in which each unit of normal force costs a toll, beside half its square over the weight."""
    return lanes._replace(toll=toll)


def _follow(start: SpatialVec, frozen: Array, attempt: Callable[[Array, SpatialVec, Array], _Attempt]) -> PenaltyPath:
    """Raise the price until every lane is far enough, or its digits come to their end."""
    zero = jnp.zeros_like(start[:1])
    eps = float(jnp.finfo(zero.dtype).eps)
    highest = 1 / (64 * eps)

    def rise(carry):
        price, path = carry
        foreseen = _predicted(path, price)
        tried = attempt(price, foreseen, path.done)
        # A higher price is better. Where it is not Newton's method has failed: the next one starts from before.
        badness = tried.badness + (CHANGE_WEIGHT * _bias(path, price, tried.sought) / tried.size) ** 2
        better = ~path.done & (badness <= (1 + eps**0.5) * path.badness)
        # Where contacts resist only by enormous forces, the path bends late.
        straight = spatial.length(tried.point - foreseen) <= STRAIGHT_PATH * spatial.length(tried.point)
        return PENALTY_FACTOR * price, PenaltyPath(
            price=jnp.where(better, price, path.price),
            point=jnp.where(better, tried.point, path.point),
            sought=jnp.where(better, tried.sought, path.sought),
            price_before=jnp.where(better, path.price, path.price_before),
            point_before=jnp.where(better, path.point, path.point_before),
            badness=jnp.where(better, badness, path.badness),
            done=path.done | (better & tried.far & straight) | (price >= highest),
        )

    path = varying_like(PenaltyPath(zero, start, zero, zero, start, zero + jnp.inf, frozen), start, frozen)
    _, path = lax.while_loop(
        lambda carry: ~jnp.all(carry[1].done), rise, (jnp.asarray(PENALTY_FACTOR, zero.dtype), path)
    )
    return path


def _bias(path: PenaltyPath, price: Array, sought: Array) -> Array:
    """How far what is sought still is from its limit, since it comes closer by the square of the price."""
    some = path.price > 0
    ratio = jnp.where(some, price / jnp.where(some, path.price, 1), PENALTY_FACTOR)
    return jnp.where(some, (sought - path.sought) / (ratio**2 - 1), 0)


def _predicted(path: PenaltyPath, price: Array) -> SpatialVec:
    """The path goes straight in the end: by secant."""
    factor = vec3.safe_divide(price - path.price, path.price - path.price_before)
    return path.point + factor * (path.point - path.point_before)


def missed_wrench(lanes: ContactData, point: SpatialVec, unknowns: Coordinates) -> SpatialVec:
    return dual.residual(lanes, dual.candidate_forces(lanes, point, unknowns).forces, unknowns)


def maximise(lanes: ContactData, pull: QuadraticPenalty, price: Array, start: SpatialVec, frozen: Array) -> SpatialVec:
    """Maximise the dual less the pull by Newton's method, damped as each lane needs it.

    A line search such as ``newton.ascend`` has fails here: where the multiplier is large, most of Newton's
    direction lies where only the faint pull bends the dual, and a kink in it soon ends the step. Damping turns
    the step away instead. The search stops where a step has nothing to gain but rounding, not by the gradient,
    which is rounding itself in all directions but those that matter.
    """
    damping = FIRST_DAMPING / price + 0 * start[:1]
    state = varying_like(_MaximiserState(start, *_evaluate(lanes, pull, start), damping, frozen), lanes, pull, price)

    def unfinished(carry):
        count, state = carry
        return (count < STEPS_PER_LEVEL) & ~jnp.all(state.done)

    def advance(carry):
        count, state = carry
        return count + 1, _advance(lanes, pull, price, state)

    return lax.while_loop(unfinished, advance, (jnp.int32(0), state))[1].point


@fused_cpu_kernel
def _advance(lanes: ContactData, pull: QuadraticPenalty, price: Array, state: _MaximiserState) -> _MaximiserState:
    step = _step(pull, state)
    trial = state.point + step
    value, gradient, curvature = _evaluate(lanes, pull, trial)
    eps = jnp.finfo(value.dtype).eps
    # The value is a small difference where the multiplier is large.
    noise = 8 * eps * (1 + jnp.abs(value) + spatial.length(trial))
    gain = spatial.inner(state.gradient, step)
    better = value >= state.value + ARMIJO * gain - noise
    moves = better & ~state.done
    # Such a step doubles the digits, of which there are enough by then.
    last = moves & (gain <= noise) & (state.damping * price <= 1)
    damping = jnp.where(better, state.damping / DAMPING_FACTOR, DAMPING_FACTOR * state.damping)
    return _MaximiserState(
        point=jnp.where(moves, trial, state.point),
        value=jnp.where(moves, value, state.value),
        gradient=jnp.where(moves, gradient, state.gradient),
        curvature=jax.tree.map(lambda new, old: jnp.where(moves, new, old), curvature, state.curvature),
        damping=jnp.maximum(damping, 16 * eps),
        done=state.done | last | (state.damping > HIGHEST_DAMPING),
    )


def _step(pull: QuadraticPenalty, state: _MaximiserState) -> SpatialVec:
    """Newton's damped step, within the plane."""
    rows = [[*row[:-1], row[-1] + state.damping] for row in state.curvature]
    factors = ldl.factor(rows)
    step = dual.solve(factors, state.gradient)
    if pull.normal is None:
        return step
    across = dual.solve(factors, pull.normal)
    return step - vec3.safe_divide(spatial.inner(pull.normal, step), spatial.inner(pull.normal, across)) * across


@fused_cpu_kernel
def _evaluate(lanes: ContactData, pull: QuadraticPenalty, trial: SpatialVec) -> tuple[Array, SpatialVec, Lower]:
    """Value, gradient and minus Hessian."""
    at = dual.evaluate(lanes, trial, pull.unknowns)
    offset = trial - pull.centre
    heavy = pull.strength * times(pull.metric, offset)
    curvature = [
        [h + pull.strength * m for h, m in zip(*rows, strict=True)]
        for rows in zip(at.curvature, pull.metric, strict=True)
    ]
    return at.value - spatial.inner(offset, heavy) / 2, at.gradient - heavy, curvature


def _in_plane(normal: SpatialVec, x: SpatialVec) -> SpatialVec:
    """The part of x in the plane."""
    return x - spatial.inner(normal, x) * normal


def solve_by(metric: Lower, right: SpatialVec) -> SpatialVec:
    """metric^-1 right."""
    return dual.solve(ldl.factor(metric), right)


def times(metric: Lower, x: SpatialVec) -> SpatialVec:
    """metric x."""
    return jnp.concatenate(ldl.multiply(metric, [x[i : i + 1] for i in range(6)]))


def wrench_to_scaled(wrench: SpatialVec, frame: Scaling) -> SpatialVec:
    """A wrench about the user's origin in a lane's axes and lengths; in the user's forces."""
    force, torque = spatial.parts(wrench)
    torque = vec3.scale(1 / frame.length, vec3.sub(torque, vec3.cross(frame.centre, force)))
    if frame.axes is not None:
        force, torque = vec3.rotate(frame.axes, force), vec3.rotate(frame.axes, torque)
    return spatial.join(force, torque)


def wrench_from_scaled(wrench: SpatialVec, frame: Scaling) -> SpatialVec:
    """The inverse of ``wrench_in``."""
    force, torque = spatial.parts(wrench)
    if frame.axes is not None:
        force, torque = vec3.rotate_back(frame.axes, force), vec3.rotate_back(frame.axes, torque)
    return spatial.join(force, vec3.add(vec3.scale(frame.length, torque), vec3.cross(frame.centre, force)))
