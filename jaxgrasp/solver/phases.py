"""The flat batch solvers: the closed form of every problem, then named phases for the few that need more work.

1. The closed form of all, in whitened principal axes where the contacts are nearly collinear. Forces inside every cone
   are the constrained optimum already.
2. The Newton phases on the dual for the problems outside their cones: a few steps, then, gathered again, more.
3. The robust phases for what those leave: principal axes, whitened coordinates, a proximal term that shrinks, and a
   proof where no forces exist.
4. The feasibility phase for what those leave: no squeeze and equal sharing. It asks only whether allowed forces exist,
   which loads and weights of any size do not make harder.
5. The long phase, a robust phase with many more steps, for the few that are still open.

An answer that has converged but misses its load by more than rounding is refined at once (``refinement.py``).
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Route, Verdict, is_held, is_optimum
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.iterate import varying_like
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
from jaxgrasp.solver import dual, pseudo_inverse, torque_phases
from jaxgrasp.solver.infeasibility import out_of_range
from jaxgrasp.solver.newton import DualObjective, ProximalTerm, maximise
from jaxgrasp.solver.proximal import (
    FIRST_STRENGTH,
    NEAR_STRENGTH,
    STEPS_PER_STAGE,
    UNLIMITED_CHECKS,
    PhaseSettings,
    ProximalState,
    initial_state,
    min_proximal_weight,
    proximal_search,
)
from jaxgrasp.solver.refinement import needs_refinement, refined
from jaxgrasp.solver.result import Certificate, Findings, PhaseResult, ScaledSolution, no_certificate, to_result

ROBUST_TILE = 16


class Stages(NamedTuple):
    """Parts of a solver that are compiled one by one, so that a batch compiles only what its problems need."""

    begin: Callable[[ProblemBatch], tuple[Any, PhaseResult]]
    """Results of the first phase that belong to the answer, and the state of ``start_phases``."""
    newton: Callable[[ProblemBatch, PhaseResult], PhaseResult]
    finish: Callable[[ProblemBatch, PhaseResult], PhaseResult]


class Phase(NamedTuple):
    """Settings of a phase of the optimum, explained in ``PhaseSettings``."""

    name: str
    steps: int = STEPS_PER_STAGE
    is_robust: bool = True
    proves: bool = True
    with_squeeze: bool = True
    restarts: bool = False
    checks: int = UNLIMITED_CHECKS
    min_proximal_weight: float | None = None
    """None for ``min_proximal_weight`` of the precision."""
    in_float32: bool = True
    """Run in single precision too, which has too few digits for the long phase."""


PHASES = (
    # After each phase the unfinished problems are gathered again, so that none waits for the slowest of all. The first
    # steps lead nowhere yet: what they leave open is seldom infeasible, and looking for a proof costs a step.
    Phase("Newton, 5 steps", is_robust=False, steps=5, proves=False, checks=1),
    Phase("Newton, 6 steps", is_robust=False, steps=6, checks=1),
    Phase("Newton, 8 steps", is_robust=False, steps=8, checks=1),
    Phase("Newton, 22 steps", is_robust=False, steps=22, checks=1),
    Phase("robust, 3 checks", checks=3),
    Phase("robust, 8 checks", checks=8),
    Phase("robust"),
    Phase("feasibility", with_squeeze=False, restarts=True),
    # Where torque rests on next to no friction, each step gets past one kink of a cone, and there are hundreds; almost
    # no other problem comes so far. A friction mu bends the dual by mu^2 only, so that the term must shrink further.
    Phase("long", steps=300, restarts=True, min_proximal_weight=1e-22, in_float32=False),
)
"""The phases in their order."""
FIRST_ROBUST_PHASE = next(i for i, phase in enumerate(PHASES) if phase.is_robust)


def solve_closed(problem: ProblemBatch) -> PhaseResult:
    """Return the closed form of a flat batch; ``undecided`` marks what the optimum gives to its robust phases."""
    tile = _closed_width(problem) if problem.free is None else ROBUST_TILE
    without_torques = torque_phases.without_torques(problem)
    return over_tiles(_closed_tile, without_torques, problem.size, tile, problem.count)


def solve_optimum(problem: ProblemBatch) -> PhaseResult:
    """Return the constrained optimum of a flat batch."""
    return finish_optimum(problem, solve_closed(problem))


def solve_both(problem: ProblemBatch) -> tuple[PhaseResult, PhaseResult]:
    """Return the closed form, and the constrained optimum, which starts from it."""
    closed = solve_closed(problem)
    return closed, finish_optimum(problem, closed)


def finish_optimum(problem: ProblemBatch, closed: PhaseResult) -> PhaseResult:
    """Return the constrained optimum of every problem, from its closed form."""
    return run_phases(problem, start_phases(problem, closed))


def start_phases(problem: ProblemBatch, closed: PhaseResult) -> PhaseResult:
    """Return the closed form as the first state of the phases; ``undecided`` marks the problems that need them.

    Without limits of torques, the answer of every other problem is final.
    """
    outside, inside = closed.verdict == Verdict.OUTSIDE_CONES, closed.verdict == Verdict.FEASIBLE
    # The Newton phases do not suit these.
    verdict = jnp.where(closed.undecided & outside, Verdict.NOT_CONVERGED, closed.verdict)
    verdict = jnp.where(inside, Verdict.CLOSED_FORM_OPTIMAL, verdict)
    result = closed._replace(verdict=verdict, undecided=closed.undecided | outside)
    if problem.start is None:
        return result
    # The multiplier of a problem that had no answer is NaN, and no start.
    has_start = outside & jnp.all(jnp.isfinite(problem.start), 1)
    return result._replace(multiplier=jnp.where(has_start[:, None], problem.start, result.multiplier))


def run_phases(problem: ProblemBatch, result: PhaseResult) -> PhaseResult:
    """Return the constrained optimum of every problem, from a state of ``start_phases`` or ``run_newton_phases``."""
    without_torques = torque_phases.without_torques(problem)

    def run_phase(index: Array, result: PhaseResult) -> PhaseResult:
        settings = _settings(index, without_torques.points.dtype)
        # Loads that rounding hides are balanced already; only whether allowed forces exist is left to ask.
        is_open = settings.is_robust & (~is_optimum(result.verdict) | ~settings.with_squeeze)
        chosen = result.undecided & (is_open | (result.verdict == Verdict.OUTSIDE_CONES))
        resumes = (index > FIRST_ROBUST_PHASE) & ~settings.restarts
        chosen = chosen & (~resumes | (result.strength > 0))
        tile = partial(_optimum_tile, settings=settings)
        return over_chosen(tile, without_torques, result, chosen, newton_width(without_torques.points.shape[1]))

    # A loop over the table rather than several calls: all phases are one compiled program.
    count = len(_phases(without_torques.points.dtype))
    result = lax.fori_loop(0, count, run_phase, varying_like(result, without_torques))
    return torque_phases.within_torques(problem, _feasible_where_load_is_hidden(result))


def run_newton_phases(problem: ProblemBatch, start: PhaseResult) -> PhaseResult:
    """Return ``start`` with the optimum of each problem that the Newton phases answer without proof or refinement.

    This is a third of the code of ``run_phases``, to the same answers bit for bit: the kernels are the same. A problem
    that needs more stays as ``start_phases`` left it, undecided.
    """
    problem = torque_phases.without_torques(problem)

    def run_phase(index: Array, states: tuple[PhaseResult, Array]) -> tuple[PhaseResult, Array]:
        result, is_solved = states
        settings = _settings(index, problem.points.dtype)
        chosen = result.undecided & (result.verdict == Verdict.OUTSIDE_CONES)
        tile = partial(_newton_tile, settings=settings)
        return over_chosen(tile, problem, states, chosen & ~is_solved, newton_width(problem.points.shape[1]))

    states = (start, jnp.zeros_like(start.undecided))
    result, is_solved = lax.fori_loop(0, FIRST_ROBUST_PHASE, run_phase, states)
    return merged(is_solved, result, start)


def _begin_optimum(problem: ProblemBatch) -> tuple[tuple[()], PhaseResult]:
    return (), start_phases(problem, solve_closed(problem))


def _begin_both(problem: ProblemBatch) -> tuple[tuple[PhaseResult], PhaseResult]:
    closed = solve_closed(problem)
    return (closed,), start_phases(problem, closed)


OPTIMUM_STAGES = Stages(_begin_optimum, run_newton_phases, run_phases)
BOTH_STAGES = Stages(_begin_both, run_newton_phases, run_phases)


def _phases(dtype: jnp.dtype) -> list[Phase]:
    return [phase for phase in PHASES if phase.in_float32 or dtype == jnp.float64]


def _settings(index: Array, dtype: jnp.dtype) -> PhaseSettings:
    """Return the settings of the phase at ``index``, read from a table of all phases."""
    phases = _phases(dtype)
    default = min_proximal_weight(dtype)
    weights = [default if phase.min_proximal_weight is None else phase.min_proximal_weight for phase in phases]

    def column(values: list, dtype: Any) -> Array:
        return jnp.asarray(values, dtype)[index]

    return PhaseSettings(
        is_robust=column([phase.is_robust for phase in phases], bool),
        steps=column([phase.steps for phase in phases], jnp.int32),
        proves=column([phase.proves for phase in phases], bool),
        with_squeeze=column([phase.with_squeeze for phase in phases], bool),
        restarts=column([phase.restarts for phase in phases], bool),
        checks=column([phase.checks for phase in phases], jnp.int32),
        min_proximal_weight=column(weights, dtype),
    )


def _feasible_where_load_is_hidden(result: PhaseResult) -> PhaseResult:
    """Change OPTIMAL to FEASIBLE where the load is below the rounding of the forces."""
    hidden = result.undecided & is_optimum(result.verdict)
    return result._replace(verdict=jnp.where(hidden, Verdict.FEASIBLE, result.verdict))


def _is_double(problem: ProblemBatch) -> bool:
    """Return whether there are digits enough to tell a refined answer from one that only looks refined."""
    return problem.points.dtype == jnp.float64


def _closed_width(problem: ProblemBatch) -> int:
    """Return the number of problems in a tile of the closed form: as many as stay in the cache."""
    return 128 if problem.points.shape[1] <= 10 else 64


def newton_width(contacts: int) -> int:
    """Return the number of problems in a tile of a phase.

    Few, since all wait for the slowest, and so few that the data of a step stay in the cache.
    """
    return max(16, min(64, 2 ** int(math.log2(200 / contacts))))


def _closed_tile(problem: ProblemBatch) -> PhaseResult:
    scaled = in_suitable_axes(problem)
    # In a kernel of its own: within the other its loop, which hardly ever runs, would halve the speed.
    return _closed_result(scaled, _out_of_range(scaled, scaled.ill_conditioned))


@fused_cpu_kernel
def _closed_result(problem: ScaledProblem, certificate: Certificate) -> PhaseResult:
    ill_conditioned = problem.ill_conditioned
    # eq. 9: f = s a + W G^T (G W G^T)^-1 (w - G s a)
    multiplier = pseudo_inverse.refined_multiplier(problem)
    forces = pseudo_inverse.forces_without_cones(problem, multiplier)
    infeasible = certificate.force_bound > 0
    inside = vec3.all_contacts(friction_cone.contains(forces, problem.data.cone))
    findings = Findings(infeasible=infeasible, optimal=inside, closed_form=jnp.ones_like(inside))
    undecided = ill_conditioned & ~inside & ~infeasible
    steps = jnp.zeros_like(inside, jnp.int32)
    solution = ScaledSolution(forces, multiplier, findings, steps, certificate, undecided)
    result = to_result(problem, solution, jnp.where(ill_conditioned, Route.ROBUST, Route.CLOSED_FORM))
    return _feasible_where_load_is_hidden(result)


def _out_of_range(problem: ScaledProblem, suspects: Array) -> Certificate:
    """Return proofs for those ``suspects`` whose load no contact reaches; other problems' contacts reach any load."""
    data = problem.data
    no_proof = varying_like(no_certificate(spatial.join(data.force, data.torque)), data, problem.scaling)

    def search(_: Certificate) -> Certificate:
        direction, force = out_of_range(problem)
        return Certificate(direction, jnp.where(suspects, force, 0))

    return lax.cond(jnp.any(suspects), search, lambda no_proof: no_proof, no_proof)


def _optimum_tile(batch: ProblemBatch, prior: PhaseResult, settings: PhaseSettings) -> PhaseResult:
    """Return the optimum of a tile, as far as one phase gets.

    A Newton phase starts where the last one stopped; what it does not finish stays undecided, with the verdict
    OUTSIDE_CONES where more steps may help. The first robust phase starts from the Newton phases' multiplier where they
    came near, else from zero; the next ones go on where the last was interrupted.
    """
    robust = settings.is_robust
    data, valid = to_batch_last(batch)
    problem = in_principal_or_user_axes(batch, without_squeeze(data, ~settings.with_squeeze), valid, robust)
    # In single precision, what the Newton phases came to may be as far off as it looks near.
    resumed, from_newton = (prior.strength > 0)[None], (prior.route == Route.NEWTON)[None] & _is_double(batch)
    certificate = _out_of_range(problem, robust & ~resumed)
    unreachable = certificate.force_bound > 0
    continues = ~settings.restarts & (~robust | resumed | from_newton)
    last = problem.coordinates.from_twist(*multiplier_to_scaled(prior.multiplier, problem.scaling))
    point = jnp.where(continues, last, 0)
    first = jnp.where(resumed, prior.strength[None], jnp.where(from_newton, NEAR_STRENGTH, FIRST_STRENGTH))
    strength = jnp.where(robust, jnp.where(settings.restarts, FIRST_STRENGTH, first), 0)
    start = initial_state(
        point, squeezing_forces(problem.data), unreachable, problem.ill_conditioned | unreachable, strength
    )
    state = proximal_search(DualObjective(problem), start._replace(certificate=certificate), settings)
    if _is_double(batch):
        state = refined(problem, state, robust)
    return _optimum_result(problem, state, data, settings, continues, prior)


def _newton_tile(
    batch: ProblemBatch, states: tuple[PhaseResult, Array], settings: PhaseSettings
) -> tuple[PhaseResult, Array]:
    """Return what ``_optimum_tile`` returns for a Newton phase, and a mask of problems whose answer that is.

    It is not where a proof or a refinement would follow.
    """
    prior, _ = states
    data, valid = to_batch_last(batch)
    # The same kernels as in `_optimum_tile`, with the same arguments: another kernel would round otherwise.
    robust = settings.is_robust
    problem = in_principal_or_user_axes(batch, data, valid, robust)
    point = problem.coordinates.from_twist(*multiplier_to_scaled(prior.multiplier, problem.scaling))
    objective = DualObjective(problem, ProximalTerm(0 * point[:1], point))
    newton = maximise(objective, point, problem.ill_conditioned, settings.steps)
    check = objective.check_optimality(newton.point)
    optimal = check.optimal & ~problem.ill_conditioned
    none = jnp.zeros_like(optimal)
    findings = Findings(
        infeasible=none,
        optimal=optimal,
        closed_form=none,
        feasible_only=none,
        resumable=~newton.stalled & ~problem.ill_conditioned,
    )
    steps = newton.steps + prior.steps[None]
    solution = ScaledSolution(check.forces, newton.point, findings, steps, no_certificate(point), ~optimal)
    result = to_result(problem, solution, jnp.where(robust, Route.ROBUST, Route.NEWTON))
    is_solved = (result.verdict == Verdict.OPTIMAL) & ~result.undecided
    if _is_double(batch):
        is_solved = is_solved & ~needs_refinement(check.relative_residual, optimal)[0]
    return result, is_solved


@fused_cpu_kernel
def _optimum_result(
    problem: ScaledProblem,
    state: ProximalState,
    data: ContactData,
    settings: PhaseSettings,
    continues: Array,
    prior: PhaseResult,
) -> PhaseResult:
    robust, with_squeeze = settings.is_robust, settings.with_squeeze
    steps = state.steps + jnp.where(continues | ~with_squeeze, prior.steps[None], 0)
    # Without squeeze, proofs that there are no allowed forces hold; forces that are allowed may not be the optimum.
    cost, is_least = _cost(problem, state.forces, data, prior)
    findings = Findings(
        infeasible=state.infeasible,
        optimal=state.optimal,
        closed_form=jnp.zeros_like(state.optimal),
        feasible_only=state.optimal & ~with_squeeze & ~is_least,
        resumable=~robust & ~state.stalled & ~problem.ill_conditioned,
    )
    undecided = ~(state.optimal | state.infeasible)
    solution = ScaledSolution(state.forces, state.point, findings, steps, state.certificate, undecided)
    result = to_result(problem, solution, jnp.where(robust, Route.ROBUST, Route.NEWTON))
    is_feasible = ~with_squeeze & is_held(result.verdict)
    # Forces whose load rounding hides are now known to be allowed, and stay as they are.
    hidden = is_optimum(prior.verdict) & is_feasible
    # A load that is sound beside the squeeze may be too light without it.
    has_no_answer = (result.verdict == Verdict.NOT_CONVERGED) | (result.verdict == Verdict.INVALID_DATA)
    keeps_prior = ~with_squeeze & (has_no_answer | hidden)
    verdict = jnp.where(hidden, Verdict.FEASIBLE, prior.verdict)
    prior = prior._replace(verdict=verdict, undecided=prior.undecided & ~hidden)
    result = result._replace(
        objective=jnp.where(is_feasible, cost[0], result.objective),
        multiplier=jnp.where(with_squeeze, result.multiplier, prior.multiplier),
        strength=state.strength[0],
    )
    return merged(keeps_prior, prior, result)


def _cost(problem: ScaledProblem, forces: ContactVec, data: ContactData, prior: PhaseResult) -> tuple[Array, Array]:
    """Return the user's objective of forces that were found without squeeze, and whether it is the least.

    It is, within the gap of a converged optimum, where it equals the bound that ``prior`` proves. Both ``(1, B)``.
    """
    user = problem.data._replace(squeeze=data.squeeze, weights=data.weights)
    (cost,) = vec3.totals(dual.deviation_cost(user, contact_vec.scale(problem.scaling.force_unit, forces)))
    gap = tolerances(cost.dtype).gap * dual.gap_scale(user, cost)
    return cost, cost - prior.objective[None] <= gap
