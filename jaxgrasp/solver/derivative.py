"""Derivatives of a solved problem, from its stationarity condition alone.

At a solution w - G f(multiplier, data) = 0. Differentiating that gives a 6x6 system for the multiplier's
tangent, whatever route the solver took. The rule is plain JAX, so it can be transposed and differentiated
again; the scaling enters as a constant, since the answer does not depend on it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Solution, Verdict, is_balanced
from jaxgrasp.numerics import ldl, pivoted_ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import computed_once
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, squeezing_forces, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.coordinates import Coordinates, ScaledAxes, whitened_metric
from jaxgrasp.problem.guided_motion import Mixing, directions_to_scaled, guided_coordinates, mixing
from jaxgrasp.problem.scaling import (
    Scaling,
    forces_from_scaled,
    moments_from_scaled,
    multiplier_from_scaled,
    multiplier_to_scaled,
    rotate,
    scale_in_principal_axes,
    with_scaling,
)
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual, pseudo_inverse, torque_limits
from jaxgrasp.solver.torque_limits import TorqueConstraints


class _Moving(NamedTuple):
    """Quantities that move with the problem, in a constant scaling."""

    data: ContactData
    directions: Array | None
    """``(B, 6, k)``: the twists that a guide allows."""
    constraints: TorqueConstraints | None
    """Limits of joint torques; None where there are none, or the method does not know them."""


class _Fixed(NamedTuple):
    """Constants: quantities on which the answer does not depend."""

    scaling: Scaling
    whitened: ScaledAxes | Mixing
    """The coordinates of a free object; how they come out of the free twists of one that a guide holds."""
    constraints: Array | None
    """Lengths of the torque constraints."""

    def problem(self, moving: _Moving) -> "_DualProblem":
        if isinstance(self.whitened, ScaledAxes):
            return _DualProblem(moving.data, self.whitened, moving.constraints)
        assert moving.directions is not None
        return _DualProblem(moving.data, guided_coordinates(moving.directions, self.whitened), moving.constraints)


class _DualProblem(NamedTuple):
    """Data and coordinates from which the optimality conditions are computed."""

    data: ContactData
    coordinates: Coordinates
    constraints: TorqueConstraints | None

    def velocities(self, point: Array) -> ContactVec:
        """Velocities of the contacts by the object, less those by the joints."""
        velocity = dual.contact_velocities(self, point[:6])
        if self.constraints is None:
            return velocity
        return contact_vec.sub(velocity, torque_limits.velocities_by_joints(self.constraints, point[6:]))


class Tangent(NamedTuple):
    """Tangents of the differentiable fields of a Solution."""

    forces: Array
    multiplier: Array
    objective: Array
    moments: Array | None
    normal_multiplier: Array | None
    torque_multiplier: Array | None
    undefined: Array
    """``(B,)``: where there is none; the others are zero there."""


class _Outputs(NamedTuple):
    """Differentiated outputs, in the problems' coordinates."""

    forces: ContactVec
    moments: Array | None
    objective: Array
    twist: tuple[Vec3, Vec3]
    normal_multipliers: Array | None
    torque_multipliers: Array | None


def tangent(problem: ProblemBatch, moved: ProblemBatch, solution: Solution, constrained: bool) -> Tangent:
    """Compute the tangents of forces, multipliers and objective for the problem's tangent ``moved``.

    By the implicit function theorem: the optimality residual F(x, problem) = 0 moves by F_x dx + F_p dp = 0. On
    rank-deficient grasps, within the range. Where no contact can carry a force the tangent is zero; it is undefined
    where there is no answer, and for allowed forces that are not those of their multiplier, so not the optimum's.
    """
    fixed = _constants(problem, constrained)
    scaling = fixed.scaling
    moving, moving_tangent = jax.jvp(lambda p: _in_scaling(p, fixed), (problem,), (moved,))
    balanced = is_balanced(solution.verdict)[None, :]
    multipliers = computed_once(jnp.where(balanced, _multipliers(solution, scaling, fixed.problem(moving)), 0))
    unit = scaling.weight_sum / scaling.force_unit

    def residual(moving: _Moving) -> Array:
        problem = fixed.problem(moving)
        return _optimality_residual(problem, multipliers, _forces(problem, multipliers, unit, constrained)[0])

    _, unbalanced = jax.jvp(residual, (moving,), (moving_tangent,))
    curvature = computed_once(_negative_hessian(fixed.problem(moving), multipliers, constrained))
    multipliers_moved = computed_once(_solve(curvature, computed_once(unbalanced)))

    def outputs(moving: _Moving, multipliers: Array) -> _Outputs:
        problem, data = fixed.problem(moving), moving.data
        forces, deviation = _forces(problem, multipliers, unit, constrained)
        bounded = data.normal_min is not None or data.normal_max is not None
        return _Outputs(
            forces=forces,
            moments=moments_from_scaled(data, forces.spin, scaling),
            objective=vec3.totals(dual.deviation_cost_by(data, forces, deviation))[0],
            twist=problem.coordinates.twist(multipliers[:6]),
            normal_multipliers=dual.normal_multipliers(data, problem.velocities(multipliers)) if bounded else None,
            torque_multipliers=None if moving.constraints is None else moving.constraints.scale * multipliers[6:],
        )

    values, tangents = computed_once(jax.jvp(outputs, (moving, multipliers), (moving_tangent, multipliers_moved)))
    by_multiplier = forces_from_scaled(lax.stop_gradient(values.forces.linear), scaling)
    optimal = (solution.verdict != Verdict.FEASIBLE) | _agree(by_multiplier, solution.forces)
    has_answer = computed_once(balanced & optimal[None])
    return _to_solution(scaling, has_answer, has_answer[0] | (solution.verdict == Verdict.NO_CONTACTS), tangents)


def _agree(forces: Vec3, reference: Array) -> Array:
    """Return whether forces ``(n, B)`` equal the solution's ``(B, n, 3)``, but for rounding of large multipliers."""
    reference = lax.stop_gradient(reference).transpose(2, 1, 0)
    difference = jnp.abs(jnp.stack(forces) - reference)
    return jnp.max(difference, (0, 1)) <= float(jnp.finfo(reference.dtype).eps) ** 0.4 * jnp.max(
        jnp.abs(reference), (0, 1)
    )


def _multipliers(solution: Solution, scaling: Scaling, problem: _DualProblem) -> Array:
    """Return the solution's multiplier in the coordinates, above those of the torque constraints."""
    point = problem.coordinates.from_twist(*multiplier_to_scaled(solution.multiplier, scaling))
    if problem.constraints is None or solution.torque_multiplier is None:
        return point
    unit = scaling.weight_sum / scaling.force_unit
    return jnp.concatenate([point, unit * vec3.safe_divide(solution.torque_multiplier.T, problem.constraints.scale)])


def _optimality_residual(problem: _DualProblem, point: Array, forces: ContactVec) -> Array:
    """Return the residual that is zero at a solution: w - G f, and below it torque less limit where a limit binds."""
    wrench, constraints = dual.residual(problem, forces), problem.constraints
    if constraints is None:
        return wrench
    side = jnp.sign(point[6:])
    beyond = jnp.abs(side) * torque_limits.torques(constraints, forces) - side * constraints.bound
    return jnp.concatenate([wrench, beyond])


def _forces(problem: _DualProblem, point: Array, unit: Array, constrained: bool) -> tuple[ContactVec, ContactVec]:
    """Return the forces of multipliers, and the deviation (f - s a) / k of each contact."""
    data = problem.data
    if not constrained:
        return pseudo_inverse.forces_without_cones(problem, point), dual.contact_velocities(problem, point)
    best = dual.candidate_forces_at(data, problem.velocities(point))
    forces = contact_vec.where(_is_fixed_at_zero(data), _about_apex(data, best.velocity, unit), best.forces)
    return computed_once(forces), computed_once(dual.weighted_deviation(data, best, unit))


def _is_fixed_at_zero(data: ContactData) -> Array:
    """Contacts of zero squeeze and zero weight: their force is fixed at zero, the apex of the cone."""
    return (data.squeeze == 0) & (data.weights == 0)


def _about_apex(data: ContactData, velocity: ContactVec, unit: Array) -> ContactVec:
    """s a + k v on its cone, for s and k about 0, linearised where both are equal: as method B moves them."""
    target = lax.stop_gradient(dual.relaxed_target(data, velocity, unit))
    split = computed_once(friction_cone.decompose(target, data.cone))
    side = lax.stop_gradient(computed_once(friction_cone.derivative(data.cone, split)))
    target = computed_once(contact_vec.add(squeezing_forces(data), contact_vec.scale(data.weights, velocity)))
    return contact_vec.of_components(ldl.multiply(side, contact_vec.components(target)))


def _constants(problem: ProblemBatch, constrained: bool) -> _Fixed:
    """Principal axes, coordinates and lengths of the constraints of a problem."""
    problem = lax.stop_gradient(problem)
    data, _ = to_batch_last(problem)
    data, scaling = scale_in_principal_axes(data)
    limited = constrained and problem.torque_bounds is not None
    constraints = torque_limits.torque_constraints(problem, data, scaling).scale if limited else None
    if problem.free is None:
        return _Fixed(scaling, whitened_metric(data, scaling)[1], constraints)
    return _Fixed(scaling, mixing(directions_to_scaled(problem.free, scaling), data, scaling), constraints)


def _in_scaling(problem: ProblemBatch, fixed: _Fixed) -> _Moving:
    """Return the problem in a constant scaling; no derivative reaches an absent contact."""
    data, _ = computed_once(to_batch_last(problem))
    scaling = fixed.scaling
    weight = jnp.where(scaling.weight_sum > 0, scaling.weight_sum, 1)
    moved = vec3.sub(data.torque, vec3.cross(scaling.centre, data.force))
    scaled = with_scaling(data, scaling, vec3.sub(data.points, scaling.centre), data.weights / weight, moved)
    assert scaling.axes is not None
    scaled = computed_once(rotate(scaled, scaling.axes))
    free = None if problem.free is None else directions_to_scaled(problem.free, scaling)
    constraints = None
    if fixed.constraints is not None:
        constraints = torque_limits.torque_constraints_scaled_by(fixed.constraints, problem, scaled, scaling)
    return _Moving(scaled, free, constraints)


def _negative_hessian(problem: _DualProblem, point: Array, constrained: bool) -> Array:
    """Minus the Hessian by the coordinates and by the limits that bind, ``(k, k, B)``."""
    data = problem.data
    if not constrained:
        unit, zero = jnp.ones_like(data.weights), jnp.zeros_like(data.weights)
        size = 3 if data.spin_radius is None else 4
        return _full(dual.negative_hessian(problem, [[zero] * i + [unit] for i in range(size)]))
    best = dual.candidate_forces_at(data, problem.velocities(point))
    plain = dual.negative_hessian(problem, computed_once(friction_cone.derivative(data.cone, best.split)))
    if problem.constraints is None:
        return _full(plain)
    binds = (point[6:] != 0).astype(point.dtype)
    return torque_limits.full_matrix(torque_limits.bordered_hessian(problem, problem.constraints, best, plain), binds)


def _full(lower: ldl.Lower) -> Array:
    size = range(len(lower))
    return jnp.stack([jnp.stack([lower[max(i, j)][min(i, j)][0] for j in size]) for i in size])


def _solve(curvature: Array, right: Array) -> Array:
    """x with H x = right, where H may be singular: then some x that fits, since the forces do not see the rest.

    What no x fits is left alone: there the forces that are active cannot follow the data.
    """
    factors = pivoted_ldl.factor(curvature, tolerances(right.dtype).singular)
    x = pivoted_ldl.solve(factors, right)
    # Ill-conditioned, it gets its last digits from what it leaves.
    return x + pivoted_ldl.solve(factors, right - jnp.sum(curvature * x[None], 1))


def _to_solution(scaling: Scaling, has_answer: Array, defined: Array, outputs: _Outputs) -> Tangent:
    unit = computed_once(vec3.safe_divide(scaling.force_unit, scaling.weight_sum))
    linear, angular = multiplier_from_scaled(*outputs.twist, scaling)

    def batch_first(array: Array | None, factor: Array | float = 1) -> Array | None:
        return None if array is None else jnp.where(has_answer, factor * array, 0).T

    forces = forces_from_scaled(outputs.forces.linear, scaling)
    return Tangent(
        forces=jnp.stack([jnp.where(has_answer, c, 0) for c in forces]).transpose(2, 1, 0),
        multiplier=jnp.concatenate([jnp.where(has_answer, c, 0) for c in (*linear, *angular)]).T,
        objective=jnp.where(has_answer, unit * scaling.force_unit * outputs.objective, 0)[0],
        moments=batch_first(outputs.moments),
        normal_multiplier=batch_first(outputs.normal_multipliers, unit),
        torque_multiplier=batch_first(outputs.torque_multipliers, unit),
        undefined=~defined,
    )
