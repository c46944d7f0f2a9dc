"""The optimum within limits of joint torques: nothing where none is broken, more coordinates where some are.

1. The optimum as it is, where its forces break no limit.
2. Newton's method with the few limits that are broken most, from there on; then, for what that leaves, with more.
3. The careful pass with all limits, for what that leaves, and a proof where no forces exist.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Route, Verdict, is_optimum
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.numerics.tiling import over_chosen
from jaxgrasp.problem.batch_last import ProblemBatch, squeezing_forces
from jaxgrasp.problem.scaled_problem import ScaledProblem, in_plain_axes, in_principal_axes
from jaxgrasp.problem.scaling import multiplier_to_scaled
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import torque_limits
from jaxgrasp.solver.infeasibility import find_certificate
from jaxgrasp.solver.newton import OptimalityCheck, ProximalTerm, maximise
from jaxgrasp.solver.proximal import careful_settings, initial_state, proximal_search
from jaxgrasp.solver.result import Certificate, JointResult, PassResult, ScaledResult, no_certificate, to_result
from jaxgrasp.solver.torque_limits import TorqueConstraints, TorqueLimitedObjective


class _TorquePass(NamedTuple):
    """Fast passes with ``width`` limits at a time, those that bind or are broken most."""

    width: int
    steps: tuple[int, ...]
    """Evaluations of each, after which the unfinished are gathered again and choose their limits anew."""


FAST = (_TorquePass(3, (4, 4, 8, 20)), _TorquePass(6, (10, 30)), _TorquePass(12, (40,)))
ROUNDING = 4.0
"""Torques may be beyond their limits by so many tolerances of forces."""
TILE = 32
CAREFUL_TILE = 16


def without_torques(problem: ProblemBatch) -> ProblemBatch:
    """The problem with no limits of torques, so that nothing before them has to carry them about."""
    return replace(problem, torque_bounds=None)


def within_torques(problem: ProblemBatch, result: PassResult) -> PassResult:
    """The optimum within the limits of torques, from that without."""
    bounds = problem.torque_bounds
    if bounds is None:
        return result
    nothing = jnp.zeros((problem.size, bounds.torque_max.shape[-1]), result.forces.dtype)
    # A first look at all; what it suspects is looked at closely where it is gathered.
    torque = torque_limits.torques_of_forces(bounds.torque_map, result.forces, result.moments)
    broken = jnp.sum(~(jnp.abs(torque) <= bounds.torque_max), 1)
    within = broken == 0
    strange = ~jnp.all(jnp.isfinite(torque) & (bounds.torque_max >= 0), 1)
    # Forces that are allowed but not the optimum are no better a start than none.
    no_start = (result.verdict == Verdict.FEASIBLE) & ~within
    verdict = jnp.where(no_start, Verdict.NOT_CONVERGED, result.verdict)
    result = result._replace(undecided=(is_optimum(result.verdict) & ~within) | strange, verdict=verdict)
    nothing = varying_like(nothing, problem, result)
    result = result._replace(torque_multiplier=nothing, certificate_rates=nothing)
    # One question for all, since every pass that asks for itself copies what it may change.
    return lax.cond(jnp.any(result.undecided), partial(_within, problem, broken), lambda result: result, result)


def _within(problem: ProblemBatch, broken: Array, result: PassResult) -> PassResult:
    """Pass after pass, for the undecided, whose optimum without limits breaks so many ``(B,)``."""
    nothing = result.certificate_rates
    assert nothing is not None
    # The fast ones prove nothing.
    result = result._replace(certificate_rates=None)
    if problem.free is None:
        joints = nothing.shape[1]
        wide = next((k for k, passes in enumerate(FAST) if passes.width >= joints), len(FAST) - 1)
        for passes in FAST[: wide + 1]:
            # Where more are broken than a pass has room for, it would end with some of them broken still.
            fits = (broken <= passes.width) | (passes == FAST[wide])
            result = _fast(problem, result, passes, fits)
    result = result._replace(certificate_rates=nothing)
    return over_chosen(_careful_tile, problem, result, result.undecided, CAREFUL_TILE)


def _fast(problem: ProblemBatch, result: PassResult, passes: _TorquePass, fits: Array) -> PassResult:
    """Newton's method for the undecided that ``fits`` says it is for, as far as it gets."""

    def newton(index: Array, result: PassResult) -> PassResult:
        tile = partial(_fast_tile, width=passes.width, max_evaluations=jnp.asarray(passes.steps, jnp.int32)[index])
        return over_chosen(tile, problem, result, result.undecided & fits, TILE)

    # A loop rather than several calls: the passes are one piece of compiled code.
    return lax.fori_loop(0, len(passes.steps), newton, result)


def _excess(problem: ProblemBatch, result: PassResult) -> Array:
    """How far each torque is beyond its limit ``(B, j)``, rounding aside, beside the size of what makes it.

    The batch must be ``cleaned``.
    """
    bounds = problem.torque_bounds
    assert bounds is not None
    torque = torque_limits.torques_of_forces(bounds.torque_map, result.forces, result.moments)
    # Forces are known to what rounds the largest of them.
    size = jnp.sum(jnp.abs(bounds.torque_map), (1, 2)) * jnp.max(jnp.abs(result.forces), (1, 2))[:, None]
    beyond = jnp.abs(torque) - bounds.torque_max - ROUNDING * tolerances(torque.dtype).gradient * size
    return jnp.where(beyond > 0, beyond / jnp.where(size > 0, size, 1), beyond)


def _settled(problem: ProblemBatch, prior: PassResult, excess: Array, valid: Array) -> Array:
    """Problems that no limit concerns after all."""
    unsolved = (prior.verdict != Verdict.NOT_CONVERGED) & ~is_optimum(prior.verdict)
    return valid[0] & (unsolved | (is_optimum(prior.verdict) & ~jnp.any(excess > 0, 1)))


def _merge(settled: Array, prior: PassResult, result: PassResult) -> PassResult:
    prior = prior._replace(undecided=jnp.zeros_like(settled))
    return jax.tree.map(
        lambda old, new: jnp.where(jnp.expand_dims(settled, range(1, old.ndim)), old, new), prior, result
    )


def _fast_tile(batch: ProblemBatch, prior: PassResult, width: int, max_evaluations: Array) -> PassResult:
    problem = _with_usable_torques(in_plain_axes(batch), batch)
    batch = torque_limits.cleaned(batch)
    scaling, ill_conditioned = problem.scaling, problem.ill_conditioned
    excess = _excess(batch, prior)
    settled = _settled(batch, prior, excess, problem.valid)
    chosen = _choose(excess, prior, width)
    constraints = torque_limits.torque_constraints(batch, problem.data, scaling, chosen)
    objective = TorqueLimitedObjective(problem, constraints)
    twist = problem.coordinates.from_twist(*multiplier_to_scaled(prior.multiplier, scaling))
    known = jnp.sum(chosen * _binding(prior)[:, None], -1).T * scaling.weight_sum / scaling.force_unit
    start = jnp.concatenate([twist, vec3.safe_divide(known, constraints.scale)])
    reached = maximise(objective, start, ill_conditioned, max_evaluations)
    best, good, *_ = objective.check_optimality(reached.point)
    good = good & ~ill_conditioned
    rates = jnp.sum(chosen * (constraints.scale * reached.point[6:]).T[..., None], 1)
    velocities = torque_limits.velocities_by_joints(constraints, reached.point[6:])
    found = ScaledResult(
        forces=best,
        multiplier=reached.point[:6],
        verdict=jnp.where(good, Verdict.OPTIMAL, Verdict.NOT_CONVERGED),
        steps=reached.steps + prior.steps[None],
        certificate=no_certificate(twist),
        undecided=~good,
        joints=JointResult(velocities, rates.T, 0 * rates.T),
    )
    result = to_result(problem, found, Route.FAST)
    # Limits that were not chosen may be broken now.
    undecided = (result.verdict == Verdict.NOT_CONVERGED) | jnp.any(_excess(batch, result) > 0, 1)
    return _merge(settled, prior, result._replace(undecided=undecided & problem.valid[0], certificate_rates=None))


def _with_usable_torques(problem: ScaledProblem, batch: ProblemBatch) -> ScaledProblem:
    return problem._replace(valid=problem.valid & torque_limits.usable(batch)[None])


def _binding(result: PassResult) -> Array:
    assert result.torque_multiplier is not None
    return result.torque_multiplier


@fused_cpu_kernel
def _choose(excess: Array, prior: PassResult, width: int) -> Array:
    """The limits that bind already, and those that are broken most: a 1 for each at its joint ``(B, width, j)``.

    By sums with ones and zeros, since sorting and gathering take longer for so few.
    """
    interest = jnp.where(_binding(prior) != 0, jnp.inf, excess)
    chosen = []
    for _ in range(min(width, excess.shape[1])):
        chosen.append(jax.nn.one_hot(jnp.argmax(interest, 1), excess.shape[1], dtype=excess.dtype))
        interest = jnp.where(chosen[-1] > 0, -jnp.inf, interest)
    return jnp.stack(chosen, 1)


class _TorqueLimitedProblem(NamedTuple):
    """Whitened problems with limits."""

    problem: ScaledProblem
    constraints: TorqueConstraints

    def with_proximal_term(self, proximal: ProximalTerm | None = None) -> TorqueLimitedObjective:
        return TorqueLimitedObjective(self.problem, self.constraints, proximal)

    def check_optimality(self, point: Array) -> OptimalityCheck:
        return self.with_proximal_term().check_optimality(point)

    def proof(self, check: OptimalityCheck, displacement: Array) -> Certificate:
        torques = torque_limits.torques(self.constraints, check.forces)
        beyond = torque_limits.beyond(torques, self.constraints.bound)
        return find_certificate(
            self.problem, jnp.concatenate([check.residual[:6], beyond]), displacement, self.constraints
        )


def _careful_tile(batch: ProblemBatch, prior: PassResult) -> PassResult:
    problem = _with_usable_torques(in_principal_axes(batch), batch)
    batch = torque_limits.cleaned(batch)
    constraints = torque_limits.torque_constraints(batch, problem.data, problem.scaling, None)
    point = jnp.zeros((6 + len(constraints.bound), batch.size), constraints.bound.dtype)
    undecided = jnp.zeros((1, batch.size), bool)
    start = initial_state(point, squeezing_forces(problem.data), undecided + Verdict.NOT_CONVERGED, undecided)
    state = proximal_search(_TorqueLimitedProblem(problem, constraints), start, careful_settings(point.dtype))
    joints = JointResult(
        velocities=torque_limits.velocities_by_joints(constraints, state.point[6:]),
        multiplier=constraints.scale * state.point[6:],
        rates=constraints.scale * state.certificate.direction[6:],
    )
    found = ScaledResult(
        forces=state.forces,
        multiplier=state.point[:6],
        verdict=state.verdict,
        steps=state.steps + prior.steps[None],
        certificate=state.certificate._replace(direction=state.certificate.direction[:6]),
        undecided=undecided,
        joints=joints,
    )
    result = to_result(problem, found, Route.CAREFUL)
    return _merge(_settled(batch, prior, _excess(batch, prior), problem.valid), prior, result)
