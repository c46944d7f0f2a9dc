"""Where what contacts can exert comes to an end: problems without sharing, and how an answer there moves.

What is in reach depends neither on the weights nor on the squeeze of contacts that can move. At its limit a twist
bounds it, the ``normal``: no contact can work along it, and the answer moves as forces and wrench work along it.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.vec3 import Vec
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import Lanes, Problem, read, squeezing
from jaxgrasp.problem.contact_vec import Four
from jaxgrasp.problem.scaling import Frame, principal
from jaxgrasp.problem.spatial import Six
from jaxgrasp.solver import dual, reach
from jaxgrasp.solver.coordinates import unstretched


class Bare(NamedTuple):
    """Lanes whose contacts can all move, with one weight, or carry nothing; and hold nothing."""

    lanes: Lanes
    frame: Frame
    valid: Array


class Limit(NamedTuple):
    """What bounds an answer, batch-first in the user's units and axes."""

    centre: Array
    """``(B, 3)`` [m]: the normal is written about this point."""
    normal: Array
    """``(B, 6)``: a twist."""
    press: Array
    """``(B, n)`` [N]: normal forces at the limit."""
    lean: Array
    """``(B, n, 3)``: tangential forces at the limit, relative to the largest that friction allows."""
    twirl: Array | None
    """``(B, n)``: moments likewise; None where all contacts are hard."""


class _Touch(NamedTuple):
    """How the contacts touch the hyperplane that bounds what is in reach."""

    normal: Six
    press: Array
    lean: Four


def bare(problem: Problem) -> Bare:
    """A problem's lanes for questions of reach; what contacts of weight zero hold is taken off the load."""
    lanes, valid = read(problem)
    can_move = lanes.weights > 0
    weights = can_move.astype(lanes.weights.dtype)
    lanes = lanes._replace(weights=weights, squeeze=jnp.where(can_move, 0, lanes.squeeze))
    lanes, frame = principal(lanes)
    load = dual.residual(lanes, squeezing(lanes), unstretched(lanes.force.x))
    return Bare(loaded(lanes, load), frame, valid & frame.sound)


def loaded(lanes: Lanes, wrench: Six) -> Lanes:
    """The lanes under another wrench, and nothing held."""
    force, torque = spatial.parts(wrench)
    return lanes._replace(squeeze=0 * lanes.squeeze, force=force, torque=torque)


def limit_of(there: Bare, last: Lanes, before: Lanes, path: reach.Path, size: Array) -> Limit:
    """What a path of multipliers leads to, in the user's axes and units; ``size`` is that of a unit of its answer.

    ``last`` and ``before`` are the lanes as they were at the path's last two prices. The touch is that at the last
    price, less the error that falls with the price.
    """
    share = vec3.safe_divide(path.price_before, path.price - path.price_before)
    now, then = _touch(last, path.point, path.price), _touch(before, path.point_before, path.price_before)
    normal = now.normal + share * (now.normal - then.normal)
    press = now.press + share * (now.press - then.press)
    lean = contact_vec.add(now.lean, contact_vec.scale(share, contact_vec.sub(now.lean, then.lean)))
    frame, one = there.frame, jnp.ones_like(size)
    assert frame.axes is not None
    linear, angular = spatial.parts(vec3.safe_divide(normal, size))
    linear = vec3.rotate_back(frame.axes, linear)
    angular = vec3.rotate_back(frame.axes, vec3.scale(1 / frame.length, angular))
    return Limit(
        centre=jnp.concatenate([c * one for c in frame.centre]).T,
        normal=spatial.six(linear, angular).T,
        press=(frame.load * press * one).T,
        lean=jnp.stack([c * one for c in vec3.rotate_back(frame.axes, lean.linear)]).transpose(2, 1, 0),
        twirl=None if lean.spin is None else (lean.spin * one).T,
    )


def _touch(lanes: Lanes, point: Six, price: Array) -> _Touch:
    best = dual.best_forces(lanes, point, unstretched(price))
    sides = best.sides
    used = jnp.where(sides.inside, vec3.safe_divide(sides.size, lanes.friction * sides.along), 1)
    press = vec3.dot(best.forces.linear, lanes.normals)
    return _Touch(vec3.safe_divide(point, price), press, contact_vec.scale(used, sides.tangent))


def work_along(problem: Problem, wrench: Array, limit: Limit) -> Array:
    """normal.(G f - wrench) of each problem ``(B,)``, the tangential forces turning with the cones.

    It is zero at the limit; its derivative by the problem and the wrench ``(B, 6)`` is how the answer moves.
    """
    lanes, _ = read(problem)
    centre, lean = (Vec(*jnp.moveaxis(a, -1, 0)) for a in (limit.centre, limit.lean))
    centre, lean = Vec(*(c[None] for c in centre)), Vec(*(c.T for c in lean))
    linear, angular = spatial.parts(limit.normal.T)
    velocity = vec3.add(linear, vec3.cross(angular, vec3.sub(lanes.arms, centre)))
    along = vec3.dot(velocity, lanes.normals)
    across = vec3.sub(velocity, vec3.scale(along, lanes.normals))
    slide = vec3.dot(lean, across)
    if lanes.lever is not None and limit.twirl is not None:
        slide = slide + limit.twirl.T * lanes.lever * vec3.dot(angular, lanes.normals)
    can_move = lanes.weights > 0
    press = jnp.where(can_move, limit.press.T, lanes.squeeze)
    push = along + jnp.where(can_move, lanes.friction * slide, 0)
    force, torque = spatial.parts(wrench.T)
    asked = vec3.dot(linear, force) + vec3.dot(angular, vec3.sub(torque, vec3.cross(centre, force)))
    return (jnp.sum(press * push, 0, keepdims=True) - asked)[0]
