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
from jaxgrasp.numerics.vec3 import Vec
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import Lanes, Problem, read, squeezing
from jaxgrasp.problem.contact_vec import Four
from jaxgrasp.problem.scaling import (
    Frame,
    forces_out,
    moments_out,
    multiplier_in,
    multiplier_out,
    principal,
    scaled,
    turn,
)
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual, pseudo_inverse, torque_limits
from jaxgrasp.solver.coordinates import Stretch, Unknowns
from jaxgrasp.solver.guided_motion import Mixing, directions_in, guided, mixing
from jaxgrasp.solver.torque_limits import Rows


class _Data(NamedTuple):
    """What moves with the problem, in a frame that stays."""

    lanes: Lanes
    directions: Array | None
    """``(B, 6, k)``: the twists that a guide allows."""
    rows: Rows | None
    """Limits of joint torques; None where there are none, or the method does not know them."""


class _Constants(NamedTuple):
    """What stays: the answer does not depend on it."""

    frame: Frame
    whitened: Stretch | Mixing
    """The unknowns of a free object; how they come out of the free twists of one that a guide holds."""
    rows: Array | None
    """Lengths of the limits' rows."""

    def unknowns(self, data: _Data) -> Unknowns:
        if isinstance(self.whitened, Stretch):
            return self.whitened
        assert data.directions is not None
        return guided(data.directions, self.whitened)


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

    forces: Four
    moments: Array | None
    objective: Array
    twist: tuple[Vec, Vec]
    normal_prices: Array | None
    torque_prices: Array | None


def tangent(problem: Problem, moved: Problem, solution: Solution, constrained: bool) -> Tangent:
    """How forces, multipliers and objective move when the problem moves by ``moved``.

    Zero where there is no solution to differentiate; on rank-deficient grasps, within the range.
    """
    held = _constants(problem, constrained)
    frame = held.frame
    data, data_moved = jax.jvp(lambda p: _in_frame(p, held), (problem,), (moved,))
    answered = (solution.verdict <= Verdict.OUTSIDE_CONES)[None, :]
    at = jnp.where(answered, _multipliers(solution, held, data), 0)
    unit = frame.weight / frame.load

    def rest(data: _Data) -> Array:
        unknowns = held.unknowns(data)
        forces = _forces(data, at, unknowns, unit, constrained)[0]
        return _unbalanced(data, at, forces, unknowns)

    _, unbalanced = jax.jvp(rest, (data,), (data_moved,))
    turned = _solve(_curvature(data, at, held.unknowns(data), constrained), unbalanced)

    def outputs(data: _Data, at: Array) -> _Outputs:
        unknowns = held.unknowns(data)
        f, pull = _forces(data, at, unknowns, unit, constrained)
        objective = vec3.totals(dual.spread_by(data.lanes, f, pull))[0]
        bounded = data.lanes.least is not None or data.lanes.most is not None
        prices = dual.normal_prices(data.lanes, _twist(data, at, unknowns)) if bounded else None
        rates = None if data.rows is None else data.rows.scale * at[6:]
        return _Outputs(f, moments_out(data.lanes, f.spin, frame), objective, unknowns.twist(at[:6]), prices, rates)

    _, tangents = jax.jvp(outputs, (data, at), (data_moved, turned))
    return _out(frame, answered, tangents)


def _multipliers(solution: Solution, held: _Constants, data: _Data) -> Array:
    """The solution's multiplier in the unknowns, over those of the limits."""
    point = held.unknowns(data).recover(*multiplier_in(solution.multiplier, held.frame))
    if data.rows is None or solution.torque_multiplier is None:
        return point
    unit = held.frame.weight / held.frame.load
    return jnp.concatenate([point, unit * vec3.safe_divide(solution.torque_multiplier.T, data.rows.scale)])


def _twist(data: _Data, at: Array, unknowns: Unknowns) -> Four:
    """Velocities of the contacts by the object, less those by the joints."""
    twist = dual.twist_at(data.lanes, at[:6], unknowns)
    return twist if data.rows is None else contact_vec.sub(twist, torque_limits.pull(data.rows, at[6:]))


def _unbalanced(data: _Data, at: Array, forces: Four, unknowns: Unknowns) -> Array:
    """What is zero at a solution: the wrench that is left and, of limits that bind, what torques are beyond them."""
    wrench = dual.residual(data.lanes, forces, unknowns)
    if data.rows is None:
        return wrench
    side = jnp.sign(at[6:])
    return jnp.concatenate([wrench, jnp.abs(side) * torque_limits.torques(data.rows, forces) - side * data.rows.bound])


def _forces(data: _Data, at: Array, unknowns: Unknowns, unit: Array, constrained: bool) -> tuple[Four, Four]:
    """The forces of multipliers, and the pull (f - s a) / k of each contact."""
    lanes = data.lanes
    if not constrained:
        return pseudo_inverse.free_forces(lanes, at, unknowns), dual.twist_at(lanes, at, unknowns)
    best = dual.forces_at(lanes, _twist(data, at, unknowns))
    apex = _about_apex(lanes, best.twist, unit)
    return contact_vec.where(_relaxed(lanes), apex, best.forces), dual.pull(lanes, best, unit)


def _relaxed(lanes: Lanes) -> Array:
    """Contacts that neither squeeze nor may move: their force stands at its cone's apex."""
    return (lanes.squeeze == 0) & (lanes.weights == 0)


def _about_apex(lanes: Lanes, twist: Four, unit: Array) -> Four:
    """s a + k v on its cone, for s and k about 0, linearised where both are equal: as method B moves them."""
    seen = lax.stop_gradient(dual.relaxed_target(lanes, twist, unit))
    side = lax.stop_gradient(friction_cone.derivative(lanes.cone, friction_cone.split(seen, lanes.cone)))
    target = contact_vec.add(squeezing(lanes), contact_vec.scale(lanes.weights, twist))
    return contact_vec.of_components(ldl.multiply(side, contact_vec.components(target)))


def _constants(problem: Problem, constrained: bool) -> _Constants:
    """Principal frame, unknowns and lengths of rows of the problem."""
    problem = lax.stop_gradient(problem)
    lanes, _ = read(problem)
    lanes, frame = principal(lanes)
    limited = constrained and problem.torque_map is not None
    rows = torque_limits.rows_of(problem, lanes, frame).scale if limited else None
    if problem.free is None:
        return _Constants(frame, pseudo_inverse.whitened_metric(lanes, frame)[1], rows)
    return _Constants(frame, mixing(directions_in(problem.free, frame), lanes, frame), rows)


def _in_frame(problem: Problem, held: _Constants) -> _Data:
    """The problem in a given frame; a contact that is absent stays where no derivative reaches it."""
    lanes, _ = read(problem)
    frame = held.frame
    weight = jnp.where(frame.weight > 0, frame.weight, 1)
    moved = vec3.sub(lanes.torque, vec3.cross(frame.centre, lanes.force))
    there = scaled(lanes, frame, vec3.sub(lanes.arms, frame.centre), lanes.weights / weight, moved)
    assert frame.axes is not None
    there = turn(there, frame.axes)
    free = None if problem.free is None else directions_in(problem.free, frame)
    rows = None if held.rows is None else torque_limits.rows_scaled_by(held.rows, problem, there, frame)
    return _Data(there, free, rows)


def _curvature(data: _Data, at: Array, unknowns: Unknowns, constrained: bool) -> Array:
    """Minus the Hessian by the unknowns and by the limits that bind, ``(k, k, B)``."""
    lanes = data.lanes
    if not constrained:
        one, zero = jnp.ones_like(lanes.weights), jnp.zeros_like(lanes.weights)
        size = 3 if lanes.lever is None else 4
        return _full(dual.curvature(lanes, [[zero] * i + [one] for i in range(size)], unknowns))
    best = dual.forces_at(lanes, _twist(data, at, unknowns))
    plain = dual.curvature(lanes, friction_cone.derivative(lanes.cone, best.sides), unknowns)
    if data.rows is None:
        return _full(plain)
    binds = (at[6:] != 0).astype(at.dtype)
    return torque_limits.whole(torque_limits.bordered(lanes, unknowns, data.rows, best, plain), binds)


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


def _out(frame: Frame, answered: Array, found: _Outputs) -> Tangent:
    unit = vec3.safe_divide(frame.load, frame.weight)
    linear, angular = multiplier_out(*found.twist, frame)

    def rows(array: Array | None, factor: Array | float = 1) -> Array | None:
        return None if array is None else jnp.where(answered, factor * array, 0).T

    forces = forces_out(found.forces.linear, frame)
    return Tangent(
        forces=jnp.stack([jnp.where(answered, c, 0) for c in forces]).transpose(2, 1, 0),
        multiplier=jnp.concatenate([jnp.where(answered, c, 0) for c in (*linear, *angular)]).T,
        objective=jnp.where(answered, unit * frame.load * found.objective, 0)[0],
        moments=rows(found.moments),
        normal_multiplier=rows(found.normal_prices, unit),
        torque_multiplier=rows(found.torque_prices, unit),
    )
