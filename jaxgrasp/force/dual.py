"""The dual of the force distribution problem: six unknowns, whatever the number of contacts.

For a multiplier (a virtual twist) the best force of each contact is a projection on its cone,

    f_i = P_i(s_i a_i + k_i (linear + angular x r_i)),

and the dual value is concave, once continuously differentiable, with gradient w - G f. Everything here is
in the coordinates of ``lanes.py``; ``unknowns`` says what the six numbers of a multiplier stand for there.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.force import cones
from jaxgrasp.force.lanes import Lanes
from jaxgrasp.force.sixes import Six, inner
from jaxgrasp.force.unknowns import Unknowns
from jaxgrasp.numerics import symmetric, vec
from jaxgrasp.numerics.symmetric import Lower
from jaxgrasp.numerics.vec import Vec


def load(lanes: Lanes, unknowns: Unknowns) -> Six:
    """The wrench asked for."""
    return unknowns.wrench(lanes.force, lanes.torque)


def solve(factors: tuple[list[list[Array]], list[Array]], right: Six) -> Six:
    """x with A x = right, from the factors of A."""
    return jnp.concatenate(symmetric.solve(factors, [right[i : i + 1] for i in range(6)]))


class Forces(NamedTuple):
    """The best forces for a multiplier, and what they came from."""

    twist: Vec
    """The multiplier's velocity at each contact, less the toll along its normal."""
    sides: cones.Split
    forces: Vec


class Value(NamedTuple):
    """The dual at a point: value, gradient and minus Hessian."""

    value: Array
    gradient: Six
    curvature: Lower
    push: Array
    """Sum of the normal forces: how large the numbers are that the gradient is a difference of."""


def twist_at(lanes: Lanes, multiplier: Six, unknowns: Unknowns) -> Vec:
    """Velocity of the multiplier, as a twist, at each contact."""
    linear, angular = unknowns.twist(multiplier)
    return vec.add(linear, vec.cross(angular, lanes.arms))


def best_forces(lanes: Lanes, multiplier: Six, unknowns: Unknowns) -> Forces:
    twist = twist_at(lanes, multiplier, unknowns)
    if lanes.toll is not None:
        twist = vec.sub(twist, vec.scale(lanes.toll, lanes.normals))
    target = vec.add(vec.scale(lanes.squeeze, lanes.normals), vec.scale(lanes.weights, twist))
    sides = cones.split(target, lanes.normals, lanes.friction)
    return Forces(twist, sides, cones.project(target, lanes.normals, lanes.friction, sides))


def residual(lanes: Lanes, forces: Vec, unknowns: Unknowns) -> Six:
    """w - G f."""
    return _unbalanced(lanes, unknowns, vec.totals(*wrench_terms(lanes, forces)))


def wrench_terms(lanes: Lanes, forces: Vec) -> tuple[Array, ...]:
    """What each contact adds to the wrench: force, then torque."""
    return (*forces, *vec.cross(lanes.arms, forces))


def _unbalanced(lanes: Lanes, unknowns: Unknowns, wrench: list[Array]) -> Six:
    linear, angular = vec.sub(lanes.force, Vec(*wrench[:3])), vec.sub(lanes.torque, Vec(*wrench[3:]))
    return unknowns.wrench(linear, angular)


def evaluate(lanes: Lanes, multiplier: Six, unknowns: Unknowns) -> Value:
    best = best_forces(lanes, multiplier, unknowns)
    jacobian = cones.derivative(lanes.normals, lanes.friction, best.sides)
    sums = vec.totals(*_value_terms(lanes, best)) + vec.stacked_totals(*_curvature_terms(lanes, jacobian))
    value, gradient, push = _value(lanes, multiplier, unknowns, sums[:VALUE_TERMS])
    return Value(value, gradient, _curvature_of(sums[VALUE_TERMS:], unknowns), push)


def dual_value(lanes: Lanes, best: Forces, multiplier: Six, unknowns: Unknowns) -> Array:
    """The dual at a multiplier whose best forces are known."""
    return _value(lanes, multiplier, unknowns, vec.totals(*_value_terms(lanes, best)))[0]


def total_push(lanes: Lanes, forces: Vec) -> Array:
    """Sum of the normal forces."""
    return vec.totals(vec.dot(forces, lanes.normals))[0]


VALUE_TERMS = 8


def _value_terms(lanes: Lanes, best: Forces) -> tuple[Array, ...]:
    # w.x + sum of |f - s a|^2 / 2k - v.f, written so that small weights cancel nothing.
    own = spread(lanes, best.forces) - vec.dot(best.twist, best.forces)
    return own, vec.dot(best.forces, lanes.normals), *wrench_terms(lanes, best.forces)


def _value(lanes: Lanes, multiplier: Six, unknowns: Unknowns, sums: list[Array]) -> tuple[Array, Six, Array]:
    own, push, *wrench = sums
    return inner(load(lanes, unknowns), multiplier) + own, _unbalanced(lanes, unknowns, wrench), push


def spread(lanes: Lanes, forces: Vec) -> Array:
    """|f - s a|^2 / 2k of each contact; 0 where k is 0."""
    apart = vec.sub(forces, vec.scale(lanes.squeeze, lanes.normals))
    return vec.safe_divide(vec.dot(apart, apart), 2 * lanes.weights)


def pull(lanes: Lanes, best: Forces, unit: Array) -> Vec:
    """(f - s a) / k of each contact, and what it tends to as k falls to 0; the squeeze with it, where that is 0 too.

    ``unit`` is what one unit of weight means in squeeze where both are the same number to the user.
    """
    moves, held = lanes.weights > 0, vec.scale(lanes.squeeze, lanes.normals)
    apart = vec.scale(1 / jnp.where(moves, lanes.weights, 1), vec.sub(best.forces, held))
    along = vec.scale(vec.dot(best.twist, lanes.normals), lanes.normals)
    still = vec.where(lanes.friction > 0, best.twist, along)
    # At s = k = 0 the force is k times a projection.
    target, own = relaxed_target(lanes, best.twist, unit), vec.scale(unit, lanes.normals)
    sides = cones.split(target, lanes.normals, lanes.friction)
    relaxed = vec.sub(cones.project(target, lanes.normals, lanes.friction, sides), own)
    return vec.where(moves, apart, vec.where(lanes.squeeze > 0, still, relaxed))


def relaxed_target(lanes: Lanes, twist: Vec, unit: Array) -> Vec:
    """s a + k v where s and k grow from 0 together, as by method B; for each unit of weight."""
    return vec.add(vec.scale(unit, lanes.normals), twist)


def spread_by(lanes: Lanes, forces: Vec, pull: Vec) -> Array:
    """The same as ``spread`` in value, with the derivative by k that it has at k = 0 too, from above.

    Stationary in ``pull``, so that only forces, squeeze and weights move it.
    """
    apart = vec.sub(forces, vec.scale(lanes.squeeze, lanes.normals))
    return vec.dot(pull, apart) - lanes.weights * vec.dot(pull, pull) / 2


def price_of_nothing(lanes: Lanes) -> Array:
    """The objective of no force at all: what gaps are measured against where the optimum's own is small."""
    return vec.totals(spread(lanes, Vec(*(jnp.zeros_like(c) for c in lanes.normals))))[0]


def curvature(lanes: Lanes, jacobian: Lower, unknowns: Unknowns) -> Lower:
    """Sum of k G D G^T over contacts, for a symmetric 3x3 matrix D of each: lower triangle, 6x6."""
    return _curvature_of(vec.stacked_totals(*_curvature_terms(lanes, jacobian)), unknowns)


def _curvature_terms(lanes: Lanes, jacobian: Lower) -> list[Array]:
    k, r = lanes.weights, lanes.arms
    d = [[k * jacobian[max(i, j)][min(i, j)] for j in range(3)] for i in range(3)]
    columns = [vec.cross(r, Vec(d[0][j], d[1][j], d[2][j])) for j in range(3)]  # [r]x D, column by column
    mixed = [Vec(columns[0][i], columns[1][i], columns[2][i]) for i in range(3)]  # its rows
    angular = [vec.cross(r, row) for row in mixed]  # rows of [r]x D [r]x^T
    terms = [d[i][j] for i in range(3) for j in range(i + 1)]
    terms += [mixed[i][j] for i in range(3) for j in range(3)]
    terms += [angular[i][j] for i in range(3) for j in range(i + 1)]
    return terms


def _curvature_of(sums: list[Array], unknowns: Unknowns) -> Lower:
    entry = iter(sums)
    linear_rows = [[next(entry) for _ in range(i + 1)] for i in range(3)]
    mixed_rows = [[next(entry) for _ in range(3)] for i in range(3)]
    angular_rows = [[next(entry) for j in range(i + 1)] for i in range(3)]
    return unknowns.curvature(linear_rows + [m + a for m, a in zip(mixed_rows, angular_rows, strict=True)])
