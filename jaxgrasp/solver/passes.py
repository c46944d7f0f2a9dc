"""The flat batch solvers: a fast pass over every problem, then more work for the few that need it.

1. The closed form of all, carefully where the contacts are nearly in line. What lies inside every cone is the
   constrained optimum already.
2. Newton on the dual for those outside their cones, first a few steps, then, gathered again, more.
3. The careful pass for the rest: principal axes, whitened coordinates, a proximal term that falls away,
   and a proof where no forces exist.
4. For what that leaves, the careful pass without squeezing and with equal sharing: it asks only whether there are
   allowed forces, which loads and weights of any size leave as easy as it is.
5. For the few that are open still, the careful pass again, with many more steps.

Whatever has converged, but misses its load by more than rounding, is refined at once.
"""

import math
from functools import partial

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Route, Verdict, is_optimum
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.numerics.tiling import merged, over_chosen, over_tiles
from jaxgrasp.problem import contact_vec, friction_cone, spatial
from jaxgrasp.problem.batch_last import (
    ContactData,
    ProblemBatch,
    squeezing_forces,
    to_batch_last,
    without_squeeze,
)
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.scaled_problem import ScaledProblem, in_principal_or_user_axes, in_suitable_axes
from jaxgrasp.problem.scaling import multiplier_to_scaled
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual, pseudo_inverse, torque_passes
from jaxgrasp.solver.infeasibility import out_of_range
from jaxgrasp.solver.proximal import (
    NEAR,
    STEPS_PER_LEVEL,
    STRONGEST,
    UNLIMITED_CHECKS,
    ConeOnlyProblem,
    PassSettings,
    ProximalState,
    initial_state,
    proximal_search,
    weakest,
)
from jaxgrasp.solver.refinement import refined
from jaxgrasp.solver.result import Certificate, PassResult, ScaledResult, no_certificate, to_result

CAREFUL_TILE = 16
STEPS = (5, 6, 8, 22)
"""Evaluations that each fast pass may spend; after each of them the unfinished are gathered again."""
LONG_PASS_STEPS = 300
"""Evaluations at each level of the last pass. Where torque rests on next to no friction, each step gets past one kink
of a cone and there are hundreds; almost no other problem comes so far."""
LONG_PASS_WEAKEST = 1e-22
"""Strength at which its levels end: a friction mu bends the dual by mu^2 only, and less than that is to be held."""
CAREFUL_CHECKS = (3, 8, UNLIMITED_CHECKS)
"""Checks of the careful pass, after each of which the unfinished are gathered again and go on where they stopped."""
FIRST_CAREFUL_PASS = len(STEPS)
"""The first pass after the fast ones."""
FEASIBILITY_PASS, LONG_PASS = FIRST_CAREFUL_PASS + len(CAREFUL_CHECKS), FIRST_CAREFUL_PASS + len(CAREFUL_CHECKS) + 1
"""The passes after the careful one."""


def solve_closed(problem: ProblemBatch) -> PassResult:
    """The closed form of a flat batch; ``undecided`` where the optimum takes its careful pass at once."""
    tile = _closed_width(problem) if problem.free is None else CAREFUL_TILE
    bare = torque_passes.without_torques(problem)
    return over_tiles(_closed_tile, bare, problem.size, tile, problem.count, is_short=True)


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
    outside, inside = closed.verdict == Verdict.OUTSIDE_CONES, closed.verdict == Verdict.FEASIBLE
    # What the fast passes do not suit is not converged from the outset.
    verdict = jnp.where(closed.undecided & outside, Verdict.NOT_CONVERGED, closed.verdict)
    verdict = jnp.where(inside, Verdict.CLOSED_FORM_OPTIMAL, verdict)
    result = closed._replace(verdict=verdict, undecided=closed.undecided | outside)
    if problem.start is not None:
        # One that is no number, as of a problem that had none, is none to begin from.
        given = outside & jnp.all(jnp.isfinite(problem.start), 1)
        result = result._replace(multiplier=jnp.where(given[:, None], problem.start, result.multiplier))

    def improve(index: Array, result: PassResult) -> PassResult:
        settings = _settings(index, bare.points.dtype)
        # Loads that rounding hides are balanced already; all that is left to ask is whether allowed forces exist.
        open_ = settings.careful & (~is_optimum(result.verdict) | ~settings.with_squeeze)
        chosen = result.undecided & (open_ | (result.verdict == Verdict.OUTSIDE_CONES))
        resumes = (index > FIRST_CAREFUL_PASS) & ~settings.restarts
        chosen = chosen & (~resumes | (result.strength > 0))
        tile = partial(_optimum_tile, settings=settings)
        return over_chosen(tile, bare, result, chosen, _newton_width(bare))

    # A loop rather than several calls: all passes, the careful one too, are one piece of compiled code.
    passes = LONG_PASS + 1 if _is_double(bare) else FEASIBILITY_PASS
    result = lax.fori_loop(0, passes, improve, varying_like(result, bare))
    return torque_passes.within_torques(problem, _feasible_where_load_is_hidden(result))


def _settings(index: Array, dtype: jnp.dtype) -> PassSettings:
    """The settings of a pass, by its place in the order of all."""
    levels = len(CAREFUL_CHECKS) * (STEPS_PER_LEVEL,)
    steps = jnp.asarray((*STEPS, *levels, STEPS_PER_LEVEL, LONG_PASS_STEPS), jnp.int32)[index]
    checks = jnp.asarray((*len(STEPS) * (1,), *CAREFUL_CHECKS, UNLIMITED_CHECKS, UNLIMITED_CHECKS), jnp.int32)[index]
    return PassSettings(
        weakest=jnp.where(index == LONG_PASS, LONG_PASS_WEAKEST, weakest(dtype)).astype(dtype),
        careful=index >= FIRST_CAREFUL_PASS,
        steps=steps,
        # The first steps lead nowhere yet: what they leave open is seldom infeasible, and a proof costs a step.
        proves=index > 0,
        with_squeeze=index != FEASIBILITY_PASS,
        restarts=index >= FEASIBILITY_PASS,
        checks=checks,
    )


def _feasible_where_load_is_hidden(result: PassResult) -> PassResult:
    """Change OPTIMAL to FEASIBLE where the load is below the rounding of the forces."""
    hidden = result.undecided & is_optimum(result.verdict)
    return result._replace(verdict=jnp.where(hidden, Verdict.FEASIBLE, result.verdict))


def _is_double(problem: ProblemBatch) -> bool:
    """Whether there are digits enough to tell a refined answer from one that only looks so."""
    return problem.points.dtype == jnp.float64


def _closed_width(problem: ProblemBatch) -> int:
    """Problems in a tile: as many as stay in the cache."""
    return 128 if problem.points.shape[1] <= 10 else 64


def _newton_width(problem: ProblemBatch) -> int:
    """Problems in a tile: few, since all wait for the slowest, and so few that a step's work stays in the cache."""
    contacts = problem.points.shape[1]
    return max(16, min(64, 2 ** int(math.log2(200 / contacts))))


def _closed_tile(problem: ProblemBatch) -> PassResult:
    suited = in_suitable_axes(problem)
    # In a kernel of its own: within the other its loop, which hardly ever runs, would halve the speed.
    return _closed_result(suited, _out_of_range(suited, suited.ill_conditioned))


@fused_cpu_kernel
def _closed_result(problem: ScaledProblem, certificate: Certificate) -> PassResult:
    ill_conditioned = problem.ill_conditioned
    multiplier = pseudo_inverse.refined_multiplier(problem)
    forces = pseudo_inverse.forces_without_cones(problem, multiplier)
    inside = vec3.every(friction_cone.contains(forces, problem.data.cone))
    verdict = jnp.where(inside, Verdict.CLOSED_FORM_OPTIMAL, Verdict.OUTSIDE_CONES)
    verdict = jnp.where(certificate.force_bound > 0, Verdict.INFEASIBLE, verdict)
    undecided = ill_conditioned & (verdict == Verdict.OUTSIDE_CONES)
    found = ScaledResult(forces, multiplier, verdict, jnp.zeros_like(verdict), certificate, undecided)
    result = to_result(problem, found, jnp.where(ill_conditioned, Route.CAREFUL, Route.CLOSED_FORM))
    return _feasible_where_load_is_hidden(result)


def _out_of_range(problem: ScaledProblem, suspects: Array) -> Certificate:
    """Which of the ``suspects`` are asked for what no contact reaches; contacts of the others reach everything."""
    data = problem.data
    none = varying_like(no_certificate(spatial.join(data.force, data.torque)), data, problem.scaling)

    def search(_: Certificate) -> Certificate:
        direction, force = out_of_range(problem)
        return Certificate(direction, jnp.where(suspects, force, 0))

    return lax.cond(jnp.any(suspects), search, lambda none: none, none)


def _optimum_tile(batch: ProblemBatch, prior: PassResult, settings: PassSettings) -> PassResult:
    """The optimum, as far as one pass goes.

    The fast passes begin where the last one stopped; what they do not finish stays undecided, and keeps OUTSIDE_CONES
    if more of the same may help. The careful one begins there too, where they were any use, else at the beginning, and
    goes on where it was interrupted.
    """
    careful = settings.careful
    own, valid = to_batch_last(batch)
    problem = in_principal_or_user_axes(batch, without_squeeze(own, ~settings.with_squeeze), valid, careful)
    # Where digits are few, what the fast passes came to may be as far off as it looks near.
    resumed, near = (prior.strength > 0)[None], (prior.route == Route.FAST)[None] & _is_double(batch)
    certificate = _out_of_range(problem, careful & ~resumed)
    unreachable = certificate.force_bound > 0
    goes_on = ~settings.restarts & (~careful | resumed | near)
    last = problem.coordinates.from_twist(*multiplier_to_scaled(prior.multiplier, problem.scaling))
    point = jnp.where(goes_on, last, 0)
    begun = jnp.where(resumed, prior.strength[None], jnp.where(near, NEAR, STRONGEST))
    strength = jnp.where(careful, jnp.where(settings.restarts, STRONGEST, begun), 0)
    verdict = jnp.where(unreachable, Verdict.INFEASIBLE, Verdict.NOT_CONVERGED)
    start = initial_state(
        point, squeezing_forces(problem.data), verdict, problem.ill_conditioned | unreachable, strength
    )
    found = proximal_search(ConeOnlyProblem(problem), start._replace(certificate=certificate), settings)
    if _is_double(batch):
        found = refined(problem, found, careful)
    return _optimum_result(problem, found, own, settings, goes_on, prior)


@fused_cpu_kernel
def _optimum_result(
    problem: ScaledProblem,
    state: ProximalState,
    own: ContactData,
    settings: PassSettings,
    goes_on: Array,
    prior: PassResult,
) -> PassResult:
    careful, with_squeeze = settings.careful, settings.with_squeeze
    converged = state.verdict == Verdict.OPTIMAL
    steps = state.steps + jnp.where(goes_on | ~with_squeeze, prior.steps[None], 0)
    undecided = ~(converged | (state.verdict == Verdict.INFEASIBLE))
    found = ScaledResult(state.forces, state.point, state.verdict, steps, state.certificate, undecided)
    result = to_result(problem, found, jnp.where(careful, Route.CAREFUL, Route.FAST))
    more = ~careful & result.undecided & ~(state.stalled | converged | problem.ill_conditioned)[0]
    result = result._replace(verdict=jnp.where(more, Verdict.OUTSIDE_CONES, result.verdict))
    # Without squeezing, proofs that there are no allowed forces hold; such forces may not be the optimum.
    cost, least = _cost(problem, state.forces, own, prior)
    verdict = jnp.where(least, Verdict.OPTIMAL, Verdict.FEASIBLE)
    feasible = ~with_squeeze & (result.verdict == Verdict.OPTIMAL)
    # What rounding makes miss its load is known to be allowed then, and stays as it is.
    hidden = is_optimum(prior.verdict) & feasible
    no_gain = ~with_squeeze & ((result.verdict == Verdict.NOT_CONVERGED) | hidden)
    kept = jnp.where(hidden, Verdict.FEASIBLE, prior.verdict)
    prior = prior._replace(verdict=kept, undecided=prior.undecided & ~hidden)
    result = result._replace(
        verdict=jnp.where(feasible, verdict, result.verdict),
        objective=jnp.where(feasible, cost, result.objective),
        multiplier=jnp.where(with_squeeze, result.multiplier, prior.multiplier),
        strength=state.strength[0],
    )
    return merged(no_gain, prior, result)


def _cost(problem: ScaledProblem, forces: ContactVec, own: ContactData, prior: PassResult) -> tuple[Array, Array]:
    """The objective of forces in the problem as it is, and whether it is what ``prior`` proves to be least, within the
    gap of a converged optimum."""
    user = problem.data._replace(squeeze=own.squeeze, weights=own.weights)
    (cost,) = vec3.totals(dual.deviation_cost(user, contact_vec.scale(problem.scaling.force_unit, forces)))
    gap = tolerances(cost.dtype).gap * dual.gap_scale(user, cost)
    return cost[0], (cost - prior.objective[None] <= gap)[0]
