"""The dual of the force distribution problem: six unknowns, whatever the number of contacts.

For a multiplier (a virtual twist) the candidate force of each contact, which minimises the Lagrangian, is a
projection on its cone,

    f_i = P_i(s_i a_i + k_i (linear + angular x r_i)),

of soft fingers in four components (``problem/contact_vec.py``), and the dual value is concave, once continuously
differentiable, with gradient w - G f. Everything here is in the coordinates of ``scaling.py``; ``coordinates.py`` says
what the six numbers of a multiplier stand for there.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import computed_once
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import ContactData, squeezing_forces
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.coordinates import Coordinates, plain_axes
from jaxgrasp.problem.spatial import SpatialVec, inner


@runtime_checkable
class DualProblem(Protocol):
    """Data and coordinates of which the dual is computed, as ``ScaledProblem`` and ``PlainProblem`` have them."""

    @property
    def data(self) -> ContactData: ...

    @property
    def coordinates(self) -> Coordinates: ...


class PlainProblem(NamedTuple):
    """The data of problems, and coordinates of their multipliers, without a scaling."""

    data: ContactData
    coordinates: Coordinates


def plain_problem(data: ContactData) -> PlainProblem:
    """Return the problem in the user's coordinates."""
    return PlainProblem(data, plain_axes(data.force.x))


def required_wrench(problem: DualProblem) -> SpatialVec:
    """Return the required wrench w in the problem's coordinates."""
    return problem.coordinates.wrench(problem.data.force, problem.data.torque)


def solve(factors: tuple[list[list[Array]], list[Array]], right: SpatialVec) -> SpatialVec:
    """Solve A x = right from the factors of A."""
    return jnp.concatenate(ldl.solve(factors, [right[i : i + 1] for i in range(6)]))


class CandidateForces(NamedTuple):
    """Forces that minimise the Lagrangian for a multiplier, with their contact velocities and cone regions."""

    velocity: ContactVec
    """The multiplier's velocity at each contact, less the cost along its normal."""
    split: friction_cone.ConeDecomposition
    forces: ContactVec


class DualEvaluation(NamedTuple):
    """The dual at a point: value, gradient and minus Hessian."""

    value: Array
    gradient: SpatialVec
    curvature: Lower
    total_normal_force: Array
    """Sum of the normal forces: how large the numbers are that the gradient is a difference of."""


def contact_velocities(problem: DualProblem, multiplier: SpatialVec) -> ContactVec:
    """Velocity of the multiplier, as a twist, at each contact."""
    data = problem.data
    linear, angular = problem.coordinates.twist(multiplier)
    spin = None if data.spin_radius is None else data.spin_radius * vec3.dot(angular, data.normals)
    # G_i^T x = v + omega x r_i; a soft finger's spin is gamma omega.a_i.
    return ContactVec(vec3.add(linear, vec3.cross(angular, data.points)), spin)


def candidate_forces(problem: DualProblem, multiplier: SpatialVec) -> CandidateForces:
    """Compute the forces that minimise the Lagrangian for a multiplier: f_i = P_i(s_i a_i + k_i G_i^T x)."""
    return candidate_forces_at(problem.data, contact_velocities(problem, multiplier))


def target_forces(data: ContactData, velocity: ContactVec) -> ContactVec:
    """Return s a + k v for contact velocities v, whose projections on the cones are the candidate forces."""
    return _target(data, _less_cost(data, velocity))


def _target(data: ContactData, velocity: ContactVec) -> ContactVec:
    # s a + k G^T x
    return contact_vec.add(squeezing_forces(data), contact_vec.scale(data.weights, velocity))


def _less_cost(data: ContactData, velocity: ContactVec) -> ContactVec:
    """Subtract the cost of a unit of normal force from the velocities, along the normals."""
    if data.normal_cost is None:
        return velocity
    return velocity._replace(linear=vec3.sub(velocity.linear, vec3.scale(data.normal_cost, data.normals)))


def candidate_forces_at(data: ContactData, velocity: ContactVec) -> CandidateForces:
    """Compute the candidate forces from velocities of the contacts."""
    velocity = computed_once(_less_cost(data, velocity))
    target = computed_once(_target(data, velocity))
    split = computed_once(friction_cone.decompose(target, data.cone))
    return CandidateForces(velocity, split, computed_once(friction_cone.project(target, data.cone, split)))


def residual(problem: DualProblem, forces: ContactVec) -> SpatialVec:
    """Return w - G f."""
    return _unbalanced(problem, vec3.totals(*wrench_terms(problem.data, forces)))


def wrench_terms(data: ContactData, forces: ContactVec) -> tuple[Array, ...]:
    """Return each contact's part of the wrench: force f_i, then torque r_i x f_i."""
    torque = vec3.cross(data.points, forces.linear)
    if forces.spin is not None and data.spin_radius is not None:
        torque = vec3.add(torque, vec3.scale(data.spin_radius * forces.spin, data.normals))
    return (*forces.linear, *torque)


def _unbalanced(problem: DualProblem, wrench: list[Array]) -> SpatialVec:
    data = problem.data
    # The dual's gradient w - G f.
    linear, angular = vec3.sub(data.force, Vec3(*wrench[:3])), vec3.sub(data.torque, Vec3(*wrench[3:]))
    return problem.coordinates.wrench(linear, angular)


def evaluate(problem: DualProblem, multiplier: SpatialVec) -> DualEvaluation:
    """Return value, gradient ``(6, B)`` and minus Hessian of the dual at a multiplier ``(6, B)``."""
    return evaluate_at(problem, candidate_forces(problem, multiplier), multiplier)


def evaluate_at(problem: DualProblem, best: CandidateForces, multiplier: SpatialVec) -> DualEvaluation:
    """Return the dual at a multiplier whose forces are known."""
    data = problem.data
    jacobian = computed_once(friction_cone.derivative(data.cone, best.split))
    sums = vec3.totals(*_value_terms(data, best)) + vec3.stacked_totals(*_hessian_terms(data, jacobian))
    value, gradient, total_normal_force = _value(problem, multiplier, sums[:VALUE_TERMS])
    # -H = sum of k_i G_i D_i G_i^T
    curvature = _hessian_of(sums[VALUE_TERMS:], problem.coordinates)
    return DualEvaluation(value, gradient, curvature, total_normal_force)


def normal_multipliers(data: ContactData, velocity: ContactVec) -> Array:
    """Multipliers of the bounds of the normal forces: positive at upper ones, negative at lower ones, zero elsewhere.

    Target less projection is k times a normal of what is allowed: the bound's own, and on a disc's rim the cone's.
    """
    split = candidate_forces_at(data, velocity).split
    if split.bound is None:
        return jnp.zeros_like(split.along)
    active, normal_force = split.bound
    beyond = jnp.maximum(split.size - data.friction * normal_force, 0)
    price = split.along - normal_force + data.friction * beyond
    return jnp.where(active, vec3.safe_divide(price, data.weights), 0)


def dual_value(problem: DualProblem, best: CandidateForces, multiplier: SpatialVec) -> Array:
    """Return the dual at a multiplier whose forces are known."""
    return _value(problem, multiplier, vec3.totals(*_value_terms(problem.data, best)))[0]


def total_normal_force(data: ContactData, forces: ContactVec) -> Array:
    """Sum the normal forces."""
    return vec3.totals(vec3.dot(forces.linear, data.normals))[0]


VALUE_TERMS = 8


def _value_terms(data: ContactData, best: CandidateForces) -> tuple[Array, ...]:
    # w.x + sum of |f - s a|^2 / 2k - v.f, written so that small weights cancel nothing.
    cost = deviation_cost(data, best.forces) - contact_vec.dot(best.velocity, best.forces)
    return cost, vec3.dot(best.forces.linear, data.normals), *wrench_terms(data, best.forces)


def _value(problem: DualProblem, multiplier: SpatialVec, sums: list[Array]) -> tuple[Array, SpatialVec, Array]:
    cost, total_normal_force, *wrench = sums
    value = inner(required_wrench(problem), multiplier) + cost
    return value, _unbalanced(problem, wrench), total_normal_force


def deviation_cost(data: ContactData, forces: ContactVec) -> Array:
    """|f - s a|^2 / 2k of each contact; 0 where k is 0."""
    deviation = contact_vec.sub(forces, squeezing_forces(data))
    return vec3.safe_divide(contact_vec.dot(deviation, deviation), 2 * data.weights)


def weighted_deviation(data: ContactData, best: CandidateForces, unit: Array) -> ContactVec:
    """(f - s a) / k of each contact, and its limit as k falls to 0, together with the squeeze where that is 0 too.

    ``unit`` is what one unit of weight means in squeeze where both are the same number to the user.
    """
    moves = data.weights > 0
    weighted = contact_vec.scale(
        1 / jnp.where(moves, data.weights, 1), contact_vec.sub(best.forces, squeezing_forces(data))
    )
    along = contact_vec.along(vec3.dot(best.velocity.linear, data.normals), data.normals, best.velocity)
    at_zero_weight = contact_vec.where(data.friction > 0, best.velocity, along)
    # At s = k = 0 the force is k times a projection.
    target = computed_once(relaxed_target(data, best.velocity, unit))
    offset = contact_vec.along(unit, data.normals, best.velocity)
    split = computed_once(friction_cone.decompose(target, data.cone))
    relaxed = computed_once(contact_vec.sub(friction_cone.project(target, data.cone, split), offset))
    return contact_vec.where(moves, weighted, contact_vec.where(data.squeeze > 0, at_zero_weight, relaxed))


def relaxed_target(data: ContactData, velocity: ContactVec, unit: Array) -> ContactVec:
    """s a + k v where s and k grow from 0 together, as by method B; for each unit of weight."""
    return contact_vec.add(contact_vec.along(unit, data.normals, velocity), velocity)


def deviation_cost_by(data: ContactData, forces: ContactVec, deviation: ContactVec) -> Array:
    """``deviation_cost``, with the derivative by k that it has at k = 0 too, from above.

    It is stationary in ``deviation``, so that only forces, squeeze and weights move it.
    """
    difference = contact_vec.sub(forces, squeezing_forces(data))
    return contact_vec.dot(deviation, difference) - data.weights * contact_vec.dot(deviation, deviation) / 2


def objective_of_no_force(data: ContactData) -> Array:
    """Return the objective of zero forces, against which gaps are measured where the optimum's own is small."""
    held = squeezing_forces(data)
    return vec3.totals(deviation_cost(data, contact_vec.sub(held, held)))[0]


def gap_scale(data: ContactData, objective: Array) -> Array:
    """Return the scale of a duality gap: |objective|, or the objective of zero forces where that is larger."""
    return jnp.maximum(jnp.abs(objective), objective_of_no_force(data))


def negative_hessian(problem: DualProblem, jacobian: Lower) -> Lower:
    """Sum of k G D G^T over contacts, for a symmetric matrix D of each, 3x3 or 4x4: lower triangle, 6x6."""
    return _hessian_of(vec3.stacked_totals(*_hessian_terms(problem.data, jacobian)), problem.coordinates)


def force_change(data: ContactData, best: CandidateForces, velocity: ContactVec) -> ContactVec:
    """Return the change of the candidate forces with velocities of the contacts, k D v."""
    jacobian = friction_cone.derivative(data.cone, best.split)
    moved = contact_vec.of_components(ldl.multiply(jacobian, contact_vec.components(velocity)))
    return contact_vec.scale(data.weights, moved)


def _hessian_terms(data: ContactData, jacobian: Lower) -> list[Array]:
    k, r = data.weights, data.points
    d = [[k * jacobian[max(i, j)][min(i, j)] for j in range(3)] for i in range(3)]
    columns = [vec3.cross(r, Vec3(d[0][j], d[1][j], d[2][j])) for j in range(3)]  # [r]x D, column by column
    mixed = [Vec3(columns[0][i], columns[1][i], columns[2][i]) for i in range(3)]  # its rows
    spin_rows = None
    if data.spin_radius is not None:
        mixed, spin_rows = _with_spin(data, vec3.scale(data.spin_radius, data.normals), jacobian[3], mixed)
    angular = [vec3.cross(r, row) for row in mixed]  # rows of [r]x D [r]x^T
    if spin_rows is not None:
        angular = [vec3.add(row, spin_row) for row, spin_row in zip(angular, spin_rows, strict=True)]
    terms = [d[i][j] for i in range(3) for j in range(i + 1)]
    terms += [mixed[i][j] for i in range(3) for j in range(3)]
    terms += [angular[i][j] for i in range(3) for j in range(i + 1)]
    return terms


def _with_spin(data: ContactData, a: Vec3, last: Sequence[Array], mixed: list[Vec3]) -> tuple[list[Vec3], list[Vec3]]:
    """Add moments about the normals: ``a`` are the normals times the spin radii, (c, d) the last row of k D.

    The block of torques by forces gains a c^T, that of torques by torques a (r x c)^T and what follows from it.
    """
    *row, diagonal = [data.weights * entry for entry in last]
    c = Vec3(*row)
    turned = vec3.add(vec3.cross(data.points, c), vec3.scale(diagonal, a))
    mixed = [vec3.add(m, vec3.scale(part, c)) for m, part in zip(mixed, a, strict=True)]
    return mixed, [vec3.scale(part, a) for part in turned]


def _hessian_of(sums: list[Array], coordinates: Coordinates) -> Lower:
    entry = iter(sums)
    linear_rows = [[next(entry) for _ in range(i + 1)] for i in range(3)]
    mixed_rows = [[next(entry) for _ in range(3)] for i in range(3)]
    angular_rows = [[next(entry) for j in range(i + 1)] for i in range(3)]
    return coordinates.curvature(linear_rows + [m + a for m, a in zip(mixed_rows, angular_rows, strict=True)])
