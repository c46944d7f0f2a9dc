"""Derivatives of a solved problem, from its stationarity condition alone.

At a solution w - G f(multiplier, data) = 0. Differentiating that gives a 6x6 system for the multiplier's
tangent, whatever route the solver took. The rule is plain JAX, so it can be transposed and differentiated
again; frames and scales enter as constants, since the answer does not depend on them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force import cones, dual, fours, pseudo_inverse
from jaxgrasp.force.fours import Four
from jaxgrasp.force.guide import Mixing, directions_in, guided, mixing
from jaxgrasp.force.lanes import (
    Frame,
    Lanes,
    Problem,
    forces_out,
    moments_out,
    multiplier_in,
    multiplier_out,
    principal,
    read,
    scaled,
    squeezing,
    turn,
)
from jaxgrasp.force.sixes import Six
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.force.unknowns import Stretch, Unknowns
from jaxgrasp.model.solution import Solution, Verdict
from jaxgrasp.numerics import semidefinite, symmetric, vec
from jaxgrasp.numerics.vec import Vec


class _Data(NamedTuple):
    """What moves with the problem, in a frame that stays."""

    lanes: Lanes
    directions: Array | None
    """``(B, 6, k)``: the twists that a guide allows."""


class _Constants(NamedTuple):
    """What stays: the answer does not depend on it."""

    frame: Frame
    whitened: Stretch | Mixing
    """The unknowns of a free object; how they come out of the free twists of one that a guide holds."""

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


def tangent(problem: Problem, moved: Problem, solution: Solution, constrained: bool) -> Tangent:
    """How forces, multiplier and objective move when the problem moves by ``moved``.

    Zero where there is no solution to differentiate; on rank-deficient grasps, within the range.
    """
    held = _constants(problem)
    frame = held.frame
    data, data_moved = jax.jvp(lambda p: _in_frame(p, frame), (problem,), (moved,))
    lanes, unknowns = data.lanes, held.unknowns(data)
    answered = (solution.verdict <= Verdict.OUTSIDE_CONES)[None, :]
    at = jnp.where(answered, unknowns.recover(*multiplier_in(solution.multiplier, frame)), 0)
    unit = frame.weight / frame.load

    def rest(data: _Data) -> Six:
        unknowns = held.unknowns(data)
        return dual.residual(data.lanes, _forces(data.lanes, at, unknowns, unit, constrained)[0], unknowns)

    _, unbalanced = jax.jvp(rest, (data,), (data_moved,))
    turned = _solve(_curvature(lanes, at, unknowns, constrained), unbalanced)

    def outputs(data: _Data, multiplier: Six) -> tuple[Four, Array | None, Array, tuple[Vec, Vec]]:
        unknowns = held.unknowns(data)
        f, pull = _forces(data.lanes, multiplier, unknowns, unit, constrained)
        moments = moments_out(data.lanes, f.spin, frame)
        return f, moments, vec.totals(dual.spread_by(data.lanes, f, pull))[0], unknowns.twist(multiplier)

    _, tangents = jax.jvp(outputs, (data, at), (data_moved, turned))
    return _out(frame, answered, *tangents)


def _forces(lanes: Lanes, multiplier: Six, unknowns: Unknowns, unit: Array, constrained: bool) -> tuple[Four, Four]:
    """The forces of a multiplier, and the pull (f - s a) / k of each contact."""
    if not constrained:
        return pseudo_inverse.free_forces(lanes, multiplier, unknowns), dual.twist_at(lanes, multiplier, unknowns)
    best = dual.best_forces(lanes, multiplier, unknowns)
    apex = _about_apex(lanes, best.twist, unit)
    return fours.where(_relaxed(lanes), apex, best.forces), dual.pull(lanes, best, unit)


def _relaxed(lanes: Lanes) -> Array:
    """Contacts that neither squeeze nor may move: their force stands at its cone's apex."""
    return (lanes.squeeze == 0) & (lanes.weights == 0)


def _about_apex(lanes: Lanes, twist: Four, unit: Array) -> Four:
    """s a + k v on its cone, for s and k about 0, linearised where both are equal: as method B moves them."""
    seen = lax.stop_gradient(dual.relaxed_target(lanes, twist, unit))
    side = lax.stop_gradient(cones.derivative(lanes.cone, cones.split(seen, lanes.cone)))
    target = fours.add(squeezing(lanes), fours.scale(lanes.weights, twist))
    return fours.of_components(symmetric.multiply(side, fours.components(target)))


def _constants(problem: Problem) -> _Constants:
    """Principal frame and unknowns of the problem."""
    problem = lax.stop_gradient(problem)
    lanes, _ = read(problem)
    lanes, frame = principal(lanes)
    if problem.free is None:
        return _Constants(frame, pseudo_inverse.whitened_metric(lanes, frame)[1])
    return _Constants(frame, mixing(directions_in(problem.free, frame), lanes, frame))


def _in_frame(problem: Problem, frame: Frame) -> _Data:
    """The problem in a given frame; a contact that is absent stays where no derivative reaches it."""
    lanes, _ = read(problem)
    weight = jnp.where(frame.weight > 0, frame.weight, 1)
    moved = vec.sub(lanes.torque, vec.cross(frame.centre, lanes.force))
    there = scaled(lanes, frame, vec.sub(lanes.arms, frame.centre), lanes.weights / weight, moved)
    assert frame.axes is not None
    free = None if problem.free is None else directions_in(problem.free, frame)
    return _Data(turn(there, frame.axes), free)


def _curvature(lanes: Lanes, at: Six, unknowns: Unknowns, constrained: bool) -> symmetric.Lower:
    if constrained:
        sides = dual.best_forces(lanes, at, unknowns).sides
        return dual.curvature(lanes, cones.derivative(lanes.cone, sides), unknowns)
    one, zero = jnp.ones_like(lanes.weights), jnp.zeros_like(lanes.weights)
    size = 3 if lanes.lever is None else 4
    return dual.curvature(lanes, [[zero] * i + [one] for i in range(size)], unknowns)


def _solve(curvature: symmetric.Lower, right: Six) -> Six:
    """x with H x = right, where H may be singular: then some x that fits, since the forces do not see the rest.

    What no x fits is left alone: there the forces that are active cannot follow the data.
    """
    full = jnp.stack([jnp.stack([curvature[max(i, j)][min(i, j)][0] for j in range(6)]) for i in range(6)])
    factors = semidefinite.factor(full, tolerances(right.dtype).singular)
    x = semidefinite.solve(factors, right)
    # Ill-conditioned, it gets its last digits from what it leaves.
    return x + semidefinite.solve(factors, right - jnp.sum(full * x, 1))


def _out(
    frame: Frame, answered: Array, forces: Four, moments: Array | None, objective: Array, twist: tuple[Vec, Vec]
) -> Tangent:
    unit = vec.safe_divide(frame.load, frame.weight) * frame.load
    linear, angular = multiplier_out(*twist, frame)
    return Tangent(
        forces=jnp.stack([jnp.where(answered, c, 0) for c in forces_out(forces.linear, frame)]).transpose(2, 1, 0),
        multiplier=jnp.concatenate([jnp.where(answered, c, 0) for c in (*linear, *angular)]).T,
        objective=jnp.where(answered, unit * objective, 0)[0],
        moments=None if moments is None else jnp.where(answered, moments, 0).T,
    )
