"""The dual of the force distribution problem: six unknowns, whatever the number of contacts.

For a multiplier (a virtual twist) the best force of each contact is a projection on its cone,

    f_i = P_i(s_i a_i + k_i (linear + angular x r_i)),

and the dual value is concave, once continuously differentiable, with gradient w - G f. Everything here is
in the coordinates of ``lanes.py``. ``stretch`` scales the angular unknowns (and torques) along the axes,
so that directions that the contacts hardly reach are as large as the others; 0 removes a direction.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.force import cones
from jaxgrasp.force.lanes import Lanes
from jaxgrasp.numerics import vec
from jaxgrasp.numerics.symmetric import Lower
from jaxgrasp.numerics.vec import Vec

Six = Array
"""``(6, B)``: linear components over angular ones."""


def six(linear: Vec, angular: Vec) -> Six:
    return jnp.concatenate(jnp.broadcast_arrays(*linear, *angular))


def parts(x: Six) -> tuple[Vec, Vec]:
    """The linear and the angular components, each ``(1, B)``."""
    rows = [x[i : i + 1] for i in range(6)]
    return Vec(*rows[:3]), Vec(*rows[3:])


def inner(a: Six, b: Six) -> Array:
    return jnp.sum(a * b, 0, keepdims=True)


def length(x: Six) -> Array:
    return jnp.sqrt(inner(x, x))


def load(lanes: Lanes, stretch: Vec) -> Six:
    """The wrench asked for."""
    return six(lanes.force, vec.times(stretch, lanes.torque))


class Forces(NamedTuple):
    """The best forces for a multiplier, and what they came from."""

    twist: Vec
    """The multiplier's velocity at each contact."""
    sides: cones.Split
    forces: Vec


class Value(NamedTuple):
    """The dual at a point: value, gradient and minus Hessian."""

    value: Array
    gradient: Six
    curvature: Lower
    push: Array
    """Sum of the normal forces: how large the numbers are that the gradient is a difference of."""


def twist_at(lanes: Lanes, multiplier: Six, stretch: Vec) -> Vec:
    """Velocity of the multiplier, as a twist, at each contact."""
    linear, angular = parts(multiplier)
    return vec.add(linear, vec.cross(vec.times(stretch, angular), lanes.arms))


def best_forces(lanes: Lanes, multiplier: Six, stretch: Vec) -> Forces:
    twist = twist_at(lanes, multiplier, stretch)
    target = vec.add(vec.scale(lanes.squeeze, lanes.normals), vec.scale(lanes.weights, twist))
    sides = cones.split(target, lanes.normals, lanes.friction)
    return Forces(twist, sides, cones.project(target, lanes.normals, lanes.friction, sides))


def residual(lanes: Lanes, forces: Vec, stretch: Vec) -> Six:
    """w - G f."""
    linear = vec.sub(lanes.force, vec.total(forces))
    angular = vec.sub(lanes.torque, vec.total(vec.cross(lanes.arms, forces)))
    return six(linear, vec.times(stretch, angular))


def evaluate(lanes: Lanes, multiplier: Six, stretch: Vec) -> Value:
    best = best_forces(lanes, multiplier, stretch)
    gradient = residual(lanes, best.forces, stretch)
    jacobian = cones.derivative(lanes.normals, lanes.friction, best.sides)
    value = dual_value(lanes, best, multiplier, stretch)
    return Value(value, gradient, curvature(lanes, jacobian, stretch), total_push(lanes, best.forces))


def total_push(lanes: Lanes, forces: Vec) -> Array:
    return jnp.sum(vec.dot(forces, lanes.normals), 0, keepdims=True)


def dual_value(lanes: Lanes, best: Forces, multiplier: Six, stretch: Vec) -> Array:
    """w.x + sum of |f - s a|^2 / 2k - v.f, written so that small weights cancel nothing."""
    work = inner(load(lanes, stretch), multiplier)
    own = spread(lanes, best.forces) - vec.dot(best.twist, best.forces)
    return work + jnp.sum(own, 0, keepdims=True)


def spread(lanes: Lanes, forces: Vec) -> Array:
    """|f - s a|^2 / 2k of each contact; 0 where k is 0."""
    apart = vec.sub(forces, vec.scale(lanes.squeeze, lanes.normals))
    return vec.safe_divide(vec.dot(apart, apart), 2 * lanes.weights)


def curvature(lanes: Lanes, jacobian: Lower, stretch: Vec) -> Lower:
    """Sum of k G D G^T over contacts, for a symmetric 3x3 matrix D of each: lower triangle, 6x6."""
    k, r = lanes.weights, lanes.arms
    d = [[k * jacobian[max(i, j)][min(i, j)] for j in range(3)] for i in range(3)]
    columns = [vec.cross(r, Vec(d[0][j], d[1][j], d[2][j])) for j in range(3)]  # [r]x D, column by column
    mixed = [Vec(columns[0][i], columns[1][i], columns[2][i]) for i in range(3)]  # its rows
    angular = [vec.cross(r, row) for row in mixed]  # rows of [r]x D [r]x^T

    # One sum over a stack: 21 separate ones would each compute their terms from the start again.
    terms = [d[i][j] for i in range(3) for j in range(i + 1)]
    terms += [mixed[i][j] for i in range(3) for j in range(3)]
    terms += [angular[i][j] for i in range(3) for j in range(i + 1)]
    sums = jnp.sum(jnp.stack(terms), 1)
    entry = iter(sums[q : q + 1] for q in range(21))
    linear_rows = [[next(entry) for _ in range(i + 1)] for i in range(3)]
    mixed_rows = [[stretch[i] * next(entry) for _ in range(3)] for i in range(3)]
    angular_rows = [[stretch[i] * stretch[j] * next(entry) for j in range(i + 1)] for i in range(3)]
    return linear_rows + [m + a for m, a in zip(mixed_rows, angular_rows, strict=True)]
