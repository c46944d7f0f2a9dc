"""The constrained optimum by an optimistix solver, on the same dual, judged by this package's own tests.

The solver sees six coordinates in the principal axes and whitened coordinates of the robust phases, one
problem at a time under ``vmap``. It only proposes a multiplier: what that is worth is measured here.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.solution import Route
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.coordinates import squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem, in_principal_axes
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import dual, pseudo_inverse
from jaxgrasp.solver.dual import PlainProblem
from jaxgrasp.solver.infeasibility import find_certificate, out_of_range
from jaxgrasp.solver.optimality import OptimalityMeasures, has_converged, is_within
from jaxgrasp.solver.result import Certificate, Findings, PhaseResult, ScaledSolution, to_result

MAX_STEPS = 256
TILE = 128
"""Problems that run together: each waits for the slowest of its tile."""


def check_solver(solver: Any) -> None:
    """Raise TypeError unless ``solver`` is one that ``solve_optimum`` can use."""
    import optimistix as optx

    kinds = (optx.AbstractRootFinder, optx.AbstractLeastSquaresSolver, optx.AbstractMinimiser)
    if not isinstance(solver, kinds):
        raise TypeError(
            f"solver is {solver!r}: expected None, or an optimistix root finder, least-squares solver or minimiser, "
            "such as optimistix.Newton(rtol=1e-8, atol=1e-8)"
        )
    try:
        hash(solver)
    except TypeError:
        raise TypeError(f"solver {type(solver).__name__} holds arrays: expected settings in Python numbers") from None


def solve_optimum(solver: Any, problem: ProblemBatch) -> PhaseResult:
    """Return the constrained optimum of a flat batch by an optimistix solver."""
    return over_tiles(partial(_tile, solver), problem, problem.size, TILE, problem.count)


def _tile(solver: Any, batch: ProblemBatch) -> PhaseResult:
    problem = in_principal_axes(batch)
    start = pseudo_inverse.closed_multiplier(problem)
    free = pseudo_inverse.forces_without_cones(problem, start)
    inside = jnp.all(friction_cone.contains(free, problem.data.cone), 0, keepdims=True)
    beyond = out_of_range(problem)
    unreachable = beyond.force_bound > 0
    point, steps = _search(solver, problem, start)
    tolerance = float(max(solver.rtol, solver.atol))
    forces, optimal = _check_optimality(problem, point, tolerance)
    certificate = _find_certificate(problem, start, point)
    infeasible = unreachable | (certificate.force_bound > 0) & ~optimal & ~inside
    solution = ScaledSolution(
        forces=contact_vec.where(inside, free, forces),
        multiplier=jnp.where(inside, start, point),
        findings=Findings(infeasible, optimal=optimal | inside, closed_form=inside),
        steps=jnp.where(inside, 0, steps),
        certificate=jax.tree.map(partial(jnp.where, unreachable), beyond, certificate),
        undecided=jnp.zeros_like(unreachable),
    )
    # An optimum has to balance to the tolerance only: its solver was not asked for more.
    return to_result(problem, solution, Route.GIVEN, balance=tolerance)


def _search(solver: Any, problem: ScaledProblem, start: SpatialVec) -> tuple[SpatialVec, Array]:
    """Return the solver's last point in each problem, or the start where it runs off to infinity, and its steps."""
    import optimistix as optx

    def solve_one(problem: PlainProblem, start: SpatialVec) -> tuple[SpatialVec, Array]:
        result: optx.Solution
        if isinstance(solver, optx.AbstractMinimiser):
            result = optx.minimise(_negative_dual, solver, start, problem, max_steps=MAX_STEPS, throw=False)
        else:
            result = optx.root_find(_gradient, solver, start, problem, max_steps=MAX_STEPS, throw=False)
        return result.value, result.stats["num_steps"][None]

    size = start.shape[-1]
    problems = PlainProblem(problem.data, problem.coordinates)
    problems = jax.tree.map(lambda x: jnp.broadcast_to(x, (x.shape[0], size)), problems)
    point, steps = jax.vmap(solve_one, in_axes=-1, out_axes=-1)(problems, start)
    finite = jnp.all(jnp.isfinite(point), 0, keepdims=True)
    return jnp.where(finite, point, start), steps


def _gradient(point: SpatialVec, problem: PlainProblem) -> SpatialVec:
    """Return the dual's gradient w - G f, less x along directions that no contact reaches, where it would be zero."""
    residual = dual.residual(problem, dual.candidate_forces(problem, point).forces)
    return residual - problem.coordinates.unused() * point


def _negative_dual(point: SpatialVec, problem: PlainProblem) -> Array:
    """Minus the dual, whose gradient is minus ``_gradient``."""
    value = dual.dual_value(problem, dual.candidate_forces(problem, point), point)
    return jnp.sum(problem.coordinates.unused() * point**2) / 2 - value[0]


def _check_optimality(problem: ScaledProblem, point: SpatialVec, tolerance: float) -> tuple[ContactVec, Array]:
    """Return the forces of a multiplier, and whether residual and duality gap are within ``tolerance``, or rounding."""
    best = dual.candidate_forces(problem, point)
    residual = dual.residual(problem, best.forces)
    value = dual.dual_value(problem, best, point)
    total_normal_force = dual.total_normal_force(problem.data, best.forces)
    norm = squared_norm(problem.metric, residual)
    measures = OptimalityMeasures(problem.data, point, residual, norm, value, total_normal_force)
    return best.forces, is_within(measures, tolerance, tolerance) | has_converged(measures)


def _find_certificate(problem: ScaledProblem, start: SpatialVec, point: SpatialVec) -> Certificate:
    """Return a proof of infeasibility from the residual of ``point``, or from the multiplier's displacement."""
    residual = dual.residual(problem, dual.candidate_forces(problem, point).forces)
    return find_certificate(problem, residual, point - start)
