"""The flat batch solvers: a fast pass over every problem, then more work for the few that need it.

1. The closed form of all. What lies inside every cone is the constrained optimum already.
2. Newton on the dual for those outside their cones, first a few steps, then, gathered again, more.
3. The careful pass for the rest: principal axes, whitened unknowns, a proximal pull that falls away,
   and a proof where no forces exist.
"""

import math
from functools import partial

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force import cones, limited, pseudo_inverse, sixes
from jaxgrasp.force.answer import Answer, Outcome, write
from jaxgrasp.force.certify import out_of_range
from jaxgrasp.force.fours import Four
from jaxgrasp.force.frame import Frame, multiplier_in, normalise, principal
from jaxgrasp.force.guide import whitened
from jaxgrasp.force.lanes import Lanes, Problem, read, squeezing
from jaxgrasp.force.proximal import STEPS_PER_LEVEL, Effort, Free, Search, begin, full_effort, proximal_search
from jaxgrasp.force.pseudo_inverse import Metric
from jaxgrasp.force.sixes import Six
from jaxgrasp.force.unknowns import Unknowns
from jaxgrasp.model.solution import Route, Verdict
from jaxgrasp.numerics.tiles import over_chosen, over_tiles

TILE = 128
CAREFUL_TILE = 16
STEPS = (5, 6, 30)
"""Evaluations that each Newton stage may spend, after each of which the unfinished are gathered again."""


def solve_closed(problem: Problem) -> Answer:
    """The closed form of a flat batch."""
    if problem.free is not None:
        bare = limited.without_torques(problem)
        return over_tiles(_careful_closed_tile, bare, problem.size, CAREFUL_TILE, problem.count)
    return finish_closed(problem, first_pass(problem))


def solve_optimum(problem: Problem) -> Answer:
    """The constrained optimum of a flat batch."""
    if problem.free is None:
        return finish_optimum(problem, first_pass(problem))
    bare = limited.without_torques(problem)
    tile = partial(_optimum_tile, prior=None, effort=full_effort())
    answer = over_tiles(tile, bare, problem.size, CAREFUL_TILE, problem.count)
    return limited.within_torques(problem, answer)


def solve_both(problem: Problem) -> tuple[Answer, Answer]:
    """Closed form and constrained optimum, which starts from it."""
    if problem.free is not None:
        return solve_closed(problem), solve_optimum(problem)
    first = first_pass(problem)
    return finish_closed(problem, first), finish_optimum(problem, first)


def first_pass(problem: Problem) -> Answer:
    """The closed form of every problem; ``undecided`` where it is too ill-conditioned for this pass."""
    return over_tiles(_closed_tile, limited.without_torques(problem), problem.size, TILE, problem.count)


def finish_closed(problem: Problem, answer: Answer) -> Answer:
    """The closed form everywhere, from the first pass."""
    bare = limited.without_torques(problem)
    return over_chosen(_careful_closed_tile, bare, answer, answer.undecided, CAREFUL_TILE)


def finish_optimum(problem: Problem, answer: Answer) -> Answer:
    """The constrained optimum everywhere, from the first pass."""
    answer = _finish_without_torques(limited.without_torques(problem), answer)
    return limited.within_torques(problem, answer)


def _finish_without_torques(problem: Problem, answer: Answer) -> Answer:
    outside = answer.verdict == Verdict.OUTSIDE_CONES
    answer = answer._replace(undecided=answer.undecided | outside)
    if problem.start is not None:
        # One that is no number, as of a problem that had none, is none to begin from.
        given = outside & jnp.all(jnp.isfinite(problem.start), 1)
        answer = answer._replace(multiplier=jnp.where(given[:, None], problem.start, answer.multiplier))

    def improve(stage: Array, answer: Answer) -> Answer:
        effort = Effort(stage == len(STEPS), jnp.asarray((*STEPS, STEPS_PER_LEVEL))[stage])
        chosen = answer.undecided & (effort.careful | (answer.verdict == Verdict.OUTSIDE_CONES))
        tile = partial(_optimum_tile, effort=effort)
        return over_chosen(tile, problem, answer, chosen, _newton_width(problem))

    # A loop rather than several calls: all stages, the careful one too, are one piece of compiled code.
    return lax.fori_loop(0, len(STEPS) + 1, improve, answer)


def _newton_width(problem: Problem) -> int:
    """Problems in a tile: few, since all wait for the slowest, and so few that a step's work stays in the cache."""
    contacts = problem.points.shape[1]
    return max(16, min(64, 2 ** int(math.log2(200 / contacts))))


def _closed_tile(problem: Problem) -> Answer:
    lanes, valid = read(problem)
    lanes, frame = normalise(lanes)
    metric, unknowns, ill = pseudo_inverse.plain_metric(lanes)
    multiplier = pseudo_inverse.closed_multiplier(lanes, unknowns, metric)
    forces = pseudo_inverse.free_forces(lanes, multiplier, unknowns)
    steps = jnp.zeros_like(ill, jnp.int32)
    outcome = Outcome(forces, multiplier, _closed_verdict(lanes, forces), steps, _no_proof(lanes), ill)
    return write(lanes, frame, unknowns, valid, problem.size, outcome, Route.CLOSED_FORM)


def _closed_verdict(lanes: Lanes, forces: Four) -> Array:
    inside = jnp.all(cones.contains(forces, lanes.cone), 0, keepdims=True)
    return jnp.where(inside, Verdict.CLOSED_FORM_OPTIMAL, Verdict.OUTSIDE_CONES)


def _no_proof(lanes: Lanes) -> Six:
    return sixes.six(lanes.force, lanes.torque) * 0


def _optimum_tile(problem: Problem, prior: Answer | None, effort: Effort) -> Answer:
    """The optimum, as far as an effort goes.

    The fast efforts begin where the last one stopped; what they do not finish stays undecided, and keeps OUTSIDE_CONES
    if more of the same may help. The careful one begins at the beginning, and needs no ``prior``.
    """
    careful = effort.careful
    lanes, valid = read(problem)
    lanes, frame = principal(lanes, careful)
    metric, unknowns, ill = _coordinates(problem, lanes, frame, careful)

    def at_the_beginning() -> Search:
        closed = _closed(lanes, frame, unknowns, metric)
        decided = closed.verdict != Verdict.OUTSIDE_CONES
        point = jnp.where(decided, closed.multiplier, 0)
        return begin(point, closed.forces, closed.verdict, decided)._replace(certificate=closed.certificate)

    def where_it_stopped() -> Search:
        assert prior is not None
        return begin(sixes.six(*multiplier_in(prior.multiplier, frame)), squeezing(lanes), Verdict.NOT_CONVERGED, ill)

    begun = at_the_beginning() if prior is None else lax.cond(careful, at_the_beginning, where_it_stopped)
    found = proximal_search(Free(lanes, frame, unknowns, metric), begun, effort)
    converged = found.verdict == Verdict.OPTIMAL
    steps = found.steps if prior is None else found.steps + jnp.where(careful, 0, prior.steps)
    outcome = Outcome(found.forces, found.point, found.verdict, steps, found.certificate, ~converged)
    answer = write(lanes, frame, unknowns, valid, problem.size, outcome, jnp.where(careful, Route.CAREFUL, Route.FAST))
    # An answer that its own residual disowns goes to the careful pass, like one that is stuck.
    undecided = ~careful & (answer.undecided | (answer.verdict == Verdict.NOT_CONVERGED))
    more = undecided & ~(found.stuck | converged | ill)[0]
    return answer._replace(verdict=jnp.where(more, Verdict.OUTSIDE_CONES, answer.verdict), undecided=undecided)


def _coordinates(problem: Problem, lanes: Lanes, frame: Frame, careful: Array) -> tuple[Metric, Unknowns, Array]:
    """Metric and unknowns, whitened if ``careful``; and which lanes they do not suit."""
    if problem.free is None:
        return pseudo_inverse.metric_for(lanes, frame, careful)
    metric, unknowns = whitened(problem, lanes, frame)
    return metric, unknowns, jnp.zeros_like(lanes.force.x, bool)


def _careful_closed_tile(problem: Problem, _: Answer | None = None) -> Answer:
    """The closed form in principal axes."""
    lanes, valid = read(problem)
    lanes, frame = principal(lanes)
    metric, unknowns = whitened(problem, lanes, frame)
    outcome = _closed(lanes, frame, unknowns, metric)
    return write(lanes, frame, unknowns, valid, problem.size, outcome, Route.CAREFUL)


def _closed(lanes: Lanes, frame: Frame, unknowns: Unknowns, metric: Metric) -> Outcome:
    """The closed form of whitened lanes."""
    multiplier = pseudo_inverse.refined_multiplier(lanes, unknowns, metric)
    forces = pseudo_inverse.free_forces(lanes, multiplier, unknowns)
    missed, direction = out_of_range(lanes, frame, unknowns)
    verdict = jnp.where(missed, Verdict.INFEASIBLE, _closed_verdict(lanes, forces))
    return Outcome(forces, multiplier, verdict, jnp.zeros_like(verdict), direction, jnp.zeros_like(missed))
