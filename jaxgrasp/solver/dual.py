"""The dual of the force distribution problem: six unknowns, whatever the number of contacts.

For a multiplier (a virtual twist) the best force of each contact is a projection on its cone,

    f_i = P_i(s_i a_i + k_i (linear + angular x r_i)),

of soft fingers in four components (``contact_vec.py``), and the dual value is concave, once continuously
differentiable, with gradient w - G f. Everything here is in the coordinates of ``scaling.py``; ``coordinates.py`` says
what the six numbers of a multiplier stand for there.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import ContactData, squeezing_forces
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.spatial import SpatialVec, inner
from jaxgrasp.solver.coordinates import Coordinates


def required_wrench(lanes: ContactData, unknowns: Coordinates) -> SpatialVec:
    """The wrench asked for."""
    return unknowns.wrench(lanes.force, lanes.torque)


def solve(factors: tuple[list[list[Array]], list[Array]], right: SpatialVec) -> SpatialVec:
    """x with A x = right, from the factors of A."""
    return jnp.concatenate(ldl.solve(factors, [right[i : i + 1] for i in range(6)]))


class CandidateForces(NamedTuple):
    """The best forces for a multiplier, and what they came from."""

    twist: ContactVec
    """The multiplier's velocity at each contact, less the toll along its normal."""
    sides: friction_cone.ConeSide
    forces: ContactVec


class DualEvaluation(NamedTuple):
    """The dual at a point: value, gradient and minus Hessian."""

    value: Array
    gradient: SpatialVec
    curvature: Lower
    push: Array
    """Sum of the normal forces: how large the numbers are that the gradient is a difference of."""


def contact_velocities(lanes: ContactData, multiplier: SpatialVec, unknowns: Coordinates) -> ContactVec:
    """Velocity of the multiplier, as a twist, at each contact."""
    linear, angular = unknowns.twist(multiplier)
    spin = None if lanes.lever is None else lanes.lever * vec3.dot(angular, lanes.normals)
    return ContactVec(vec3.add(linear, vec3.cross(angular, lanes.arms)), spin)


def candidate_forces(lanes: ContactData, multiplier: SpatialVec, unknowns: Coordinates) -> CandidateForces:
    return candidate_forces_at(lanes, contact_velocities(lanes, multiplier, unknowns))


def candidate_forces_at(lanes: ContactData, twist: ContactVec) -> CandidateForces:
    """The best forces for velocities of the contacts, wherever these come from."""
    if lanes.toll is not None:
        twist = twist._replace(linear=vec3.sub(twist.linear, vec3.scale(lanes.toll, lanes.normals)))
    target = contact_vec.add(squeezing_forces(lanes), contact_vec.scale(lanes.weights, twist))
    sides = friction_cone.cone_side(target, lanes.cone)
    return CandidateForces(twist, sides, friction_cone.project(target, lanes.cone, sides))


def residual(lanes: ContactData, forces: ContactVec, unknowns: Coordinates) -> SpatialVec:
    """w - G f."""
    return _unbalanced(lanes, unknowns, vec3.totals(*wrench_terms(lanes, forces)))


def wrench_terms(lanes: ContactData, forces: ContactVec) -> tuple[Array, ...]:
    """What each contact adds to the wrench: force, then torque."""
    torque = vec3.cross(lanes.arms, forces.linear)
    if forces.spin is not None and lanes.lever is not None:
        torque = vec3.add(torque, vec3.scale(lanes.lever * forces.spin, lanes.normals))
    return (*forces.linear, *torque)


def _unbalanced(lanes: ContactData, unknowns: Coordinates, wrench: list[Array]) -> SpatialVec:
    linear, angular = vec3.sub(lanes.force, Vec3(*wrench[:3])), vec3.sub(lanes.torque, Vec3(*wrench[3:]))
    return unknowns.wrench(linear, angular)


def evaluate(lanes: ContactData, multiplier: SpatialVec, unknowns: Coordinates) -> DualEvaluation:
    return evaluate_at(lanes, candidate_forces(lanes, multiplier, unknowns), multiplier, unknowns)


def evaluate_at(
    lanes: ContactData, best: CandidateForces, multiplier: SpatialVec, unknowns: Coordinates
) -> DualEvaluation:
    """The dual at a multiplier whose best forces are known."""
    jacobian = friction_cone.derivative(lanes.cone, best.sides)
    sums = vec3.totals(*_value_terms(lanes, best)) + vec3.stacked_totals(*_hessian_terms(lanes, jacobian))
    value, gradient, push = _value(lanes, multiplier, unknowns, sums[:VALUE_TERMS])
    return DualEvaluation(value, gradient, _hessian_of(sums[VALUE_TERMS:], unknowns), push)


def normal_multipliers(lanes: ContactData, twist: ContactVec) -> Array:
    """Multipliers of the bounds of the normal forces: positive at upper ones, negative at lower ones, zero elsewhere.

    Target less projection is k times a normal of what is allowed: the bound's own, and on a disc's rim the cone's.
    """
    sides = candidate_forces_at(lanes, twist).sides
    if sides.bound is None:
        return jnp.zeros_like(sides.along)
    holds, height = sides.bound
    beyond = jnp.maximum(sides.size - lanes.friction * height, 0)
    price = sides.along - height + lanes.friction * beyond
    return jnp.where(holds, vec3.safe_divide(price, lanes.weights), 0)


def dual_value(lanes: ContactData, best: CandidateForces, multiplier: SpatialVec, unknowns: Coordinates) -> Array:
    """The dual at a multiplier whose best forces are known."""
    return _value(lanes, multiplier, unknowns, vec3.totals(*_value_terms(lanes, best)))[0]


def total_normal_force(lanes: ContactData, forces: ContactVec) -> Array:
    """Sum of the normal forces."""
    return vec3.totals(vec3.dot(forces.linear, lanes.normals))[0]


VALUE_TERMS = 8


def _value_terms(lanes: ContactData, best: CandidateForces) -> tuple[Array, ...]:
    # w.x + sum of |f - s a|^2 / 2k - v.f, written so that small weights cancel nothing.
    own = deviation_cost(lanes, best.forces) - contact_vec.dot(best.twist, best.forces)
    return own, vec3.dot(best.forces.linear, lanes.normals), *wrench_terms(lanes, best.forces)


def _value(
    lanes: ContactData, multiplier: SpatialVec, unknowns: Coordinates, sums: list[Array]
) -> tuple[Array, SpatialVec, Array]:
    own, push, *wrench = sums
    return inner(required_wrench(lanes, unknowns), multiplier) + own, _unbalanced(lanes, unknowns, wrench), push


def deviation_cost(lanes: ContactData, forces: ContactVec) -> Array:
    """|f - s a|^2 / 2k of each contact; 0 where k is 0."""
    apart = contact_vec.sub(forces, squeezing_forces(lanes))
    return vec3.safe_divide(contact_vec.dot(apart, apart), 2 * lanes.weights)


def weighted_deviation(lanes: ContactData, best: CandidateForces, unit: Array) -> ContactVec:
    """(f - s a) / k of each contact, and what it tends to as k falls to 0; the squeeze with it, where that is 0 too.

    ``unit`` is what one unit of weight means in squeeze where both are the same number to the user.
    """
    moves = lanes.weights > 0
    apart = contact_vec.scale(
        1 / jnp.where(moves, lanes.weights, 1), contact_vec.sub(best.forces, squeezing_forces(lanes))
    )
    along = contact_vec.along(vec3.dot(best.twist.linear, lanes.normals), lanes.normals, best.twist)
    still = contact_vec.where(lanes.friction > 0, best.twist, along)
    # At s = k = 0 the force is k times a projection.
    target, own = relaxed_target(lanes, best.twist, unit), contact_vec.along(unit, lanes.normals, best.twist)
    sides = friction_cone.cone_side(target, lanes.cone)
    relaxed = contact_vec.sub(friction_cone.project(target, lanes.cone, sides), own)
    return contact_vec.where(moves, apart, contact_vec.where(lanes.squeeze > 0, still, relaxed))


def relaxed_target(lanes: ContactData, twist: ContactVec, unit: Array) -> ContactVec:
    """s a + k v where s and k grow from 0 together, as by method B; for each unit of weight."""
    return contact_vec.add(contact_vec.along(unit, lanes.normals, twist), twist)


def deviation_cost_by(lanes: ContactData, forces: ContactVec, pull: ContactVec) -> Array:
    """The same as ``spread`` in value, with the derivative by k that it has at k = 0 too, from above.

    Stationary in ``pull``, so that only forces, squeeze and weights move it.
    """
    apart = contact_vec.sub(forces, squeezing_forces(lanes))
    return contact_vec.dot(pull, apart) - lanes.weights * contact_vec.dot(pull, pull) / 2


def objective_of_no_force(lanes: ContactData) -> Array:
    """The objective of no force at all: what gaps are measured against where the optimum's own is small."""
    held = squeezing_forces(lanes)
    return vec3.totals(deviation_cost(lanes, contact_vec.sub(held, held)))[0]


def negative_hessian(lanes: ContactData, jacobian: Lower, unknowns: Coordinates) -> Lower:
    """Sum of k G D G^T over contacts, for a symmetric matrix D of each, 3x3 or 4x4: lower triangle, 6x6."""
    return _hessian_of(vec3.stacked_totals(*_hessian_terms(lanes, jacobian)), unknowns)


def force_change(lanes: ContactData, best: CandidateForces, velocity: ContactVec) -> ContactVec:
    """How the best forces change with velocities of the contacts, k D v."""
    jacobian = friction_cone.derivative(lanes.cone, best.sides)
    moved = contact_vec.of_components(ldl.multiply(jacobian, contact_vec.components(velocity)))
    return contact_vec.scale(lanes.weights, moved)


def _hessian_terms(lanes: ContactData, jacobian: Lower) -> list[Array]:
    k, r = lanes.weights, lanes.arms
    d = [[k * jacobian[max(i, j)][min(i, j)] for j in range(3)] for i in range(3)]
    columns = [vec3.cross(r, Vec3(d[0][j], d[1][j], d[2][j])) for j in range(3)]  # [r]x D, column by column
    mixed = [Vec3(columns[0][i], columns[1][i], columns[2][i]) for i in range(3)]  # its rows
    own = None
    if lanes.lever is not None:
        mixed, own = _with_spin(lanes, vec3.scale(lanes.lever, lanes.normals), jacobian[3], mixed)
    angular = [vec3.cross(r, row) for row in mixed]  # rows of [r]x D [r]x^T
    if own is not None:
        angular = [vec3.add(row, more) for row, more in zip(angular, own, strict=True)]
    terms = [d[i][j] for i in range(3) for j in range(i + 1)]
    terms += [mixed[i][j] for i in range(3) for j in range(3)]
    terms += [angular[i][j] for i in range(3) for j in range(i + 1)]
    return terms


def _with_spin(lanes: ContactData, a: Vec3, last: Sequence[Array], mixed: list[Vec3]) -> tuple[list[Vec3], list[Vec3]]:
    """What moments about the normals add, with ``a`` the normals times the levers and (c, d) the last row of k D.

    To the torques by forces a c^T. To the torques by torques a (r x c)^T, which follows from that, and the rest.
    """
    *row, diagonal = [lanes.weights * entry for entry in last]
    c = Vec3(*row)
    turned = vec3.add(vec3.cross(lanes.arms, c), vec3.scale(diagonal, a))
    mixed = [vec3.add(m, vec3.scale(part, c)) for m, part in zip(mixed, a, strict=True)]
    return mixed, [vec3.scale(part, a) for part in turned]


def _hessian_of(sums: list[Array], unknowns: Coordinates) -> Lower:
    entry = iter(sums)
    linear_rows = [[next(entry) for _ in range(i + 1)] for i in range(3)]
    mixed_rows = [[next(entry) for _ in range(3)] for i in range(3)]
    angular_rows = [[next(entry) for j in range(i + 1)] for i in range(3)]
    return unknowns.curvature(linear_rows + [m + a for m, a in zip(mixed_rows, angular_rows, strict=True)])
