"""Forces brought to balance where their multiplier's own rounding stands in the way.

The candidate forces s a + k v are differences: where the squeezing forces nearly cancel, as under a light load that
no squeezing can hold, an error of rounding in the multiplier is as large as the forces themselves. From the targets
that a multiplier gives, Newton's method goes on with corrections to these targets, which are small numbers with all
their digits. Rounding of the targets does no harm: it stands for squeezing forces that differ by as little.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl
from jaxgrasp.numerics.fused_cpu_kernel import computed_once, fused_cpu_kernel
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.coordinates import add_damping, squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.spatial import SpatialVec, inner, parts
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.optimality import LOOSE_FACTOR, is_small, without_recomputation
from jaxgrasp.solver.proximal import ProximalState
from jaxgrasp.solver.result import measure_forces

REFINING_STEPS = 4
"""Newton steps: the digits double with each, and the first starts from about half of them."""
CORRECTIONS = 3
"""Steps of the forces themselves, along their cones, after that."""
LEAST_DAMPING = 1e-20
"""Damping of the steps of what has not converged, in which friction of next to nothing may bend the dual by no more."""
ENOUGH = 0.25
"""Part of the largest residual of a sound answer at which none is refined."""


class _Refinement(NamedTuple):
    """State of a refinement."""

    aim: ContactVec
    """Point to project on the cones next: targets, then forces moved along their cones."""
    jacobian: Lower
    """The projection's derivative at the last target."""
    point: SpatialVec
    """The multiplier that belongs to the targets."""
    least: Array
    """Dual value there, a lower bound on the objective."""
    needs_refinement: Array
    """Problems still to be refined."""
    state: ProximalState


def needs_refinement(relative_residual: Array, optimal: Array) -> Array:
    """Return a mask of optima whose residual, relative to the load, is larger than a refined answer's."""
    return optimal & (relative_residual > ENOUGH * tolerances(relative_residual.dtype).balance)


@fused_cpu_kernel
def refined(problem: ScaledProblem, state: ProximalState, robust: Array) -> ProximalState:
    """Return the state with the forces of an optimum brought to balance where they miss their load.

    In the ``robust`` phases, a search that ended without having converged is refined too.
    """
    data, tol = problem.data, tolerances(state.relative_residual.dtype)
    target_residual = ENOUGH * tol.balance
    rounding = jnp.asarray(16 * jnp.finfo(state.relative_residual.dtype).eps, state.relative_residual.dtype)
    damping = jnp.where(state.optimal, rounding, LEAST_DAMPING)
    is_unfinished = needs_refinement(state.relative_residual, state.optimal)
    is_unfinished = is_unfinished | (robust & ~state.optimal & ~state.infeasible & (state.strength == 0))

    def step(i: Array, carry: _Refinement) -> _Refinement:
        by_target = i <= REFINING_STEPS
        split = friction_cone.decompose(carry.aim, data.cone)
        forces = without_recomputation(friction_cone.project(carry.aim, data.cone, split))
        measured = measure_forces(problem, forces)
        residual = problem.coordinates.wrench(*parts(measured.residual))
        # Forces of a target minimise the Lagrangian, whose value is then the dual's. Those moved along their cones have
        # left it, so that their residual alone does not tell what they cost.
        least = jnp.where(by_target, measured.objective + inner(carry.point, residual), carry.least)
        gap = LOOSE_FACTOR * tol.gap * dual.gap_scale(data, measured.objective)
        small = is_small(
            squared_norm(problem.metric, residual), measured.total_normal_force, LOOSE_FACTOR * tol.gradient
        )
        is_improved = (
            carry.needs_refinement
            & (measured.relative_residual <= target_residual)
            & small
            & (measured.objective - least <= gap)
        )
        state = carry.state._replace(
            point=jnp.where(is_improved, carry.point, carry.state.point),
            forces=contact_vec.where(is_improved, forces, carry.state.forces),
            optimal=carry.state.optimal | is_improved,
            steps=carry.state.steps + carry.needs_refinement.astype(jnp.int32),
        )
        jacobian = computed_once(
            jax.tree.map(partial(jnp.where, by_target), friction_cone.derivative(data.cone, split), carry.jacobian)
        )
        curvature = dual.negative_hessian(problem, jacobian)
        # dx = (G k D G^T)^-1 (w - G f); the target moves by k G^T dx, the forces by k D G^T dx.
        correction = dual.solve(ldl.factor(add_damping(curvature, problem.metric, damping)), residual)
        moved = contact_vec.scale(data.weights, dual.contact_velocities(problem, correction))
        along = contact_vec.of_components(ldl.multiply(jacobian, contact_vec.components(moved)))
        newton = i < REFINING_STEPS
        aim = contact_vec.where(newton, contact_vec.add(carry.aim, moved), contact_vec.add(forces, along))
        point = jnp.where(newton, carry.point + correction, carry.point)
        return _Refinement(aim, jacobian, point, least, carry.needs_refinement & ~is_improved, state)

    target = dual.target_forces(data, dual.contact_velocities(problem, state.point))
    no_jacobian = jax.tree.map(
        jnp.zeros_like, friction_cone.derivative(data.cone, friction_cone.decompose(target, data.cone))
    )
    start = _Refinement(target, no_jacobian, state.point, 0 * state.relative_residual, is_unfinished, state)
    trips = jnp.where(jnp.any(is_unfinished), REFINING_STEPS + CORRECTIONS + 1, 0)
    return lax.fori_loop(0, trips, step, varying_like(start, problem, state)).state
