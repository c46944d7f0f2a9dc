"""How far a wrench can grow along a direction before no allowed forces exert it any more."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.force import dual, elastic, sixes
from jaxgrasp.force.flat import Sharing, flatten, read_sharing, warn_of_lost_precision
from jaxgrasp.force.lanes import Frame, Lanes, Problem, principal, read
from jaxgrasp.force.sixes import Six
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.force.unknowns import unstretched
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.numerics import vec
from jaxgrasp.numerics.tiles import over_tiles
from jaxgrasp.numerics.vec import Vec

Out = TypeVar("Out")

TILE = 32


def wrench_margin(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    direction: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
) -> Float[Array, "..."]:
    """The largest theta for which forces inside the friction cones exert wrench + theta direction.

    The forces may be as large as they need; how they are shared matters only for contacts of weight zero,
    which hold their squeezing force. Where a direction is resisted only by forces some hundred thousand
    times the load or more, the margin is not to be relied on: by contacts that lie on a line but for 1e-5 of
    its length it stops short, at what smaller forces reach; by friction beyond 1e5, or a pinch that misses
    closing by less than 1e-6, it goes too far, up to +inf.

    Differentiable once, by everything but the sharing: at the limit a hyperplane bounds what the contacts
    exert, and the margin moves as that does. Where several do, the derivative is that of one.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts exert already ``(..., 6)`` [N, N.m].
        direction: of the wrench to be added ``(..., 6)``, of any size.
        sharing: as for [`jaxgrasp.closed_form`][].

    Returns:
        ``(...)``, in units of the direction. Negative where the wrench lies out of reach itself, but can be
        led back. +inf where no theta is too large, as on a force-closed grasp; -inf where no theta, positive
        or negative, is in reach, or the data are invalid. The derivative of an infinite margin is zero.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    warn_of_lost_precision(grasp, wrench)
    name, weights = read_sharing(sharing)
    return _run(grasp, wrench, direction, weights, sharing=name)


@partial(jax.jit, static_argnames=("sharing",))
def _run(grasp, wrench, direction, weights, *, sharing: str) -> Array:
    problem, flat, batch = flatten(grasp, wrench, weights, sharing, direction=direction)
    return _margin(problem, flat).reshape(batch)


class _Bound(NamedTuple):
    """What bounds the margin, batch-first in the user's units and axes."""

    margin: Array
    """``(B,)``"""
    centre: Array
    """``(B, 3)`` [m]: the hyperplane's normal is written about this point."""
    normal: Array
    """``(B, 6)``: a twist that does unit work along the direction."""
    press: Array
    """``(B, n)`` [N]: normal forces at the limit."""
    lean: Array
    """``(B, n, 3)``: tangential forces at the limit, relative to the largest that friction allows."""


@jax.custom_jvp
def _margin(problem: Problem, direction: Array) -> Array:
    return _over_tiles(_margin_of_tile, problem, direction)


@_margin.defjvp
def _margin_moves(primals, tangents):
    """The envelope theorem: theta + normal.(G f - wrench - theta direction) is stationary at the limit."""
    bound = _bound(*primals)
    _, moved = jax.jvp(lambda problem, direction: _lagrangian(problem, direction, bound), primals, tangents)
    return bound.margin, jnp.where(jnp.isfinite(bound.margin), moved, 0)


@jax.custom_jvp
def _bound(problem: Problem, direction: Array) -> _Bound:
    return _over_tiles(_bound_of_tile, problem, direction)


@_bound.defjvp
def _no_second_derivative(primals, tangents):
    raise NotImplementedError("wrench_margin has first derivatives only")


def _over_tiles(function: Callable[[tuple[Problem, Array]], Out], problem: Problem, direction: Array) -> Out:
    if problem.size:
        return over_tiles(function, (problem, direction), problem.size, TILE)
    one = jax.tree.map(lambda x: jnp.zeros((1, *x.shape[1:]), x.dtype), (problem, direction))
    return jax.tree.map(lambda s: jnp.zeros((0, *s.shape[1:]), s.dtype), jax.eval_shape(function, one))


class _Line(NamedTuple):
    """Wrenches load + theta ray in lanes whose contacts can all move or carry nothing, and hold nothing."""

    lanes: Lanes
    frame: Frame
    ray: Six
    """Of length 1, or 0."""
    size: Array
    """Length of the direction that the ray stands for."""
    valid: Array


class _End(NamedTuple):
    """Where a line leaves what is in reach."""

    theta: Array
    path: elastic.Path
    """Its multipliers are normal to the hyperplane that bounds what is in reach."""


class _Touch(NamedTuple):
    """How the contacts touch that hyperplane."""

    normal: Six
    """Of unit work along the ray."""
    press: Array
    """Normal forces."""
    lean: Vec
    """Tangential forces, relative to the largest that friction allows."""


def _line(problem: Problem, direction: Array) -> _Line:
    lanes, valid = read(problem)
    can_move = lanes.weights > 0
    # What is in reach depends neither on the weights nor on the squeeze of contacts that can move.
    weights = can_move.astype(lanes.weights.dtype)
    lanes = lanes._replace(weights=weights, squeeze=jnp.where(can_move, 0, lanes.squeeze))
    lanes, frame = principal(lanes)
    limits = tolerances(direction.dtype)
    asked = jnp.sum(jnp.abs(direction.T), 0, keepdims=True)
    valid = valid & frame.sound & (asked <= limits.largest) & ((asked == 0) | (asked >= limits.smallest))
    ray = elastic.wrench_in(jnp.where(valid, direction.T, 0), frame)
    size = sixes.length(ray)
    held = vec.scale(lanes.squeeze, lanes.normals)
    load = dual.residual(lanes, held, unstretched(size))
    return _Line(_loaded(lanes, load), frame, vec.safe_divide(ray, size), size, valid)


def _loaded(lanes: Lanes, wrench: Six) -> Lanes:
    force, torque = sixes.parts(wrench)
    return lanes._replace(squeeze=0 * lanes.squeeze, force=force, torque=torque)


def _end(line: _Line) -> _End:
    metric = elastic.identity(line.size)
    never_fails = elastic.nearest(_loaded(line.lanes, line.ray), metric, ~line.valid).reached
    start, somewhere = elastic.nearest(line.lanes, metric, ~line.valid, line.ray)
    theta, path = elastic.along_ray(line.lanes, line.ray, start, never_fails | ~somewhere)
    theta = jnp.where(never_fails, jnp.inf, theta)
    return _End(jnp.where(somewhere & line.valid, theta, -jnp.inf), path)


def _in_units(line: _Line, end: _End) -> Array:
    finite = jnp.isfinite(end.theta)
    theta = jnp.where(finite, end.theta, 0)
    return jnp.where(finite, line.frame.load * vec.safe_divide(theta, line.size), end.theta)[0]


def _touch(line: _Line, path: elastic.Path) -> _Touch:
    """At the last price, less the error that falls with the price."""
    last = _touch_at(line, path.point, path.price)
    before = _touch_at(line, path.point_before, path.price_before)
    share = vec.safe_divide(path.price_before, path.price - path.price_before)
    return jax.tree.map(lambda a, b: a + share * (a - b), last, before)


def _touch_at(line: _Line, point: Six, price: Array) -> _Touch:
    best = dual.best_forces(line.lanes, point, unstretched(price))
    sides = best.sides
    used = jnp.where(sides.inside, vec.safe_divide(sides.size, line.lanes.friction * sides.along), 1)
    press = vec.dot(best.forces, line.lanes.normals)
    return _Touch(vec.safe_divide(point, price), press, vec.scale(used, sides.tangent))


def _written(line: _Line, end: _End) -> _Bound:
    """The bound in the user's axes and units."""
    frame, one = line.frame, jnp.ones_like(line.size)
    assert frame.axes is not None
    touch = _touch(line, end.path)
    linear, angular = sixes.parts(vec.safe_divide(touch.normal, line.size))
    linear = vec.rotate_back(frame.axes, linear)
    angular = vec.rotate_back(frame.axes, vec.scale(1 / frame.length, angular))
    return _Bound(
        margin=_in_units(line, end),
        centre=jnp.concatenate([c * one for c in frame.centre]).T,
        normal=sixes.six(linear, angular).T,
        press=(frame.load * touch.press * one).T,
        lean=jnp.stack([c * one for c in vec.rotate_back(frame.axes, touch.lean)]).transpose(2, 1, 0),
    )


def _margin_of_tile(arguments: tuple[Problem, Array]) -> Array:
    line = _line(*arguments)
    return _in_units(line, _end(line))


def _bound_of_tile(arguments: tuple[Problem, Array]) -> _Bound:
    line = _line(*arguments)
    return _written(line, _end(line))


def _lagrangian(problem: Problem, direction: Array, bound: _Bound) -> Array:
    """normal.(G f - wrench - theta direction) of each problem, the tangential forces turning with the cones."""
    lanes, _ = read(problem)
    theta = jnp.where(jnp.isfinite(bound.margin), bound.margin, 0)
    centre, lean = (Vec(*jnp.moveaxis(a, -1, 0)) for a in (bound.centre, bound.lean))
    centre, lean = Vec(*(c[None] for c in centre)), Vec(*(c.T for c in lean))
    linear, angular = sixes.parts(bound.normal.T)

    def work(force: Vec, torque: Vec) -> Array:
        return vec.dot(linear, force) + vec.dot(angular, vec.sub(torque, vec.cross(centre, force)))

    velocity = vec.add(linear, vec.cross(angular, vec.sub(lanes.arms, centre)))
    along = vec.dot(velocity, lanes.normals)
    across = vec.sub(velocity, vec.scale(along, lanes.normals))
    press = jnp.where(lanes.weights > 0, bound.press.T, lanes.squeeze)
    push = along + jnp.where(lanes.weights > 0, lanes.friction * vec.dot(lean, across), 0)
    asked = work(lanes.force, lanes.torque) + theta * work(*sixes.parts(direction.T))
    return (jnp.sum(press * push, 0, keepdims=True) - asked)[0]
