"""Where what contacts can exert comes to an end: problems without sharing, and how an answer there moves.

What is in reach depends neither on the weights nor on the squeeze of contacts that can move. At its limit a twist
bounds it, the ``normal``: no contact can work along it, and the answer moves as forces and wrench work along it.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, squeezing_forces, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.scaling import Scaling, scale_in_principal_axes
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import dual, reach
from jaxgrasp.solver.coordinates import plain_axes


class UnsharedProblem(NamedTuple):
    """Lanes whose contacts can all move, with one weight, or carry nothing; and hold nothing."""

    lanes: ContactData
    frame: Scaling
    valid: Array


class BoundaryPoint(NamedTuple):
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


class _SupportingTwist(NamedTuple):
    """How the contacts touch the hyperplane that bounds what is in reach."""

    normal: SpatialVec
    press: Array
    lean: ContactVec


def without_sharing(problem: ProblemBatch) -> UnsharedProblem:
    """A problem's lanes for questions of reach; what contacts of weight zero hold is taken off the load."""
    lanes, valid = to_batch_last(problem)
    can_move = lanes.weights > 0
    weights = can_move.astype(lanes.weights.dtype)
    lanes = lanes._replace(weights=weights, squeeze=jnp.where(can_move, 0, lanes.squeeze))
    lanes, frame = scale_in_principal_axes(lanes)
    load = dual.residual(lanes, squeezing_forces(lanes), plain_axes(lanes.force.x))
    return UnsharedProblem(with_wrench(lanes, load), frame, valid & frame.sound)


def with_wrench(lanes: ContactData, wrench: SpatialVec) -> ContactData:
    """The lanes under another wrench, and nothing held."""
    force, torque = spatial.parts(wrench)
    return lanes._replace(squeeze=0 * lanes.squeeze, force=force, torque=torque)


def boundary_point(
    there: UnsharedProblem, last: ContactData, before: ContactData, path: reach.PenaltyPath, size: Array
) -> BoundaryPoint:
    """What a path of multipliers leads to, in the user's axes and units; ``size`` is that of a unit of its answer.

    ``last`` and ``before`` are the lanes as they were at the path's last two prices. The touch is that at the last
    price, less the error that falls with the price.
    """
    share = vec3.safe_divide(path.price_before, path.price - path.price_before)
    now, then = (
        _supporting_twist(last, path.point, path.price),
        _supporting_twist(before, path.point_before, path.price_before),
    )
    normal = now.normal + share * (now.normal - then.normal)
    press = now.press + share * (now.press - then.press)
    lean = contact_vec.add(now.lean, contact_vec.scale(share, contact_vec.sub(now.lean, then.lean)))
    frame, one = there.frame, jnp.ones_like(size)
    assert frame.axes is not None
    linear, angular = spatial.parts(vec3.safe_divide(normal, size))
    linear = vec3.rotate_back(frame.axes, linear)
    angular = vec3.rotate_back(frame.axes, vec3.scale(1 / frame.length, angular))
    return BoundaryPoint(
        centre=jnp.concatenate([c * one for c in frame.centre]).T,
        normal=spatial.join(linear, angular).T,
        press=(frame.load * press * one).T,
        lean=jnp.stack([c * one for c in vec3.rotate_back(frame.axes, lean.linear)]).transpose(2, 1, 0),
        twirl=None if lean.spin is None else (lean.spin * one).T,
    )


def _supporting_twist(lanes: ContactData, point: SpatialVec, price: Array) -> _SupportingTwist:
    best = dual.candidate_forces(lanes, point, plain_axes(price))
    sides = best.sides
    used = jnp.where(sides.inside, vec3.safe_divide(sides.size, lanes.friction * sides.along), 1)
    press = vec3.dot(best.forces.linear, lanes.normals)
    return _SupportingTwist(vec3.safe_divide(point, price), press, contact_vec.scale(used, sides.tangent))


def work_along(problem: ProblemBatch, wrench: Array, limit: BoundaryPoint) -> Array:
    """normal.(G f - wrench) of each problem ``(B,)``, the tangential forces turning with the cones.

    It is zero at the limit; its derivative by the problem and the wrench ``(B, 6)`` is how the answer moves.
    """
    lanes, _ = to_batch_last(problem)
    centre, lean = (Vec3(*jnp.moveaxis(a, -1, 0)) for a in (limit.centre, limit.lean))
    centre, lean = Vec3(*(c[None] for c in centre)), Vec3(*(c.T for c in lean))
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
