"""Min-weight measure of force closure: the evenness with which edges of friction pyramids balance each other."""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.progress import Progress
from jaxgrasp.problem.wrench_discs import WrenchDiscs, differentiable_where, discs
from jaxgrasp.quality.grasp_input import read_grasps
from jaxgrasp.quality.host_call import call_on_host, is_traced, moved
from jaxgrasp.quality.in_turn import MANY_TOGETHER, in_turn
from jaxgrasp.quality.simplex_steps import SimplexBases
from jaxgrasp.quality.summary_line import range_of
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
    given = read_grasps(grasp)
    corners = pyramid(sides, given.soft)
    bodies = given.bodies()
    value, weights, twists = in_turn(
        len(bodies.present), lambda own: solve_min_weight(bodies.take(own), corners), progress, MANY_TOGETHER
    )
    batch, contacts = given.batch, given.present.shape
    weights = weights.reshape((*contacts, len(corners)))
    return MinWeight(value.reshape(batch), weights, twists.reshape((*batch, 6)), corners)


def _traced(grasp: Grasp, sides: int) -> MinWeight:
    corners = pyramid(sides, grasp.torsion is not None)
    trailing = ((), (grasp.friction.shape[-1], len(corners)), (6,))
    shapes, answers = call_on_host(
        partial(solve_min_weight, corners=corners), trailing, grasp, None, None, together=MANY_TOGETHER
    )
    value, weights, twist = answers
    found: Any = MinWeight(value, weights, twist, corners)
    return found._replace(value=moved(found.value, jnp.where(jnp.isfinite(found.value), _value_at(shapes, found), 0)))


@checked
def min_weight_at(grasp: Grasp, found: MinWeight) -> Float[Array, "..."]:
    """Evaluate the least weight near a grasp measured by ``min_weight``, to differentiate it by the grasp.

    By the envelope theorem of linear programs it moves as the multipliers' work on the weighted edges does. First
    derivatives only, and none (NaN) where no weights balance; its value at the grasp measured is ``found.value``.

    Args:
        grasp: the grasp measured, of JAX arrays; works under ``jit``, ``vmap`` and ``grad``.
        found: what ``min_weight`` returned.
    """
    return _worked(grasp, found)


@jax.jit
def _worked(grasp: Grasp, found: MinWeight) -> Array:
    return _value_at(discs(grasp), found)


def _value_at(shapes: WrenchDiscs, found: MinWeight) -> Array:
    value, weights, twist, corners = (jnp.asarray(array, shapes.centres.dtype) for array in found)
    tangentials = jnp.einsum("...njc,kc->...nkj", shapes.spans, corners)
    edges = shapes.centres[..., None, :] + tangentials
    at = value + jnp.einsum("...nk,...nkj,...j->...", weights, edges, twist)
    return differentiable_where(jnp.isfinite(value), at, shapes)


def solve_min_weight(bodies: WrenchSets, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve for values ``(G,)``, weights ``(G, n * k)`` of the edges and multipliers ``(G, 6)``.

    Columns of the programs are those of the weights above the least, and the value, which may be negative. Programs
    are solved side by side by the simplex method, and what that does not finish by HiGHS.
    """
    pyramids = replace(bodies, corners=corners).alone_edges()
    edges, own = pyramids.discs[:, :, 0], pyramids.present
    grasps = len(edges)
    found = np.full(grasps, -np.inf), np.zeros(own.shape), np.zeros((grasps, 6))
    solved: np.ndarray = np.logical_not(own.any(1))
    some = np.flatnonzero(~solved)
    if len(some):
        solved[some] = _by_simplex(edges[some], own[some], some, found)
    for index in np.flatnonzero(~solved):
        one = _evenest(edges[index, own[index]])
        if one is not None:
            found[0][index], found[1][index, own[index]], found[2][index] = one
    return found


def _by_simplex(
    edges: np.ndarray, own: np.ndarray, places: np.ndarray, found: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    """Write down what the simplex method finds; which programs it solved, those among them that have no answer."""
    programs, count = own.shape
    total = own.sum(1)
    shares = np.concatenate([edges.sum(1) / total[:, None], np.ones((programs, 1))], 1)
    columns = np.concatenate([edges, np.ones((programs, count, 1))], 2)
    columns = np.ascontiguousarray(np.moveaxis(np.concatenate([columns, shares[:, None], -shares[:, None]], 1), 0, -1))
    there = np.concatenate([own, np.ones((programs, 2), bool)], 1).T
    bases = SimplexBases.artificial(np.tile(np.eye(7)[6][:, None], programs), 1.0)
    costs = np.zeros((count + 2, programs))
    ended = _to_optimum(bases, columns, there, costs)
    none = ended & (bases.left_over() > BALANCED)
    costs[count:] = np.array([[-1], [1]])
    names = np.maximum(bases.columns, 0)
    bases.costs[:] = np.where(bases.columns < 0, 0, np.take_along_axis(costs, names, 0))
    ended &= none | _to_optimum(bases, columns, there & ~none, costs)
    amounts = np.zeros(there.shape)
    place, which = np.nonzero(bases.columns >= 0)
    amounts[bases.columns[place, which], which] = bases.amounts[place, which]
    value = amounts[count] - amounts[count + 1]
    weights = np.where(own, amounts[:count].T + (value / total)[:, None], 0)
    missed = np.abs(np.matmul(weights[:, None], edges)[:, 0]).max(1) + np.abs(weights.sum(1) - 1)
    fine = ended & ~none & (missed <= BALANCED * (1 + np.abs(value)))
    found[0][places[fine]], found[1][places[fine]] = value[fine], weights[fine]
    found[2][places[fine]] = bases.multipliers()[:6, fine].T
    return fine | none


def _to_optimum(bases: SimplexBases, columns: np.ndarray, there: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Pivot until no column of ``(k, 7, L)`` is worth taking in; return the mask of programs that got so far."""
    programs = columns.shape[-1]
    left, ended = np.arange(programs), np.zeros(programs, bool)
    some = bases
    for _ in range(PIVOTS):
        worth = np.where(there, np.einsum("kjl,jl->kl", columns, some.multipliers()) - costs, -np.inf)
        best, every = np.argmax(worth, 0), np.arange(len(left))
        improving = worth[best, every] > OPTIMAL
        if not improving.all():
            kept, gone = np.flatnonzero(improving), np.flatnonzero(~improving)
            ended[left[gone]] = True
            bases.put(left[gone], some.take(gone))
            if not len(kept):
                break
            left, best, every, some = left[kept], best[kept], every[: len(kept)], some.take(kept)
            columns, there, costs = (np.take(array, kept, -1) for array in (columns, there, costs))
        entering = np.take_along_axis(columns, best[None, None], 0)[0]
        if (some.enter(entering, costs[best, every], best) < 0).any():
            break
    bases.put(left, some)
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
