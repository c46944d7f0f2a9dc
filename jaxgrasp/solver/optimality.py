"""Checks that forces and multiplier are the optimum: residual and duality gap against their tolerances."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.coordinates import squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.result import Measurement, measure_forces

LOOSE_FACTOR = 16.0
"""Factor on the tolerances at the end of the search: near the limit of what the contacts can exert, the multiplier is
so large that its own rounding stands in the way."""


class OptimalityMeasures(NamedTuple):
    """Measures of a point by which it is compared with the tolerances; all but the first three ``(1, B)``."""

    data: ContactData
    point: Array
    residual: Array
    """The dual's gradient w - G f in the coordinates; with limits of torques, the excess of each torque below it."""
    squared_norm: Array
    """Squared norm of the residual in the inverse metric."""
    objective: Array
    """Dual value, or objective of the candidate forces."""
    total_normal_force: Array


def has_converged(measures: OptimalityMeasures, slack: float = 1.0) -> Array:
    """Return a mask of points whose residual and duality gap are within ``slack`` times the tolerances.

    The tolerances are what rounding of forces of this size leaves (``tolerances.gradient``, ``tolerances.gap``).
    """
    tol = tolerances(measures.objective.dtype)
    return is_within(measures, slack * tol.gradient, slack * tol.gap)


def is_within(measures: OptimalityMeasures, residual_tolerance: float, gap_tolerance: float) -> Array:
    """Return a mask of points whose residual, relative to the forces, and gap, relative to the objective, are small.

    The duality gap is |x.g|: the objective of the candidate forces less the dual value w.x + L(f, x), for the
    multiplier x and the residual g = w - G f.
    """
    gap = jnp.abs(spatial.inner(measures.point, measures.residual))
    small_gap = gap <= gap_tolerance * dual.gap_scale(measures.data, measures.objective)
    return is_small(measures.squared_norm, measures.total_normal_force, residual_tolerance) & small_gap


def is_small(squared_norm: Array, total_normal_force: Array, residual_tolerance: float) -> Array:
    """Return a mask of residuals with |g|^2 <= (tolerance * (1 + sum of normal forces))^2."""
    return squared_norm <= (residual_tolerance * (1 + total_normal_force)) ** 2


class OptimalityCheck(NamedTuple):
    """Forces of a multiplier, and masks ``(1, B)`` of the problems of which they are the optimum."""

    forces: ContactVec
    optimal: Array
    loosely_optimal: Array
    """The optimum within ``LOOSE_FACTOR`` times the tolerances."""
    relative_residual: Array
    """The part of the load that the forces miss."""
    residual: Array
    """w - G f in the coordinates; with limits of torques, the excess of each torque below it."""


def without_recomputation(forces: ContactVec) -> ContactVec:
    """Return the forces behind an optimisation barrier, so that XLA does not recompute them with other rounding."""
    return lax.optimization_barrier(forces)


@fused_cpu_kernel
def check_optimality(problem: ScaledProblem, point: SpatialVec) -> OptimalityCheck:
    """Return the candidate forces of ``point`` and whether they balance the wrench, so that both are optimal."""
    forces = without_recomputation(dual.candidate_forces(problem, point).forces)
    measured = measure_forces(problem, forces)
    residual = problem.coordinates.wrench(*spatial.parts(measured.residual))
    norm = squared_norm(problem.metric, residual)
    return compare_with_tolerances(problem.data, forces, point, residual, norm, measured)


def compare_with_tolerances(
    data: ContactData, forces: ContactVec, point: Array, residual: Array, squared_norm: Array, measured: Measurement
) -> OptimalityCheck:
    """Return the check of candidate forces whose residual, and its squared norm, are known."""
    measures = OptimalityMeasures(data, point, residual, squared_norm, measured.objective, measured.total_normal_force)
    optimal, loosely_optimal = has_converged(measures), has_converged(measures, LOOSE_FACTOR)
    return OptimalityCheck(forces, optimal, loosely_optimal, measured.relative_residual, residual)
