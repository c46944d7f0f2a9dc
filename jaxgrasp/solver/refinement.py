"""Forces brought to balance where their multiplier's own rounding stands in the way.

The candidate forces s a + k v are differences: where the squeezing forces nearly cancel, as under a light load that
no squeezing can hold, an error of rounding in the multiplier is as large as the forces themselves. From the targets
that a multiplier gives, Newton's method goes on with corrections to these targets, which are small numbers with all
their digits. Rounding of the targets does no harm: it stands for squeezing forces that differ by as little.
"""

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Verdict
from jaxgrasp.numerics import ldl
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.metric import squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.spatial import SpatialVec, parts
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.newton import LOOSE_FACTOR, damped, is_small, without_recomputation
from jaxgrasp.solver.proximal import ProximalState
from jaxgrasp.solver.result import measure_forces

REFINING_STEPS = 4
"""Newton steps: the digits double with each, and the first starts from about half of them."""
CORRECTIONS = 3
"""Steps of the forces themselves, along their cones, after that."""
ENOUGH = 0.25
"""Part of the largest residual of a sound answer at which none is refined."""
_Carry = tuple[ContactVec, ContactVec, Array, Array, ProximalState]


@fused_cpu_kernel
def refined(problem: ScaledProblem, state: ProximalState, careful: Array) -> ProximalState:
    """The state with the forces of an optimum brought to balance where they miss their load.

    As ``careful``, what has come to its end without having converged is tried too.
    """
    data, tol = problem.data, tolerances(state.relative_residual.dtype)
    enough = ENOUGH * tol.balance
    rounding = jnp.asarray(16 * jnp.finfo(state.relative_residual.dtype).eps, state.relative_residual.dtype)
    wanting = (state.verdict == Verdict.OPTIMAL) & (state.relative_residual > enough)
    wanting = wanting | (careful & (state.verdict == Verdict.NOT_CONVERGED) & (state.strength == 0))

    def step(i: Array, carry: _Carry) -> _Carry:
        target, corrected, point, wanting, state = carry
        split = friction_cone.decompose(target, data.cone)
        nearest = friction_cone.project(target, data.cone, split)
        forces = without_recomputation(contact_vec.where(i <= REFINING_STEPS, nearest, corrected))
        found = measure_forces(problem, forces)
        left = problem.coordinates.wrench(*parts(found.residual))
        small = is_small(squared_norm(problem.metric, left), found.total_normal_force, LOOSE_FACTOR * tol.gradient)
        good = wanting & (found.relative_residual <= enough) & small & _costs_least(problem, found.objective, point)
        state = state._replace(
            point=jnp.where(good, point, state.point),
            forces=contact_vec.where(good, forces, state.forces),
            verdict=jnp.where(good, Verdict.OPTIMAL, state.verdict),
            steps=state.steps + wanting.astype(jnp.int32),
        )
        jacobian = friction_cone.derivative(data.cone, split)
        curvature = dual.negative_hessian(problem, jacobian)
        more = dual.solve(ldl.factor(damped(curvature, problem.metric, rounding)), left)
        moved = contact_vec.scale(data.weights, dual.contact_velocities(problem, more))
        along = contact_vec.of_components(ldl.multiply(jacobian, contact_vec.components(moved)))
        beyond = contact_vec.add(forces, along)
        corrected = friction_cone.project(beyond, data.cone, friction_cone.decompose(beyond, data.cone))
        more_target = i < REFINING_STEPS
        target = contact_vec.where(more_target, contact_vec.add(target, moved), target)
        return target, corrected, jnp.where(more_target, point + more, point), wanting & ~good, state

    target = dual.target_forces(data, dual.contact_velocities(problem, state.point))
    start = varying_like((target, target, state.point, wanting, state), problem, state)
    trips = jnp.where(jnp.any(wanting), REFINING_STEPS + CORRECTIONS + 1, 0)
    return lax.fori_loop(0, trips, step, start)[-1]


def _costs_least(problem: ScaledProblem, objective: Array, point: SpatialVec) -> Array:
    """Whether an objective is what the dual at ``point`` proves to be least, within the gap of an optimum.

    The forces have left those that the point stands for, so that their residual alone does not tell.
    """
    least = dual.dual_value(problem, dual.candidate_forces(problem, point), point)
    gap = LOOSE_FACTOR * tolerances(objective.dtype).gap
    return objective - least <= gap * dual.gap_scale(problem.data, objective)
