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
from jaxgrasp.problem.batch_last import ProblemBatch, squeezing_forces
from jaxgrasp.problem.scaled_problem import ScaledProblem, in_axes_by_care, in_suitable_axes
from jaxgrasp.problem.scaling import multiplier_to_scaled
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import pseudo_inverse, torque_passes
from jaxgrasp.solver.infeasibility import out_of_range
from jaxgrasp.solver.proximal import (
    STEPS_PER_LEVEL,
    PassSettings,
    ProximalState,
    UnlimitedProblem,
    initial_state,
    proximal_search,
)
from jaxgrasp.solver.result import PassResult, ScaledResult, to_result

CAREFUL_TILE = 16
STEPS = (5, 6, 30)
"""Evaluations that each fast pass may spend; after each of them the unfinished are gathered again."""


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
    bare = torque_passes.without_torques(problem)
    outside = closed.verdict == Verdict.OUTSIDE_CONES
    # What the fast passes do not suit is not converged from the outset.
    verdict = jnp.where(closed.undecided, Verdict.NOT_CONVERGED, closed.verdict)
    result = closed._replace(verdict=verdict, undecided=closed.undecided | outside)
    if problem.start is not None:
        # One that is no number, as of a problem that had none, is none to begin from.
        given = outside & jnp.all(jnp.isfinite(problem.start), 1)
        result = result._replace(multiplier=jnp.where(given[:, None], problem.start, result.multiplier))

    def improve(index: Array, result: PassResult) -> PassResult:
        settings = PassSettings(index == len(STEPS), jnp.asarray((*STEPS, STEPS_PER_LEVEL), jnp.int32)[index])
        chosen = result.undecided & (settings.careful | (result.verdict == Verdict.OUTSIDE_CONES))
        tile = partial(_optimum_tile, settings=settings)
        return over_chosen(tile, bare, result, chosen, _newton_width(bare))

    # A loop rather than several calls: all passes, the careful one too, are one piece of compiled code.
    result = lax.fori_loop(0, len(STEPS) + 1, improve, varying_like(result, bare))
    return torque_passes.within_torques(problem, result)


def _closed_width(problem: ProblemBatch) -> int:
    """Problems in a tile: as many as stay in the cache."""
    return 128 if problem.points.shape[1] <= 10 else 64


def _newton_width(problem: ProblemBatch) -> int:
    """Problems in a tile: few, since all wait for the slowest, and so few that a step's work stays in the cache."""
    contacts = problem.points.shape[1]
    return max(16, min(64, 2 ** int(math.log2(200 / contacts))))


def _closed_tile(problem: ProblemBatch) -> PassResult:
    return _closed_result(in_suitable_axes(problem))


@fused_cpu_kernel
def _closed_result(problem: ScaledProblem) -> PassResult:
    ill_conditioned = problem.ill_conditioned
    multiplier = pseudo_inverse.refined_multiplier(problem)
    forces = pseudo_inverse.forces_without_cones(problem, multiplier)
    missed, direction = _out_of_range(problem, ill_conditioned)
    inside = vec3.every(friction_cone.contains(forces, problem.data.cone))
    verdict = jnp.where(inside, Verdict.CLOSED_FORM_OPTIMAL, Verdict.OUTSIDE_CONES)
    verdict = jnp.where(missed, Verdict.INFEASIBLE, verdict)
    undecided = ill_conditioned & (verdict == Verdict.OUTSIDE_CONES)
    found = ScaledResult(forces, multiplier, verdict, jnp.zeros_like(verdict), direction, undecided)
    return to_result(problem, found, jnp.where(ill_conditioned, Route.CAREFUL, Route.CLOSED_FORM))


@fused_cpu_kernel
def _out_of_range(problem: ScaledProblem, suspects: Array) -> tuple[Array, SpatialVec]:
    """Which of the ``suspects`` are asked for what no contact reaches; contacts of the others reach everything."""
    data = problem.data
    none = jnp.zeros((1, data.force.x.shape[-1]), bool), spatial.join(data.force, data.torque) * 0

    def search(_, none: tuple[Array, SpatialVec]) -> tuple[Array, SpatialVec]:
        missed, direction = out_of_range(problem)
        return none[0] | missed & suspects, none[1] + direction

    return lax.fori_loop(0, jnp.any(suspects).astype(jnp.int32), search, varying_like(none, data, problem.scaling))


def _optimum_tile(batch: ProblemBatch, prior: PassResult, settings: PassSettings) -> PassResult:
    """The optimum, as far as one pass goes.

    The fast passes begin where the last one stopped; what they do not finish stays undecided, and keeps OUTSIDE_CONES
    if more of the same may help. The careful one begins at the beginning.
    """
    careful = settings.careful
    problem = in_axes_by_care(batch, careful)
    missed, direction = _out_of_range(problem, careful)
    last = spatial.join(*multiplier_to_scaled(prior.multiplier, problem.scaling))
    point = jnp.where(careful, 0, last)
    verdict = jnp.where(missed, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED)
    start = initial_state(point, squeezing_forces(problem.data), verdict, problem.ill_conditioned | missed)
    found = proximal_search(UnlimitedProblem(problem), start._replace(certificate=direction), settings)
    return _optimum_result(problem, found, careful, prior.steps)


@fused_cpu_kernel
def _optimum_result(problem: ScaledProblem, state: ProximalState, careful: Array, before: Array) -> PassResult:
    converged = state.verdict == Verdict.OPTIMAL
    steps = state.steps + jnp.where(careful, 0, before)[None]
    found = ScaledResult(state.forces, state.point, state.verdict, steps, state.certificate, ~converged)
    result = to_result(problem, found, jnp.where(careful, Route.CAREFUL, Route.FAST))
    # An answer that its own residual disowns goes to the careful pass, like one that is stalled.
    undecided = ~careful & (result.undecided | (result.verdict == Verdict.NOT_CONVERGED))
    more = undecided & ~(state.stalled | converged | problem.ill_conditioned)[0]
    return result._replace(verdict=jnp.where(more, Verdict.OUTSIDE_CONES, result.verdict), undecided=undecided)
