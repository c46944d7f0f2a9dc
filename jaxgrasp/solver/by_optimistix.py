"""The constrained optimum by a solver from outside, on the same dual, judged by this package's own tests.

The solver sees six coordinates in the principal axes and whitened coordinates of the careful pass, one
problem at a time under ``vmap``. It only proposes a multiplier: what that is worth is measured here.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.solution import Route, Verdict
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.problem import contact_vec, friction_cone
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.scaling import Scaling, scale_in_principal_axes
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import dual, pseudo_inverse
from jaxgrasp.solver.coordinates import Coordinates
from jaxgrasp.solver.guided_motion import whitened_coordinates
from jaxgrasp.solver.infeasibility import find_certificate, out_of_range
from jaxgrasp.solver.newton import has_converged, is_within
from jaxgrasp.solver.pseudo_inverse import Metric, squared_norm
from jaxgrasp.solver.result import PassResult, ScaledResult, to_result

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


def solve_optimum(solver: Any, problem: ProblemBatch) -> PassResult:
    """The constrained optimum of a flat batch by an optimistix solver."""
    return over_tiles(partial(_tile, solver), problem, problem.size, TILE, problem.count)


def write_to_tolerance(
    data: ContactData,
    scaling: Scaling,
    coordinates: Coordinates,
    valid: Array,
    size: int,
    scaled_result: ScaledResult,
    tolerance: float,
) -> PassResult:
    """``result.write``, but an optimum has to balance to ``tolerance`` only: its solver was not asked for more."""
    result = to_result(data, scaling, coordinates, valid, size, scaled_result, Route.GIVEN)
    disowned = (scaled_result.verdict[0] == Verdict.OPTIMAL) & (result.verdict == Verdict.NOT_CONVERGED)
    verdict = jnp.where(disowned & (result.residual <= tolerance), Verdict.OPTIMAL, result.verdict)
    return result._replace(verdict=verdict.astype(jnp.int32))


def _tile(solver: Any, problem: ProblemBatch) -> PassResult:
    data, valid = to_batch_last(problem)
    data, scaling = scale_in_principal_axes(data)
    metric, coordinates = whitened_coordinates(problem, data, scaling)
    start = pseudo_inverse.closed_multiplier(data, coordinates, metric)
    free = pseudo_inverse.forces_without_cones(data, start, coordinates)
    inside = jnp.all(friction_cone.contains(free, data.cone), 0, keepdims=True)
    missed, beyond = out_of_range(data, scaling, coordinates)
    point, steps = _search(solver, data, coordinates, start)
    tolerance = float(max(solver.rtol, solver.atol))
    forces, optimal = _check_optimality(data, coordinates, metric, point, tolerance)
    proven, direction = _find_certificate(data, scaling, coordinates, start, point)
    verdict = jnp.where(optimal, Verdict.OPTIMAL, jnp.where(proven, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED))
    verdict = jnp.where(inside, Verdict.CLOSED_FORM_OPTIMAL, verdict)
    scaled_result = ScaledResult(
        forces=contact_vec.where(inside, free, forces),
        multiplier=jnp.where(inside, start, point),
        verdict=jnp.where(missed, Verdict.INFEASIBLE, verdict),
        steps=jnp.where(inside, 0, steps),
        certificate=jnp.where(missed, beyond, direction),
        undecided=jnp.zeros_like(missed),
    )
    return write_to_tolerance(data, scaling, coordinates, valid, problem.size, scaled_result, tolerance)


def _search(solver: Any, data: ContactData, coordinates: Coordinates, start: SpatialVec) -> tuple[SpatialVec, Array]:
    """Where the solver ends in each problem, and after how many steps; the start where it runs off to infinity."""
    import optimistix as optx

    def one(lane: tuple[ContactData, Coordinates], start: SpatialVec) -> tuple[SpatialVec, Array]:
        found: optx.Solution
        if isinstance(solver, optx.AbstractMinimiser):
            found = optx.minimise(_negative_dual, solver, start, lane, max_steps=MAX_STEPS, throw=False)
        else:
            found = optx.root_find(_gradient, solver, start, lane, max_steps=MAX_STEPS, throw=False)
        return found.value, found.stats["num_steps"][None]

    size = start.shape[-1]
    lane = jax.tree.map(lambda x: jnp.broadcast_to(x, (x.shape[0], size)), (data, coordinates))
    point, steps = jax.vmap(one, in_axes=-1, out_axes=-1)(lane, start)
    finite = jnp.all(jnp.isfinite(point), 0, keepdims=True)
    return jnp.where(finite, point, start), steps


def _gradient(point: SpatialVec, lane: tuple[ContactData, Coordinates]) -> SpatialVec:
    """The dual's gradient; directions that no contact reaches term the multiplier to zero instead of nowhere."""
    data, coordinates = lane
    residual = dual.residual(data, dual.candidate_forces(data, point, coordinates).forces, coordinates)
    return residual - coordinates.unused() * point


def _negative_dual(point: SpatialVec, lane: tuple[ContactData, Coordinates]) -> Array:
    """Minus the dual, whose gradient is minus ``_rest``."""
    data, coordinates = lane
    value = dual.dual_value(data, dual.candidate_forces(data, point, coordinates), point, coordinates)
    return jnp.sum(coordinates.unused() * point**2) / 2 - value[0]


def _check_optimality(
    data: ContactData, coordinates: Coordinates, metric: Metric, point: SpatialVec, tolerance: float
) -> tuple[ContactVec, Array]:
    """The forces of a multiplier, and whether residual and duality gap are within ``tolerance``, or rounding."""
    best = dual.candidate_forces(data, point, coordinates)
    residual = dual.residual(data, best.forces, coordinates)
    value, total_normal_force = (
        dual.dual_value(data, best, point, coordinates),
        dual.total_normal_force(data, best.forces),
    )
    found = (data, point, residual, squared_norm(metric, residual), value, total_normal_force)
    return best.forces, is_within(*found, tolerance, tolerance) | has_converged(*found)


def _find_certificate(
    data: ContactData, scaling: Scaling, coordinates: Coordinates, start: SpatialVec, point: SpatialVec
) -> tuple[Array, SpatialVec]:
    """Whether what is left of the wrench, or the way the multiplier ran, proves that there is no solution."""
    residual = dual.residual(data, dual.candidate_forces(data, point, coordinates).forces, coordinates)
    return find_certificate(data, scaling, coordinates, residual, point - start)
