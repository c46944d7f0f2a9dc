"""Derivatives of a solved problem, from its stationarity condition alone.

At a solution w - G f(multiplier, data) = 0. Differentiating that gives a 6x6 system for the multiplier's
tangent, whatever route the solver took. The rule is plain JAX, so it can be transposed and differentiated
again; frames and scales enter as constants, since the answer does not depend on them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Solution, Verdict
from jaxgrasp.numerics import ldl, pivoted_ldl, vec3
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, squeezing_forces, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
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
from jaxgrasp.solver.coordinates import Coordinates, ScaledAxes
from jaxgrasp.solver.guided_motion import Mixing, directions_to_scaled, guided_coordinates, mixing
from jaxgrasp.solver.torque_limits import TorqueConstraints


class _Moving(NamedTuple):
    """What moves with the problem, in a frame that stays."""

    lanes: ContactData
    directions: Array | None
    """``(B, 6, k)``: the twists that a guide allows."""
    rows: TorqueConstraints | None
    """Limits of joint torques; None where there are none, or the method does not know them."""


class _Fixed(NamedTuple):
    """What stays: the answer does not depend on it."""

    frame: Scaling
    whitened: ScaledAxes | Mixing
    """The unknowns of a free object; how they come out of the free twists of one that a guide holds."""
    rows: Array | None
    """Lengths of the limits' rows."""

    def unknowns(self, data: _Moving) -> Coordinates:
        if isinstance(self.whitened, ScaledAxes):
            return self.whitened
        assert data.directions is not None
        return guided_coordinates(data.directions, self.whitened)


class Tangent(NamedTuple):
    """Tangents of the differentiable fields of a Solution."""

    forces: Array
    multiplier: Array
    objective: Array
    moments: Array | None
    normal_multiplier: Array | None
    torque_multiplier: Array | None


class _Outputs(NamedTuple):
    """What is differentiated, in the lanes' coordinates."""

    forces: ContactVec
    moments: Array | None
    objective: Array
    twist: tuple[Vec3, Vec3]
    normal_prices: Array | None
    torque_prices: Array | None


def tangent(problem: ProblemBatch, moved: ProblemBatch, solution: Solution, constrained: bool) -> Tangent:
    """How forces, multipliers and objective move when the problem moves by ``moved``.

    Zero where there is no solution to differentiate; on rank-deficient grasps, within the range.
    """
    held = _constants(problem, constrained)
    frame = held.frame
    data, data_moved = jax.jvp(lambda p: _in_scaling(p, held), (problem,), (moved,))
    answered = (solution.verdict <= Verdict.OUTSIDE_CONES)[None, :]
    at = jnp.where(answered, _multipliers(solution, held, data), 0)
    unit = frame.weight / frame.load

    def rest(data: _Moving) -> Array:
        unknowns = held.unknowns(data)
        forces = _forces(data, at, unknowns, unit, constrained)[0]
        return _optimality_residual(data, at, forces, unknowns)

    _, unbalanced = jax.jvp(rest, (data,), (data_moved,))
    turned = _solve(_negative_hessian(data, at, held.unknowns(data), constrained), unbalanced)

    def outputs(data: _Moving, at: Array) -> _Outputs:
        unknowns = held.unknowns(data)
        f, pull = _forces(data, at, unknowns, unit, constrained)
        objective = vec3.totals(dual.deviation_cost_by(data.lanes, f, pull))[0]
        bounded = data.lanes.least is not None or data.lanes.most is not None
        prices = dual.normal_multipliers(data.lanes, _twist(data, at, unknowns)) if bounded else None
        rates = None if data.rows is None else data.rows.scale * at[6:]
        return _Outputs(
            f, moments_from_scaled(data.lanes, f.spin, frame), objective, unknowns.twist(at[:6]), prices, rates
        )

    _, tangents = jax.jvp(outputs, (data, at), (data_moved, turned))
    return _to_solution(frame, answered, tangents)


def _multipliers(solution: Solution, held: _Fixed, data: _Moving) -> Array:
    """The solution's multiplier in the unknowns, over those of the limits."""
    point = held.unknowns(data).recover(*multiplier_to_scaled(solution.multiplier, held.frame))
    if data.rows is None or solution.torque_multiplier is None:
        return point
    unit = held.frame.weight / held.frame.load
    return jnp.concatenate([point, unit * vec3.safe_divide(solution.torque_multiplier.T, data.rows.scale)])


def _twist(data: _Moving, at: Array, unknowns: Coordinates) -> ContactVec:
    """Velocities of the contacts by the object, less those by the joints."""
    twist = dual.contact_velocities(data.lanes, at[:6], unknowns)
    return twist if data.rows is None else contact_vec.sub(twist, torque_limits.velocities_by_joints(data.rows, at[6:]))


def _optimality_residual(data: _Moving, at: Array, forces: ContactVec, unknowns: Coordinates) -> Array:
    """What is zero at a solution: the wrench that is left and, of limits that bind, what torques are beyond them."""
    wrench = dual.residual(data.lanes, forces, unknowns)
    if data.rows is None:
        return wrench
    side = jnp.sign(at[6:])
    return jnp.concatenate([wrench, jnp.abs(side) * torque_limits.torques(data.rows, forces) - side * data.rows.bound])


def _forces(
    data: _Moving, at: Array, unknowns: Coordinates, unit: Array, constrained: bool
) -> tuple[ContactVec, ContactVec]:
    """The forces of multipliers, and the pull (f - s a) / k of each contact."""
    lanes = data.lanes
    if not constrained:
        return pseudo_inverse.forces_without_cones(lanes, at, unknowns), dual.contact_velocities(lanes, at, unknowns)
    best = dual.candidate_forces_at(lanes, _twist(data, at, unknowns))
    apex = _about_apex(lanes, best.twist, unit)
    return contact_vec.where(_neither_squeezes_nor_moves(lanes), apex, best.forces), dual.weighted_deviation(
        lanes, best, unit
    )


def _neither_squeezes_nor_moves(lanes: ContactData) -> Array:
    """Contacts that neither squeeze nor may move: their force stands at its cone's apex."""
    return (lanes.squeeze == 0) & (lanes.weights == 0)


def _about_apex(lanes: ContactData, twist: ContactVec, unit: Array) -> ContactVec:
    """s a + k v on its cone, for s and k about 0, linearised where both are equal: as method B moves them."""
    seen = lax.stop_gradient(dual.relaxed_target(lanes, twist, unit))
    side = lax.stop_gradient(friction_cone.derivative(lanes.cone, friction_cone.cone_side(seen, lanes.cone)))
    target = contact_vec.add(squeezing_forces(lanes), contact_vec.scale(lanes.weights, twist))
    return contact_vec.of_components(ldl.multiply(side, contact_vec.components(target)))


def _constants(problem: ProblemBatch, constrained: bool) -> _Fixed:
    """Principal frame, unknowns and lengths of rows of the problem."""
    problem = lax.stop_gradient(problem)
    lanes, _ = to_batch_last(problem)
    lanes, frame = scale_in_principal_axes(lanes)
    limited = constrained and problem.torque_map is not None
    rows = torque_limits.torque_constraints(problem, lanes, frame).scale if limited else None
    if problem.free is None:
        return _Fixed(frame, pseudo_inverse.whitened_metric(lanes, frame)[1], rows)
    return _Fixed(frame, mixing(directions_to_scaled(problem.free, frame), lanes, frame), rows)


def _in_scaling(problem: ProblemBatch, held: _Fixed) -> _Moving:
    """The problem in a given frame; a contact that is absent stays where no derivative reaches it."""
    lanes, _ = to_batch_last(problem)
    frame = held.frame
    weight = jnp.where(frame.weight > 0, frame.weight, 1)
    moved = vec3.sub(lanes.torque, vec3.cross(frame.centre, lanes.force))
    there = with_scaling(lanes, frame, vec3.sub(lanes.arms, frame.centre), lanes.weights / weight, moved)
    assert frame.axes is not None
    there = rotate(there, frame.axes)
    free = None if problem.free is None else directions_to_scaled(problem.free, frame)
    rows = None if held.rows is None else torque_limits.torque_constraints_scaled_by(held.rows, problem, there, frame)
    return _Moving(there, free, rows)


def _negative_hessian(data: _Moving, at: Array, unknowns: Coordinates, constrained: bool) -> Array:
    """Minus the Hessian by the unknowns and by the limits that bind, ``(k, k, B)``."""
    lanes = data.lanes
    if not constrained:
        one, zero = jnp.ones_like(lanes.weights), jnp.zeros_like(lanes.weights)
        size = 3 if lanes.lever is None else 4
        return _full(dual.negative_hessian(lanes, [[zero] * i + [one] for i in range(size)], unknowns))
    best = dual.candidate_forces_at(lanes, _twist(data, at, unknowns))
    plain = dual.negative_hessian(lanes, friction_cone.derivative(lanes.cone, best.sides), unknowns)
    if data.rows is None:
        return _full(plain)
    binds = (at[6:] != 0).astype(at.dtype)
    return torque_limits.full_matrix(torque_limits.bordered_hessian(lanes, unknowns, data.rows, best, plain), binds)


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


def _to_solution(frame: Scaling, answered: Array, found: _Outputs) -> Tangent:
    unit = vec3.safe_divide(frame.load, frame.weight)
    linear, angular = multiplier_from_scaled(*found.twist, frame)

    def rows(array: Array | None, factor: Array | float = 1) -> Array | None:
        return None if array is None else jnp.where(answered, factor * array, 0).T

    forces = forces_from_scaled(found.forces.linear, frame)
    return Tangent(
        forces=jnp.stack([jnp.where(answered, c, 0) for c in forces]).transpose(2, 1, 0),
        multiplier=jnp.concatenate([jnp.where(answered, c, 0) for c in (*linear, *angular)]).T,
        objective=jnp.where(answered, unit * frame.load * found.objective, 0)[0],
        moments=rows(found.moments),
        normal_multiplier=rows(found.normal_prices, unit),
        torque_multiplier=rows(found.torque_prices, unit),
    )
