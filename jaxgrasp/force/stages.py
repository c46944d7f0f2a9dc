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

from jaxgrasp.force import cones, dual, fours, limited, newton, pseudo_inverse, sixes
from jaxgrasp.force.answer import Answer, Outcome, write
from jaxgrasp.force.certify import out_of_range
from jaxgrasp.force.fours import Four
from jaxgrasp.force.frame import multiplier_in, normalise, principal
from jaxgrasp.force.guide import whitened
from jaxgrasp.force.lanes import Lanes, Problem, read
from jaxgrasp.force.newton import Dual, ascend
from jaxgrasp.force.proximal import Free, Search, proximal_search
from jaxgrasp.force.sixes import Six
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
        return over_tiles(partial(_whole, constrained=False), bare, problem.size, CAREFUL_TILE)
    return finish_closed(problem, first_pass(problem))


def solve_optimum(problem: Problem) -> Answer:
    """The constrained optimum of a flat batch."""
    if problem.free is None:
        return finish_optimum(problem, first_pass(problem))
    bare = limited.without_torques(problem)
    answer = over_tiles(partial(_whole, constrained=True), bare, problem.size, CAREFUL_TILE)
    return limited.within_torques(problem, answer)


def solve_both(problem: Problem) -> tuple[Answer, Answer]:
    """Closed form and constrained optimum, which starts from it."""
    if problem.free is not None:
        return solve_closed(problem), solve_optimum(problem)
    first = first_pass(problem)
    return finish_closed(problem, first), finish_optimum(problem, first)


def first_pass(problem: Problem) -> Answer:
    """The closed form of every problem; ``undecided`` where it is too ill-conditioned for this pass."""
    return over_tiles(_closed_tile, limited.without_torques(problem), problem.size, TILE)


def finish_closed(problem: Problem, answer: Answer) -> Answer:
    """The closed form everywhere, from the first pass."""
    bare = limited.without_torques(problem)
    return over_chosen(partial(_careful_tile, constrained=False), bare, answer, answer.undecided, CAREFUL_TILE)


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

    def newton(stage: Array, answer: Answer) -> Answer:
        tile = partial(_newton_tile, limit=jnp.asarray(STEPS)[stage])
        return over_chosen(tile, problem, answer, _waiting(answer), _newton_width(problem))

    # A loop rather than two calls: the stages are one piece of compiled code.
    answer = lax.fori_loop(0, len(STEPS), newton, answer)
    careful = partial(_careful_tile, constrained=True)
    return over_chosen(careful, problem, answer, answer.undecided, CAREFUL_TILE)


def _newton_width(problem: Problem) -> int:
    """Problems in a tile: few, since all wait for the slowest, and so few that a step's work stays in the cache."""
    contacts = problem.points.shape[1]
    return max(16, min(64, 2 ** int(math.log2(200 / contacts))))


def _waiting(answer: Answer) -> Array:
    """Problems that ran out of steps, but are fit for the fast path."""
    return answer.undecided & (answer.verdict == Verdict.OUTSIDE_CONES)


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


def _newton_tile(problem: Problem, prior: Answer, limit: Array) -> Answer:
    """Newton from where the last stage stopped; what has not converged keeps OUTSIDE_CONES and stays undecided."""
    lanes, valid = read(problem)
    lanes, frame = normalise(lanes)
    metric, unknowns, ill = pseudo_inverse.plain_metric(lanes)
    linear, angular = multiplier_in(prior.multiplier, frame)
    start = sixes.six(linear, angular)
    ascent = ascend(Dual(lanes, unknowns, metric), start, ill, limit)
    best = dual.best_forces(lanes, ascent.point, unknowns).forces
    converged = newton.is_optimal(lanes, unknowns, metric, ascent.point, best) & ~ill
    verdict = jnp.where(converged, Verdict.OPTIMAL, Verdict.NOT_CONVERGED)
    outcome = Outcome(best, ascent.point, verdict, ascent.steps + prior.steps, _no_proof(lanes), ~converged)
    answer = write(lanes, frame, unknowns, valid, problem.size, outcome, Route.FAST)
    # An answer that its own residual disowns goes to the careful pass, like one that is stuck.
    undecided = answer.undecided | (answer.verdict == Verdict.NOT_CONVERGED)
    more = undecided & ~(ascent.stuck | converged | ill)[0]
    return answer._replace(verdict=jnp.where(more, Verdict.OUTSIDE_CONES, answer.verdict), undecided=undecided)


def _careful_tile(problem: Problem, _: Answer, constrained: bool) -> Answer:
    return _whole(problem, constrained)


def _whole(problem: Problem, constrained: bool) -> Answer:
    """The careful pass, which begins at the beginning; of guided objects the only one."""
    lanes, valid = read(problem)
    lanes, frame = principal(lanes)
    metric, unknowns = whitened(problem, lanes, frame)
    multiplier = pseudo_inverse.refined_multiplier(lanes, unknowns, metric)
    forces = pseudo_inverse.free_forces(lanes, multiplier, unknowns)
    verdict = _closed_verdict(lanes, forces)
    missed, direction = out_of_range(lanes, frame, unknowns)
    outcome = Outcome(forces, multiplier, verdict, jnp.zeros_like(verdict), direction, jnp.zeros_like(missed))
    if constrained:
        outcome = _improved(Free(lanes, frame, unknowns, metric), outcome, missed)
    outcome = outcome._replace(verdict=jnp.where(missed, Verdict.INFEASIBLE, outcome.verdict))
    return write(lanes, frame, unknowns, valid, problem.size, outcome, Route.CAREFUL)


def _improved(ground: Free, closed: Outcome, decided: Array) -> Outcome:
    """The optimum of lanes that are not ``decided`` and whose closed form is not optimal already."""
    optimal = closed.verdict == Verdict.CLOSED_FORM_OPTIMAL
    kept = optimal | decided
    begun = Search(
        point=jnp.where(kept, closed.multiplier, 0),
        verdict=jnp.where(optimal, closed.verdict, Verdict.NOT_CONVERGED),
        steps=closed.steps,
        certificate=closed.certificate,
        decided=kept,
    )
    best, found = proximal_search(ground, begun)
    return closed._replace(
        forces=fours.where(kept, closed.forces, best),
        multiplier=found.point,
        verdict=found.verdict,
        steps=found.steps,
        certificate=found.certificate,
    )
