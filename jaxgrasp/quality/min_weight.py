"""How evenly the edges of friction pyramids can balance each other: a linear program's measure of force closure."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.quality.grasp_input import read_grasps
from jaxgrasp.quality.summary_line import range_of
from jaxgrasp.quality.wrench_discs import discs, known_where
from jaxgrasp.quality.wrench_sets import check_sides, pyramid
from jaxgrasp.validation.checked import checked

FEASIBLE = 1e-10
"""What HiGHS is asked for, the least it takes."""


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
def min_weight(grasp: Grasp, *, sides: int = 4) -> MinWeight:
    """The largest least weight with which all edges of the friction pyramids balance each other.

    With w_j the wrenches of the m edges, of normal force 1 each: the largest l for which some weights >= l have the
    sum 1 and balance, sum of weight_j w_j = 0; times m, so that 1 says that equal weights balance. It is above zero
    only for grasps that are closed (with pyramids), if the wrenches have rank 6. Neither a length nor a point
    matters. Where several edges bound the answer and it is degenerate, or the multipliers are not unique, it is not
    differentiable there and the multipliers are those of one side.

    Source: Li, Culbertson, Burdick and Ames, FRoGGeR: fast robust grasp generation via the min-weight metric, 2023.

    Args:
        grasp: contacts ``(..., n)``, concrete; a batch is a loop.
        sides: edges of each pyramid, the first one across the coordinate axis that is least along the normal; two
            more for the moments of soft fingers, if there are any.

    Raises:
        GraspError: for the first entry that is not usable, before anything is computed.
        ValueError: for ``sides`` that cannot be used.
        TypeError: for traced arrays.
    """
    check_sides(sides)
    given = read_grasps(grasp)
    corners = pyramid(sides, given.soft)
    edges = given.shapes.centres[..., None, :] + np.einsum("...njc,kc->...nkj", given.shapes.spans, corners)
    shape = given.present.shape
    value, weights = np.full(shape[:-1], -np.inf), np.zeros((*shape, len(corners)))
    twists = np.zeros((*shape[:-1], 6))
    for index, own, _ in given.bodies():
        if not own.any():
            continue
        found = _evenest(edges[index][own].reshape(-1, 6))
        if found is not None:
            value[index], flat, twists[index] = found
            weights[index][own] = flat.reshape(-1, len(corners))
    return MinWeight(value, weights, twists, corners)


@checked
def min_weight_at(grasp: Grasp, found: MinWeight) -> Float[Array, "..."]:
    """The value near a grasp that ``min_weight`` has measured, for derivatives by points, normals and friction.

    By the envelope theorem of linear programs it moves as the multipliers' work on the weighted edges does. First
    derivatives only, and none (NaN) where no weights balance; its value at the grasp measured is ``found.value``.

    Args:
        grasp: the grasp measured, of JAX arrays; works under ``jit``, ``vmap`` and ``grad``.
        found: what ``min_weight`` returned.
    """
    return _worked(grasp, found)


@jax.jit
def _worked(grasp: Grasp, found: MinWeight) -> Array:
    value, weights, twist, corners = (jnp.asarray(array, grasp.points.dtype) for array in found)
    shapes = discs(grasp)
    leans = jnp.einsum("...njc,kc->...nkj", shapes.spans, corners)
    edges = shapes.centres[..., None, :] + leans
    moved = value + jnp.einsum("...nk,...nkj,...j->...", weights, edges, twist)
    return known_where(jnp.isfinite(value), moved, shapes)


def _evenest(edges: np.ndarray) -> tuple[float, np.ndarray, np.ndarray] | None:
    """Value, weights and multipliers for edges ``(m, 6)``; weights are the least one plus what is above it."""
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
