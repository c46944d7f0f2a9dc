"""The flat batch solvers: a fast pass over every problem, then more work for the few that need it.

1. The closed form of all, carefully where the contacts are nearly in line. What lies inside every cone is the
   constrained optimum already.
2. Newton on the dual for those outside their cones, first a few steps, then, gathered again, more.
3. The careful pass for the rest: principal axes, whitened coordinates, a proximal term that falls away,
   and a proof where no forces exist.
"""

import math
from functools import partial

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Route, Verdict
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.numerics.tiling import over_chosen, over_tiles
from jaxgrasp.problem import friction_cone, spatial
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, squeezing_forces, to_batch_last
from jaxgrasp.problem.scaling import Scaling, multiplier_to_scaled, scale_in_principal_axes
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import pseudo_inverse, torque_passes
from jaxgrasp.solver.coordinates import Coordinates
from jaxgrasp.solver.guided_motion import whitened_coordinates
from jaxgrasp.solver.infeasibility import out_of_range
from jaxgrasp.solver.proximal import (
    STEPS_PER_LEVEL,
    PassSettings,
    ProximalState,
    UnlimitedProblem,
    initial_state,
    proximal_search,
)
from jaxgrasp.solver.pseudo_inverse import ConditionedProblem, Metric, conditioned
from jaxgrasp.solver.result import PassResult, ScaledResult, to_result

CAREFUL_TILE = 16
STEPS = (5, 6, 30)
"""Evaluations that each Newton stage may spend, after each of which the unfinished are gathered again."""


def solve_closed(problem: ProblemBatch) -> PassResult:
    """The closed form of a flat batch; ``undecided`` where the optimum takes its careful pass at once."""
    tile = _closed_width(problem) if problem.free is None else CAREFUL_TILE
    return over_tiles(_closed_tile, torque_passes.without_torques(problem), problem.size, tile, problem.count)


def solve_optimum(problem: ProblemBatch) -> PassResult:
    """The constrained optimum of a flat batch."""
    return finish_optimum(problem, solve_closed(problem))


def solve_both(problem: ProblemBatch) -> tuple[PassResult, PassResult]:
    """Closed form and constrained optimum, which starts from it."""
    closed = solve_closed(problem)
    return closed, finish_optimum(problem, closed)


def finish_optimum(problem: ProblemBatch, closed: PassResult) -> PassResult:
    """The constrained optimum everywhere, from the closed form."""
    result = _finish_without_torques(torque_passes.without_torques(problem), closed)
    return torque_passes.within_torques(problem, result)


def _finish_without_torques(problem: ProblemBatch, result: PassResult) -> PassResult:
    outside = result.verdict == Verdict.OUTSIDE_CONES
    # What the fast passes do not suit is not converged from the outset.
    verdict = jnp.where(result.undecided, Verdict.NOT_CONVERGED, result.verdict)
    result = result._replace(verdict=verdict, undecided=result.undecided | outside)
    if problem.start is not None:
        # One that is no number, as of a problem that had none, is none to begin from.
        given = outside & jnp.all(jnp.isfinite(problem.start), 1)
        result = result._replace(multiplier=jnp.where(given[:, None], problem.start, result.multiplier))

    def improve(stage: Array, result: PassResult) -> PassResult:
        settings = PassSettings(stage == len(STEPS), jnp.asarray((*STEPS, STEPS_PER_LEVEL), jnp.int32)[stage])
        chosen = result.undecided & (settings.careful | (result.verdict == Verdict.OUTSIDE_CONES))
        tile = partial(_optimum_tile, settings=settings)
        return over_chosen(tile, problem, result, chosen, _newton_width(problem))

    # A loop rather than several calls: all stages, the careful one too, are one piece of compiled code.
    return lax.fori_loop(0, len(STEPS) + 1, improve, varying_like(result, problem))


def _closed_width(problem: ProblemBatch) -> int:
    """Problems in a tile: as many as stay in the cache."""
    return 128 if problem.points.shape[1] <= 10 else 64


def _newton_width(problem: ProblemBatch) -> int:
    """Problems in a tile: few, since all wait for the slowest, and so few that a step's work stays in the cache."""
    contacts = problem.points.shape[1]
    return max(16, min(64, 2 ** int(math.log2(200 / contacts))))


def _closed_tile(problem: ProblemBatch) -> PassResult:
    data, valid = to_batch_last(problem)
    return _closed_answer(_conditioned(problem, data), valid, problem.size)


@fused_cpu_kernel
def _closed_answer(suited: ConditionedProblem, valid: Array, size: int) -> PassResult:
    data, scaling, metric, coordinates, ill_conditioned = suited
    multiplier = pseudo_inverse.refined_multiplier(data, coordinates, metric, ill_conditioned)
    forces = pseudo_inverse.forces_without_cones(data, multiplier, coordinates)
    missed, direction = _out_of_range(data, scaling, coordinates, ill_conditioned)
    inside = vec3.every(friction_cone.contains(forces, data.cone))
    verdict = jnp.where(inside, Verdict.CLOSED_FORM_OPTIMAL, Verdict.OUTSIDE_CONES)
    verdict = jnp.where(missed, Verdict.INFEASIBLE, verdict)
    undecided = ill_conditioned & (verdict == Verdict.OUTSIDE_CONES)
    scaled_result = ScaledResult(forces, multiplier, verdict, jnp.zeros_like(verdict), direction, undecided)
    return to_result(
        data,
        scaling,
        coordinates,
        valid,
        size,
        scaled_result,
        jnp.where(ill_conditioned, Route.CAREFUL, Route.CLOSED_FORM),
    )


def _conditioned(problem: ProblemBatch, data: ContactData) -> ConditionedProblem:
    """Coordinates that suit each problem; where a guide holds the object, with care for all."""
    if problem.free is None:
        return conditioned(data)
    data, scaling = scale_in_principal_axes(data)
    metric, coordinates = whitened_coordinates(problem, data, scaling)
    return ConditionedProblem(data, scaling, metric, coordinates, jnp.ones_like(scaling.load, bool))


@fused_cpu_kernel
def _out_of_range(
    data: ContactData, scaling: Scaling, coordinates: Coordinates, ill_conditioned: Array
) -> tuple[Array, SpatialVec]:
    """Which of the ``ill_conditioned`` problems are asked for what no contact reaches; others have contacts that reach everything."""
    none = jnp.zeros((1, data.force.x.shape[-1]), bool), spatial.join(data.force, data.torque) * 0

    def look(_, none: tuple[Array, SpatialVec]) -> tuple[Array, SpatialVec]:
        missed, direction = out_of_range(data, scaling, coordinates)
        return none[0] | missed & ill_conditioned, none[1] + direction

    return lax.fori_loop(0, jnp.any(ill_conditioned).astype(jnp.int32), look, varying_like(none, data, scaling))


def _optimum_tile(problem: ProblemBatch, prior: PassResult, settings: PassSettings) -> PassResult:
    """The optimum, as far as an effort goes.

    The fast efforts begin where the last one stopped; what they do not finish stays undecided, and keeps OUTSIDE_CONES
    if more of the same may help. The careful one begins at the beginning.
    """
    careful = settings.careful
    data, valid = to_batch_last(problem)
    data, scaling = scale_in_principal_axes(data, careful)
    metric, coordinates, ill_conditioned = _coordinates(problem, data, scaling, careful)
    missed, direction = _out_of_range(data, scaling, coordinates, careful)
    last = spatial.join(*multiplier_to_scaled(prior.multiplier, scaling))
    point = jnp.where(careful, 0, last)
    verdict = jnp.where(missed, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED)
    start_state = initial_state(point, squeezing_forces(data), verdict, ill_conditioned | missed)._replace(
        certificate=direction
    )
    proximal_problem = UnlimitedProblem(data, scaling, coordinates, metric)
    found = proximal_search(proximal_problem, start_state, settings)
    return _optimum_answer(proximal_problem, valid, problem.size, found, careful, ill_conditioned, prior.steps)


@fused_cpu_kernel
def _optimum_answer(
    proximal_problem: UnlimitedProblem,
    valid: Array,
    size: int,
    found: ProximalState,
    careful: Array,
    ill_conditioned: Array,
    before: Array,
) -> PassResult:
    data, scaling, coordinates, _ = proximal_problem
    converged = found.verdict == Verdict.OPTIMAL
    steps = found.steps + jnp.where(careful, 0, before)[None]
    scaled_result = ScaledResult(found.forces, found.point, found.verdict, steps, found.certificate, ~converged)
    result = to_result(
        data, scaling, coordinates, valid, size, scaled_result, jnp.where(careful, Route.CAREFUL, Route.FAST)
    )
    # An answer that its own residual disowns goes to the careful pass, like one that is stuck.
    undecided = ~careful & (result.undecided | (result.verdict == Verdict.NOT_CONVERGED))
    more = undecided & ~(found.stalled | converged | ill_conditioned)[0]
    return result._replace(verdict=jnp.where(more, Verdict.OUTSIDE_CONES, result.verdict), undecided=undecided)


@fused_cpu_kernel
def _coordinates(
    problem: ProblemBatch, data: ContactData, scaling: Scaling, careful: Array
) -> tuple[Metric, Coordinates, Array]:
    """Metric and coordinates, whitened if ``careful``; and which problems they do not suit."""
    if problem.free is None:
        return pseudo_inverse.metric_for(data, scaling, careful)
    metric, coordinates = whitened_coordinates(problem, data, scaling)
    return metric, coordinates, jnp.zeros_like(data.force.x, bool)
