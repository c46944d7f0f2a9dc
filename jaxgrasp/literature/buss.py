"""Buss, Hashimoto and Moore: friction cones as positive definite matrices, effort traded against margin.

M. Buss, H. Hashimoto and J. B. Moore, "Dextrous hand grasping force optimization", IEEE Trans. Robotics and Automation
12(3), 1996: with P_i = [[mu f_n, 0, f_1], [0, mu f_n, f_2], [f_1, f_2, mu f_n]] for the force of contact i in its own
axes, the force lies inside the true cone exactly where P_i is positive definite. The balance of forces is linear in
P = diag(P_i). They minimise tr(W_p P) + tr(W_b P^-1), effort and a barrier that keeps a margin, by a gradient flow
within the linear constraints, which a strictly feasible start never leaves. M. Buss, L. Faybusovich and J. B. Moore,
"Dikin-type algorithms for dextrous grasping force optimization", Int. J. Robotics Research 17(8), 1998, measure
gradients by P^-1, as Dikin's ellipsoids do, with far fewer steps.

Known from descriptions in later work. Ours: both weights are multiples of the identity; steps are the best of a
geometric series, from far outside Dikin's ellipsoid to well inside it; and the start, for which the same Dikin steps
lower s in P + s I > 0 until s < 0, or until their multipliers prove that it cannot be.

How it fails: a contact without friction, or one that can carry no force, leaves nothing strictly inside the cones:
then there is no start (INFEASIBLE, or NOT_CONVERGED without a proof), though allowed forces may exist. The gradient
flow crawls; either flow ends where its value falls no more, which leaves forces right to about a millionth. The
trade-off has a unit, so that what is a fair margin for one load is none for a larger one.
"""

from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.literature.batch_problem import BatchResult, ScaledBatch, solve_all
from jaxgrasp.literature.internal import internal
from jaxgrasp.literature.method_answer import MethodAnswer, MethodStatus
from jaxgrasp.literature.method_input import read_input
from jaxgrasp.literature.positive_definite import Trade, descend, first_inside, own_axes
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked


@checked
def buss(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    effort: float = 1.0,
    margin: float = 1.0,
    flow: Literal["dikin", "gradient"] = "dikin",
    max_steps: int = 500,
    throw: bool = True,
) -> MethodAnswer:
    """Forces of least effort tr(P) + margin tr(P^-1), strictly inside the friction cones.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        effort: weight of tr(P), three times the sum of mu f_n, above 0.
        margin: weight of tr(P^-1), above 0 [N^2]: the larger, the farther from slipping, and the harder the grip.
        flow: ``"dikin"`` (1998), or ``"gradient"`` (1996), which takes very many steps.
        max_steps: of the flow, and of the search for its start.
        throw: whether bad values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer, all problems in one call, whose objective is the weighted sum [N], and whose iterations are
        steps, those that lead to the start among them.

    Raises:
        ValueError: for an argument that cannot be used.
        GraspError: for data that cannot be used, naming the entry.
    """
    for name, weight in (("effort", effort), ("margin", margin)):
        if not 0 < weight < np.inf:
            raise ValueError(f"{name} is {weight}: expected a finite number above 0")
    if flow not in ("dikin", "gradient"):
        raise ValueError(f"flow is {flow!r}: expected 'dikin' or 'gradient'")
    if max_steps < 1:
        raise ValueError(f"max_steps is {max_steps}: expected 1 or more")
    given = read_input(grasp, wrench, throw=throw)
    # In units of the load the margin's weight, a square of forces, shrinks with the load's square.
    return solve_all(
        given,
        lambda problem, load: _solve(problem, jnp.full_like(load, effort), margin / load**2, flow, max_steps),
        unit=1,
    )


@partial(jax.jit, static_argnames=("flow", "max_steps"))
def _solve(problem: ScaledBatch, effort: Array, margin: Array, flow: str, max_steps: int) -> BatchResult:
    return jax.vmap(partial(_one, flow=flow, max_steps=max_steps))(problem, effort, margin)


def _one(problem: ScaledBatch, effort: Array, margin: Array, flow: str, max_steps: int) -> BatchResult:
    parts = internal(problem)
    axes = own_axes(problem)
    start = first_inside(problem, parts, axes, max_steps)
    inside = start.found & parts.reached
    end = descend(problem, parts, axes, Trade(effort, margin), start.internal, inside, flow == "gradient", max_steps)
    forces = parts.balanced(parts.particular + end.internal, problem.wrench)
    impossible = ~parts.reached | (start.hopeless & ~start.found)
    # Without any contact nothing balances nothing.
    nobody = ~(problem.present > 0.5).any()
    solved = jnp.where(inside & end.converged, MethodStatus.SOLVED, MethodStatus.NOT_CONVERGED)
    status = jnp.where(impossible, MethodStatus.INFEASIBLE, jnp.where(nobody, MethodStatus.SOLVED, solved))
    return BatchResult(forces.reshape(-1, 3), status, jnp.where(nobody, 0, end.value), start.steps + end.steps)
