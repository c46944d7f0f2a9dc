"""The dual of the constrained optimum as a function of its multiplier, in plain JAX.

For the cones K_i and the multiplier x, a virtual twist about the frame's origin,

    q(x) = w.x + sum of  min over f in K_i of  |f - s_i a_i|^2 / (2 k_i) - f.(G_i^T x).

It is concave, its gradient is w - G f(x), and by weak duality no allowed forces that balance w cost less.
"""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import ProblemBatch, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.flatten import Sharing
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import dual
from jaxgrasp.solver.dispatch import dispatch


def dual_value(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    multiplier: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
) -> Float[Array, "..."]:
    """Compute the dual value of any multiplier, a lower bound of the constrained optimum's objective.

    At the optimum's own multiplier it equals ``Solution.objective``. Differentiable any number of times, by
    every argument; where a contact's force meets its cone's surface or apex, second derivatives are those of
    one side.

    Args:
        grasp: contacts ``(..., n)``; all leading axes broadcast.
        wrench: what the contacts must exert ``(..., 6)`` [N, N.m].
        multiplier: linear over angular ``(..., 6)``, about the frame's origin, as in a Solution.
        sharing: as for [`jaxgrasp.closed_form`][].

    Returns:
        ``(...)`` in the objective's units [N^2 over those of the weights]; NaN where the data are not usable.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,)), "multiplier": (multiplier, (6,))}, {})
    return dispatch(_evaluate, grasp, wrench, sharing, multiplier=multiplier)[0]


def multiplier_forces(
    grasp: Grasp, multiplier: Float[AnyArray, "*#batch 6"], sharing: Sharing = "squeeze"
) -> Float[Array, "... n 3"]:
    """Compute the forces that minimise the Lagrangian at a multiplier, each contact's inside its cone.

    f_i is the projection of s_i a_i + k_i G_i^T multiplier on cone i: a force that friction allows, whether or
    not it balances anything. At the optimum's own multiplier these are its forces.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the multiplier's.
        multiplier: linear over angular ``(..., 6)``, about the frame's origin, as in a Solution.
        sharing: as for [`jaxgrasp.closed_form`][].

    Returns:
        ``(..., n, 3)`` [N]; zero for absent contacts, NaN where the data are not usable.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
    """
    check_arguments(grasp, {"multiplier": (multiplier, (6,))}, {})
    return dispatch(_evaluate, grasp, jnp.zeros(6, int), sharing, multiplier=multiplier)[1]


def _evaluate(problem: ProblemBatch, multiplier: Array) -> tuple[Array, Array]:
    """Compute dual value and forces in the user's own coordinates: the multiplier has no more digits in any others."""
    data, valid = to_batch_last(problem)
    value, best = _value_and_forces(dual.plain_problem(data), multiplier.T)
    forces = jnp.stack([jnp.where(valid, c, jnp.nan) for c in best.linear]).transpose(2, 1, 0)
    return jnp.where(valid, value, jnp.nan)[0], forces


def _value_and_forces(problem: dual.PlainProblem, multiplier: SpatialVec) -> tuple[Array, ContactVec]:
    data = problem.data
    best = dual.candidate_forces(problem, multiplier)
    work = spatial.inner(dual.required_wrench(problem), multiplier)
    deviation = dual.weighted_deviation(data, best, jnp.ones_like(data.force.x))
    lagrangian_terms = dual.deviation_cost_by(data, best.forces, deviation) - contact_vec.dot(
        best.velocity, best.forces
    )
    return work + jnp.sum(lagrangian_terms, 0, keepdims=True), best.forces
