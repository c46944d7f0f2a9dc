"""Nakamura, Nagai and Yoshikawa: the least internal forces that keep every contact from slipping.

Y. Nakamura, K. Nagai and T. Yoshikawa, "Dynamics and stability in coordination of multiple robotic mechanisms", Int.
J. Robotics Research 8(2), 1989: forces are those of the pseudo-inverse, which balance the wrench, and internal forces
from the null space of the grasp matrix; of the internal forces within the true friction cones those of least norm are
found, a nonlinear program that they solve by Lagrange multipliers.

Known from descriptions in later work. Ours is the way of solving it: the method of multipliers (M. R. Hestenes 1969,
M. J. D. Powell 1969) for cones, where a multiplier is a vector of the dual cone, with Newton steps inside.

The two parts are orthogonal, so that these are the forces of least norm altogether: the constrained optimum without
squeezing forces, shared uniformly.

How it fails: the least forces have no margin; a contact that slips at the pseudo-inverse ends on its cone, and one
that would pull is let go, at the cone's apex. Near the limit of what contacts can exert the multipliers grow without
end and steps run out.
"""

from functools import partial

import jax
import jax.numpy as jnp

from jaxgrasp.literature.batch_problem import BatchResult, solve_all
from jaxgrasp.literature.internal import internal
from jaxgrasp.literature.method_answer import MethodAnswer, MethodStatus
from jaxgrasp.literature.method_input import read_input
from jaxgrasp.literature.multipliers import least_internal
from jaxgrasp.literature.scaled_batch import ScaledBatch
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.validation.checked import checked


@checked
def nakamura(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    *,
    max_rounds: int = 60,
    throw: bool = True,
) -> MethodAnswer:
    """The pseudo-inverse's forces, and the internal forces of least norm that bring them into the friction cones.

    Args:
        grasp: contacts ``(..., n)``, concrete; leading axes broadcast against the wrench's.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        max_rounds: updates of the multipliers allowed.
        throw: whether bad values raise; if not, their problem's status is INVALID_DATA.

    Returns:
        A MethodAnswer, all problems in one call. The objective is the norm of the internal forces [N]; iterations are
        Newton steps, none where the pseudo-inverse is inside the cones. INFEASIBLE where the wrench is out of reach,
        or where the multipliers prove that internal forces would have to be a million times the load.

    Raises:
        ValueError: for an argument that cannot be used.
        GraspError: for data that cannot be used, naming the entry.
    """
    if max_rounds < 1:
        raise ValueError(f"max_rounds is {max_rounds}: expected 1 or more")
    given = read_input(grasp, wrench, throw=throw)
    return solve_all(given, lambda problem, load: _solve(problem, max_rounds), unit=1)


@partial(jax.jit, static_argnames="max_rounds")
def _solve(problem: ScaledBatch, max_rounds: int) -> BatchResult:
    return jax.vmap(partial(_one, max_rounds=max_rounds))(problem)


def _one(problem: ScaledBatch, max_rounds: int) -> BatchResult:
    parts = internal(problem)
    found = least_internal(problem, parts, max_rounds)
    forces = parts.balanced(parts.particular + found.internal, problem.wrench)
    status = jnp.where(found.converged, MethodStatus.SOLVED, MethodStatus.NOT_CONVERGED)
    impossible = ~parts.reached | (found.hopeless & ~found.converged)
    return BatchResult(
        forces=forces.reshape(-1, 3),
        status=jnp.where(impossible, MethodStatus.INFEASIBLE, status),
        objective=jnp.linalg.norm(found.internal),
        iterations=found.steps,
    )
