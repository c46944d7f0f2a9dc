"""Min-weight measure of force closure: the evenness with which edges of friction pyramids balance each other."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.wrench_discs import WrenchDiscs, differentiable_where, discs
from jaxgrasp.quality.grasp_input import (
    MANY_TOGETHER,
    call_on_host,
    in_turn,
    is_traced,
    range_of,
    read_grasps,
    with_derivative_of,
)
from jaxgrasp.quality.simplex_steps import SimplexBases
from jaxgrasp.quality.wrench_sets import WrenchSets, check_sides, pyramid
from jaxgrasp.validation.checked import checked

FEASIBLE = 1e-10
"""Feasibility tolerance of HiGHS, the least that it accepts."""
PIVOTS = 150
"""Steps of the simplex method; most need twenty."""
OPTIMAL = 1e-11
"""Improvement per unit of weight below which a program counts as solved."""
BALANCED = 1e-11
"""Largest error of the weights' balance."""


class MinWeight(NamedTuple):
    """The answers of the linear programs of a batch of grasps."""

    value: np.ndarray
    """``(...)``: the least weight, times the number of weights; at most 1. -inf where no weights balance at all."""
    weights: np.ndarray
    """``(..., n, k)``: of the edges; their sum is 1."""
    twist: np.ndarray
    """``(..., 6)``: multipliers of the balance: how the value moves with a wrench that is to be left over, in scaled
    units."""
    corners: np.ndarray
    """``(k, 3)``: the edges as parts of the largest friction along two tangents, and of a soft finger's moment."""

    def __str__(self) -> str:
        return f"MinWeight: value {range_of(self.value)}"


@checked
def min_weight(grasp: Grasp, *, sides: int = 4, progress: Progress | None = None) -> MinWeight:
    """Compute the largest least weight with which all edges of the friction pyramids balance each other.

    With w_j the wrenches of the m edges, of normal force 1 each: the largest l for which some weights >= l have the
    sum 1 and balance, sum of weight_j w_j = 0; times m, so that 1 says that equal weights balance. It is above zero
    only for grasps that are closed (with pyramids), if the wrenches have rank 6. Neither a length nor a point
    matters. Where several edges bound the answer and it is degenerate, or the multipliers are not unique, it is not
    differentiable there and the multipliers are those of one side.

    Inside ``jit``, ``vmap`` and ``grad`` it calls the host back, nothing is checked, and results are JAX arrays in the
    precision of the points; the value then has the derivative of ``min_weight_at``.

    Source: Li, Culbertson, Burdick and Ames, FRoGGeR: fast robust grasp generation via the min-weight metric, 2023.

    Args:
        grasp: contacts ``(..., n)``.
        sides: edges of each pyramid, the first one across the coordinate axis that is least along the normal; two
            more for the moments of soft fingers, if there are any.
        progress: as for [`jaxgrasp.quality.ferrari_canny`][].

    Raises:
        GraspError: for the first entry that is not usable, before anything is computed.
        ValueError: for ``sides`` that cannot be used.
    """
    check_sides(sides)
    if is_traced(grasp):
        return _traced(grasp, sides)
    inputs = read_grasps(grasp)
    corners = pyramid(sides, inputs.soft)
    bodies = inputs.bodies()
    value, weights, twists = in_turn(
        len(bodies.present), lambda indices: solve_min_weight(bodies.take(indices), corners), progress, MANY_TOGETHER
    )
    batch, contacts = inputs.batch, inputs.present.shape
    weights = weights.reshape((*contacts, len(corners)))
    return MinWeight(value.reshape(batch), weights, twists.reshape((*batch, 6)), corners)


def _traced(grasp: Grasp, sides: int) -> MinWeight:
    corners = pyramid(sides, grasp.torsion is not None)
    trailing = ((), (grasp.friction.shape[-1], len(corners)), (6,))
    shapes, answers = call_on_host(
        partial(solve_min_weight, corners=corners), trailing, grasp, None, None, together=MANY_TOGETHER
    )
    value, weights, twist = answers
    solution: Any = MinWeight(value, weights, twist, corners)
    return solution._replace(
        value=with_derivative_of(
            solution.value, jnp.where(jnp.isfinite(solution.value), _value_at(shapes, solution), 0)
        )
    )


@checked
def min_weight_at(grasp: Grasp, measurement: MinWeight) -> Float[Array, "..."]:
    """Evaluate the least weight near a grasp measured by ``min_weight``, to differentiate it by the grasp.

    By the envelope theorem of linear programs it moves as the multipliers' work on the weighted edges does. First
    derivatives only, and none (NaN) where no weights balance; its value at the grasp measured is ``measurement.value``.

    Args:
        grasp: the grasp measured, of JAX arrays; works under ``jit``, ``vmap`` and ``grad``.
        measurement: what ``min_weight`` returned.
    """
    return _compiled_value(grasp, measurement)


@jax.jit
def _compiled_value(grasp: Grasp, measurement: MinWeight) -> Array:
    return _value_at(discs(grasp), measurement)


def _value_at(shapes: WrenchDiscs, measurement: MinWeight) -> Array:
    value, weights, twist, corners = (jnp.asarray(array, shapes.centres.dtype) for array in measurement)
    tangentials = jnp.einsum("...njc,kc->...nkj", shapes.spans, corners)
    edges = shapes.centres[..., None, :] + tangentials
    moved_value = value + jnp.einsum("...nk,...nkj,...j->...", weights, edges, twist)
    return differentiable_where(jnp.isfinite(value), moved_value, shapes)


def solve_min_weight(bodies: WrenchSets, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve for values ``(G,)``, weights ``(G, n * k)`` of the edges and multipliers ``(G, 6)``.

    Columns of the programs are those of the weights above the least, and the value, which may be negative. Programs
    are solved side by side by the simplex method, and what that does not finish by HiGHS.
    """
    pyramids = replace(bodies, corners=corners).alone_edges()
    edges, present = pyramids.discs[:, :, 0], pyramids.present
    grasps = len(edges)
    answers = np.full(grasps, -np.inf), np.zeros(present.shape), np.zeros((grasps, 6))
    solved: np.ndarray = np.logical_not(present.any(1))
    unsolved = np.flatnonzero(~solved)
    if len(unsolved):
        solved[unsolved] = _by_simplex(edges[unsolved], present[unsolved], unsolved, answers)
    for index in np.flatnonzero(~solved):
        answer = _evenest(edges[index, present[index]])
        if answer is not None:
            answers[0][index], answers[1][index, present[index]], answers[2][index] = answer
    return answers


def _by_simplex(
    edges: np.ndarray, present: np.ndarray, indices: np.ndarray, answers: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    """Store the simplex method's answers, and return the mask of programs that it solved or proved infeasible."""
    programs, count = present.shape
    total = present.sum(1)
    shares = np.concatenate([edges.sum(1) / total[:, None], np.ones((programs, 1))], 1)
    columns = np.concatenate([edges, np.ones((programs, count, 1))], 2)
    columns = np.ascontiguousarray(np.moveaxis(np.concatenate([columns, shares[:, None], -shares[:, None]], 1), 0, -1))
    available = np.concatenate([present, np.ones((programs, 2), bool)], 1).T
    bases = SimplexBases.artificial(np.tile(np.eye(7)[6][:, None], programs), 1.0)
    costs = np.zeros((count + 2, programs))
    ended = _to_optimum(bases, columns, available, costs)
    infeasible = ended & (bases.left_over() > BALANCED)
    costs[count:] = np.array([[-1], [1]])
    names = np.maximum(bases.columns, 0)
    bases.costs[:] = np.where(bases.columns < 0, 0, np.take_along_axis(costs, names, 0))
    ended &= infeasible | _to_optimum(bases, columns, available & ~infeasible, costs)
    amounts = np.zeros(available.shape)
    row, program = np.nonzero(bases.columns >= 0)
    amounts[bases.columns[row, program], program] = bases.amounts[row, program]
    value = amounts[count] - amounts[count + 1]
    weights = np.where(present, amounts[:count].T + (value / total)[:, None], 0)
    error = np.abs(np.matmul(weights[:, None], edges)[:, 0]).max(1) + np.abs(weights.sum(1) - 1)
    verified = ended & ~infeasible & (error <= BALANCED * (1 + np.abs(value)))
    answers[0][indices[verified]], answers[1][indices[verified]] = value[verified], weights[verified]
    answers[2][indices[verified]] = bases.multipliers()[:6, verified].T
    return verified | infeasible


def _to_optimum(bases: SimplexBases, columns: np.ndarray, available: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Pivot until no column of ``(k, 7, L)`` is worth taking in; return the mask of programs that got so far."""
    programs = columns.shape[-1]
    remaining, ended = np.arange(programs), np.zeros(programs, bool)
    active = bases
    for _ in range(PIVOTS):
        gains = np.where(available, np.einsum("kjl,jl->kl", columns, active.multipliers()) - costs, -np.inf)
        best, numbers = np.argmax(gains, 0), np.arange(len(remaining))
        improving = gains[best, numbers] > OPTIMAL
        if not improving.all():
            unfinished, finished = np.flatnonzero(improving), np.flatnonzero(~improving)
            ended[remaining[finished]] = True
            bases.put(remaining[finished], active.take(finished))
            if not len(unfinished):
                break
            remaining, best, numbers, active = (
                remaining[unfinished],
                best[unfinished],
                numbers[: len(unfinished)],
                active.take(unfinished),
            )
            columns, available, costs = (np.take(array, unfinished, -1) for array in (columns, available, costs))
        entering = np.take_along_axis(columns, best[None, None], 0)[0]
        if (active.enter(entering, costs[best, numbers], best) < 0).any():
            break
    bases.put(remaining, active)
    return ended


def _evenest(edges: np.ndarray) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Solve for value, weights and multipliers of edges ``(m, 6)`` with HiGHS; None where it fails."""
    from scipy.optimize import linprog

    count = len(edges)
    program = linprog(
        np.append(np.zeros(count), -1.0),
        A_eq=np.vstack([np.column_stack([edges.T, edges.sum(0) / count]), np.append(np.ones(count), 1.0)]),
        b_eq=np.eye(7)[6],
        bounds=[(0, None)] * count + [(None, None)],
        method="highs-ds",
        options={"primal_feasibility_tolerance": FEASIBLE, "dual_feasibility_tolerance": FEASIBLE},
    )
    if program.status != 0:
        return None
    above, value = program.x[:-1], float(program.x[-1])
    return value, above + value / count, program.eqlin.marginals[:6]
