"""Derivatives of a solved problem, from its stationarity condition alone.

At a solution w - G f(multiplier, data) = 0. Differentiating that gives a 6x6 system for the multiplier's
tangent, whatever route the solver took. The rule is plain JAX, so it can be transposed and differentiated
again; frames and scales enter as constants, since the answer does not depend on them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force import cones, dual, pseudo_inverse
from jaxgrasp.force.dual import Six
from jaxgrasp.force.lanes import (
    Frame,
    Lanes,
    Problem,
    forces_out,
    multiplier_in,
    multiplier_out,
    principal,
    read,
    turn,
)
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.model.solution import Solution, Verdict
from jaxgrasp.numerics import semidefinite, symmetric, vec
from jaxgrasp.numerics.vec import Vec


class Tangent(NamedTuple):
    """Tangents of the differentiable fields of a Solution."""

    forces: Array
    multiplier: Array
    objective: Array


def tangent(problem: Problem, moved: Problem, solution: Solution, constrained: bool) -> Tangent:
    """How forces, multiplier and objective move when the problem moves by ``moved``.

    Zero where there is no solution to differentiate; on rank-deficient grasps, within the range.
    """
    frame, stretch = _constants(problem)
    lanes, lanes_moved = jax.jvp(lambda p: _in_frame(p, frame), (problem,), (moved,))
    answered = (solution.verdict <= Verdict.OUTSIDE_CONES)[None, :]
    linear, angular = multiplier_in(solution.multiplier, frame)
    inverse = Vec(*(vec.safe_divide(jnp.ones_like(s), s) for s in stretch))
    at = jnp.where(answered, dual.six(linear, vec.times(inverse, angular)), 0)

    unit = frame.weight / frame.load

    def rest(lanes: Lanes) -> Six:
        return dual.residual(lanes, _forces(lanes, at, stretch, unit, constrained)[0], stretch)

    _, unbalanced = jax.jvp(rest, (lanes,), (lanes_moved,))
    turned = _solve(_curvature(lanes, at, stretch, constrained), unbalanced)

    def outputs(lanes: Lanes, multiplier: Six) -> tuple[Vec, Array]:
        f, pull = _forces(lanes, multiplier, stretch, unit, constrained)
        return f, vec.totals(dual.spread_by(lanes, f, pull))[0]

    _, (forces_moved, objective_moved) = jax.jvp(outputs, (lanes, at), (lanes_moved, turned))
    return _out(frame, stretch, answered, forces_moved, turned, objective_moved)


def _forces(lanes: Lanes, multiplier: Six, stretch: Vec, unit: Array, constrained: bool) -> tuple[Vec, Vec]:
    """The forces of a multiplier, and the pull (f - s a) / k of each contact."""
    if not constrained:
        return pseudo_inverse.free_forces(lanes, multiplier, stretch), dual.twist_at(lanes, multiplier, stretch)
    best = dual.best_forces(lanes, multiplier, stretch)
    apex = _about_apex(lanes, best.twist, unit)
    return vec.where(_relaxed(lanes), apex, best.forces), dual.pull(lanes, best, unit)


def _relaxed(lanes: Lanes) -> Array:
    """Contacts that neither squeeze nor may move: their force stands at its cone's apex."""
    return (lanes.squeeze == 0) & (lanes.weights == 0)


def _about_apex(lanes: Lanes, twist: Vec, unit: Array) -> Vec:
    """s a + k v on its cone, for s and k about 0, linearised where both are equal: as method B moves them."""
    seen = lax.stop_gradient(dual.relaxed_target(lanes, twist, unit))
    side = cones.derivative(lanes.normals, lanes.friction, cones.split(seen, lanes.normals, lanes.friction))
    side = lax.stop_gradient(side)
    target = vec.add(vec.scale(lanes.squeeze, lanes.normals), vec.scale(lanes.weights, twist))
    return Vec(*symmetric.multiply(side, target))


def _constants(problem: Problem) -> tuple[Frame, Vec]:
    """Principal frame and stretch of the problem, held constant."""
    lanes, _ = read(lax.stop_gradient(problem))
    lanes, frame = principal(lanes)
    _, stretch = pseudo_inverse.whitened_metric(lanes, frame)
    return frame, stretch


def _in_frame(problem: Problem, frame: Frame) -> Lanes:
    """The problem's lanes in a given frame; a contact that is absent stays where no derivative reaches it."""
    lanes, _ = read(problem)
    weight = jnp.where(frame.weight > 0, frame.weight, 1)
    moved = vec.sub(lanes.torque, vec.cross(frame.centre, lanes.force))
    scaled = lanes._replace(
        arms=vec.scale(1 / frame.length, vec.sub(lanes.arms, frame.centre)),
        squeeze=lanes.squeeze / frame.load,
        weights=lanes.weights / weight,
        force=vec.scale(1 / frame.load, lanes.force),
        torque=vec.scale(1 / (frame.load * frame.length), moved),
    )
    assert frame.axes is not None
    return turn(scaled, frame.axes)


def _curvature(lanes: Lanes, at: Six, stretch: Vec, constrained: bool) -> symmetric.Lower:
    if constrained:
        sides = dual.best_forces(lanes, at, stretch).sides
        return dual.curvature(lanes, cones.derivative(lanes.normals, lanes.friction, sides), stretch)
    one, zero = jnp.ones_like(lanes.weights), jnp.zeros_like(lanes.weights)
    return dual.curvature(lanes, [[one], [zero, one], [zero, zero, one]], stretch)


def _solve(curvature: symmetric.Lower, right: Six) -> Six:
    """x with H x = right, where H may be singular: then some x that fits, since the forces do not see the rest.

    What no x fits is left alone: there the forces that are active cannot follow the data.
    """
    full = jnp.stack([jnp.stack([curvature[max(i, j)][min(i, j)][0] for j in range(6)]) for i in range(6)])
    factors = semidefinite.factor(full, tolerances(right.dtype).singular)
    x = semidefinite.solve(factors, right)
    # Ill-conditioned, it gets its last digits from what it leaves.
    return x + semidefinite.solve(factors, right - jnp.sum(full * x, 1))


def _out(frame: Frame, stretch: Vec, answered: Array, forces: Vec, multiplier: Six, objective: Array) -> Tangent:
    unit = vec.safe_divide(frame.load, frame.weight) * frame.load
    linear, angular = dual.parts(multiplier)
    linear, angular = multiplier_out(linear, vec.times(stretch, angular), frame)
    return Tangent(
        forces=jnp.stack([jnp.where(answered, c, 0) for c in forces_out(forces, frame)]).transpose(2, 1, 0),
        multiplier=jnp.concatenate([jnp.where(answered, c, 0) for c in (*linear, *angular)]).T,
        objective=jnp.where(answered, unit * objective, 0)[0],
    )
