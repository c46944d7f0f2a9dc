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
from jaxgrasp.problem.coordinates import ScaledAxes, whitening_scales
from jaxgrasp.problem.scaling import Scaling, inertia, scale_in_principal_axes
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import dual, reach


class UnitWeightProblem(NamedTuple):
    """Problems with weight 1 or 0 for every contact and no squeeze: questions of what is reachable."""

    data: ContactData
    coordinates: ScaledAxes
    """Whitened: a torque about a line that the contacts nearly lie on counts as much as those across it."""
    scaling: Scaling
    valid: Array


class BoundaryPoint(NamedTuple):
    """Multipliers and forces at the bound of an answer, batch-first in the user's units and axes."""

    centre: Array
    """``(B, 3)`` [m]: the normal is written about this point."""
    normal: Array
    """``(B, 6)``: a twist."""
    normal_force: Array
    """``(B, n)`` [N]: normal forces at the limit."""
    friction_use: Array
    """``(B, n, 3)``: tangential forces at the limit, relative to the largest that friction allows."""
    spin_use: Array | None
    """``(B, n)``: moments relative to the largest that friction allows; None where all contacts are hard."""


class _SupportingTwist(NamedTuple):
    """The hyperplane that bounds what is in reach, by its normal in coordinates, and the forces that lie on it."""

    normal: SpatialVec
    normal_force: Array
    friction_use: ContactVec


def with_unit_weights(batch: ProblemBatch) -> UnitWeightProblem:
    """Problems for questions of reach; what contacts of weight zero hold is taken off the load."""
    data, valid = to_batch_last(batch)
    adjustable = data.weights > 0
    weights = adjustable.astype(data.weights.dtype)
    data = data._replace(weights=weights, squeeze=jnp.where(adjustable, 0, data.squeeze))
    data, scaling = scale_in_principal_axes(data)
    problem = UnitWeightProblem(data, _whitened_axes(data, scaling), scaling, valid & scaling.sound)
    return with_wrench(problem, dual.residual(dual.plain_problem(data), squeezing_forces(data)))


def _whitened_axes(data: ContactData, scaling: Scaling) -> ScaledAxes:
    """Return coordinates in which G G^T is the identity, but for axes about which no contact has a lever.

    Without them what is missed of a small torque about a line near all contacts passes for rounding of the wrench,
    though only enormous forces balance it. Axes without a lever stay as they are: what is asked about them is missed.
    """
    scales = whitening_scales(inertia(data), scaling)
    return ScaledAxes(Vec3(*(jnp.where(s > 0, s, 1) for s in scales)))


def with_wrench(problem: UnitWeightProblem, wrench: SpatialVec) -> UnitWeightProblem:
    """Return the problems under another wrench, in their axes and units, without squeeze."""
    force, torque = spatial.parts(wrench)
    data = problem.data
    return problem._replace(data=data._replace(squeeze=0 * data.squeeze, force=force, torque=torque))


def boundary_point(
    unit_weight: UnitWeightProblem, last: ContactData, previous: ContactData, path: reach.PenaltyPath, size: Array
) -> BoundaryPoint:
    """Return the end of a path of multipliers in the user's axes and units; ``size`` is that of a unit of its answer.

    ``last`` and ``previous`` are the problems at the path's last two penalties. The result is extrapolated from these
    two, since its error falls with the penalty.
    """
    share = vec3.safe_divide(path.penalty_before, path.penalty - path.penalty_before)
    last_values, previous_values = (
        _supporting_twist(unit_weight._replace(data=last), path.point, path.penalty),
        _supporting_twist(unit_weight._replace(data=previous), path.point_before, path.penalty_before),
    )
    normal = last_values.normal + share * (last_values.normal - previous_values.normal)
    normal_force = last_values.normal_force + share * (last_values.normal_force - previous_values.normal_force)
    friction_use = contact_vec.add(
        last_values.friction_use,
        contact_vec.scale(share, contact_vec.sub(last_values.friction_use, previous_values.friction_use)),
    )
    scaling, batch_ones = unit_weight.scaling, jnp.ones_like(size)
    assert scaling.axes is not None
    linear, angular = unit_weight.coordinates.twist(vec3.safe_divide(normal, size))
    linear = vec3.rotate_back(scaling.axes, linear)
    angular = vec3.rotate_back(scaling.axes, vec3.scale(1 / scaling.length, angular))
    return BoundaryPoint(
        centre=jnp.concatenate([c * batch_ones for c in scaling.centre]).T,
        normal=spatial.join(linear, angular).T,
        normal_force=(scaling.force_unit * normal_force * batch_ones).T,
        friction_use=jnp.stack([c * batch_ones for c in vec3.rotate_back(scaling.axes, friction_use.linear)]).transpose(
            2, 1, 0
        ),
        spin_use=None if friction_use.spin is None else (friction_use.spin * batch_ones).T,
    )


def _supporting_twist(problem: UnitWeightProblem, point: SpatialVec, penalty: Array) -> _SupportingTwist:
    data, best = problem.data, dual.candidate_forces(problem, point)
    split = best.split
    used = jnp.where(split.inside, vec3.safe_divide(split.size, data.friction * split.along), 1)
    normal_force = vec3.dot(best.forces.linear, data.normals)
    return _SupportingTwist(vec3.safe_divide(point, penalty), normal_force, contact_vec.scale(used, split.tangent))


def work_along(problem: ProblemBatch, wrench: Array, boundary: BoundaryPoint) -> Array:
    """normal.(G f - wrench) of each problem ``(B,)``, the tangential forces turning with the cones.

    It is zero at the limit; its derivative by the problem and the wrench ``(B, 6)`` is how the answer moves.
    """
    data, _ = to_batch_last(problem)
    centre, friction_use = (Vec3(*jnp.moveaxis(a, -1, 0)) for a in (boundary.centre, boundary.friction_use))
    centre, friction_use = Vec3(*(c[None] for c in centre)), Vec3(*(c.T for c in friction_use))
    linear, angular = spatial.parts(boundary.normal.T)
    velocity = vec3.add(linear, vec3.cross(angular, vec3.sub(data.points, centre)))
    along = vec3.dot(velocity, data.normals)
    across = vec3.sub(velocity, vec3.scale(along, data.normals))
    slide = vec3.dot(friction_use, across)
    if data.spin_radius is not None and boundary.spin_use is not None:
        slide = slide + boundary.spin_use.T * data.spin_radius * vec3.dot(angular, data.normals)
    adjustable = data.weights > 0
    normal_force = jnp.where(adjustable, boundary.normal_force.T, data.squeeze)
    push = along + jnp.where(adjustable, data.friction * slide, 0)
    force, torque = spatial.parts(wrench.T)
    work = vec3.dot(linear, force) + vec3.dot(angular, vec3.sub(torque, vec3.cross(centre, force)))
    return (jnp.sum(normal_force * push, 0, keepdims=True) - work)[0]
