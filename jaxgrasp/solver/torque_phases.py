"""The optimum within limits of joint torques, in phases that start from the optimum without limits.

1. The optimum without limits, where its forces break none.
2. Newton's method with the few limits that are broken most, from there on; then, for what that leaves, with more.
3. The robust phase with all limits for what that leaves, and a proof where no forces exist.

The dual has the coordinates of the object, and a rate for each joint whose limit is looked at.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.model.solution import Route, Verdict, is_optimum
from jaxgrasp.numerics import ldl, pivoted_ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.tiling import over_chosen
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import ProblemBatch, squeezing_forces
from jaxgrasp.problem.coordinates import add_damping, squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem, in_plain_axes, in_principal_axes
from jaxgrasp.problem.scaling import multiplier_to_scaled
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual, torque_limits
from jaxgrasp.solver.dual import CandidateForces
from jaxgrasp.solver.infeasibility import find_certificate
from jaxgrasp.solver.newton import ProximalTerm, maximise, residual_damping
from jaxgrasp.solver.optimality import (
    OptimalityCheck,
    OptimalityMeasures,
    compare_with_tolerances,
    has_converged,
    without_recomputation,
)
from jaxgrasp.solver.proximal import initial_state, proximal_search, robust_settings
from jaxgrasp.solver.result import (
    Certificate,
    Findings,
    JointResult,
    PhaseResult,
    ScaledSolution,
    measure_forces,
    no_certificate,
    to_result,
)
from jaxgrasp.solver.torque_limits import BorderedMatrix, TorqueConstraints

LARGEST_UNROLLED = 6
"""Limits up to which a factorisation is written out: more take long to compile."""


class TorqueDualEvaluation(NamedTuple):
    """The dual at a point: value, gradient and minus Hessian, as ``dual.DualEvaluation``."""

    value: Array
    gradient: Array
    curvature: BorderedMatrix
    total_normal_force: Array


class TorqueLimitedObjective(NamedTuple):
    """The dual of problems with limits: six coordinates of the object over one rate for each constraint."""

    problem: ScaledProblem
    constraints: TorqueConstraints
    proximal: ProximalTerm | None = None

    def with_proximal_term(self, proximal: ProximalTerm) -> "TorqueLimitedObjective":
        return self._replace(proximal=proximal)

    def forces(self, point: Array) -> CandidateForces:
        by_object = dual.contact_velocities(self.problem, point[:6])
        velocities = contact_vec.sub(by_object, torque_limits.velocities_by_joints(self.constraints, point[6:]))
        return dual.candidate_forces_at(self.problem.data, velocities)

    def evaluate(self, point: Array) -> TorqueDualEvaluation:
        constraints, rates = self.constraints, point[6:]
        best = self.forces(point)
        evaluation = dual.evaluate_at(self.problem, best, point[:6])
        value = evaluation.value - jnp.sum(constraints.bound * jnp.abs(rates), 0, keepdims=True)
        curvature = torque_limits.bordered_hessian(self.problem, constraints, best, evaluation.curvature)
        gradient = jnp.concatenate([evaluation.gradient, torque_limits.torques(constraints, best.forces)])
        if self.proximal is not None:
            strength, offset = self.proximal.strength, point - self.proximal.centre
            value, gradient = value - strength * spatial.inner(offset, offset) / 2, gradient - strength * offset
            curvature = _with_identity(curvature, strength)
        # With the proximal term, since that decides too on which side of the kink it goes up.
        gradient = jnp.concatenate([gradient[:6], _gradient_by_rates(gradient[6:], rates, constraints.bound)])
        return TorqueDualEvaluation(value, gradient, curvature, evaluation.total_normal_force)

    def squared_norm(self, gradient: Array) -> Array:
        return squared_norm(self.problem.metric, gradient[:6]) + jnp.sum(gradient[6:] ** 2, 0, keepdims=True)

    def direction(self, evaluation: TorqueDualEvaluation, point: Array, damping_factor: Array) -> Array:
        damping = residual_damping(self.squared_norm(evaluation.gradient), damping_factor, self.proximal)
        plain = add_damping(evaluation.curvature.plain, self.problem.metric, damping)
        matrix = evaluation.curvature._replace(
            plain=plain, rate_block=_plus_identity(evaluation.curvature.rate_block, damping)
        )
        system = _eliminate(matrix, evaluation.gradient)
        rates, slope = point[6:], evaluation.gradient[6:]
        # A rate that is about to meet the kink goes there by itself: within Newton's step it would shorten the others'.
        lands = (rates * slope < 0) & (jnp.abs(rates) <= jnp.sqrt(self.squared_norm(evaluation.gradient)))
        at_kink = rates == 0
        free = ~lands & (~at_kink | (slope != 0))

        def without_falling(free: Array) -> tuple[Array, Array]:
            """Return Newton's step, and a mask of the rates that it moves off the kink to the falling side."""
            step = _solve(system.rate_block, system.right, free)
            return step, free & at_kink & (step * slope < 0)

        def drop_falling_rates(carry):
            free, (_, falls) = carry
            return free & ~falls, without_falling(free & ~falls)

        first = free, without_falling(free)
        _, (step, _) = lax.while_loop(lambda carry: jnp.any(carry[1][1]), drop_falling_rates, first)
        return jnp.concatenate([system.by_object(step), jnp.where(lands, -rates, step)])

    def converged(self, evaluation: TorqueDualEvaluation, point: Array) -> Array:
        norm = self.squared_norm(evaluation.gradient)
        return has_converged(
            OptimalityMeasures(
                self.problem.data, point, evaluation.gradient, norm, evaluation.value, evaluation.total_normal_force
            )
        )

    def clip_step(self, start: Array, trial: Array) -> Array:
        rates = jnp.where(start[6:] * trial[6:] < 0, 0, trial[6:])
        return jnp.concatenate([trial[:6], rates])

    def check_optimality(self, point: Array) -> OptimalityCheck:
        """Return the forces of ``point``, and whether they balance the wrench within the limits."""
        forces = without_recomputation(self.forces(point).forces)
        measured = measure_forces(self.problem, forces)
        excess = _gradient_by_rates(torque_limits.torques(self.constraints, forces), point[6:], self.constraints.bound)
        residual = jnp.concatenate([self.problem.coordinates.wrench(*spatial.parts(measured.residual)), excess])
        norm = self.squared_norm(residual)
        return compare_with_tolerances(self.problem.data, forces, point, residual, norm, measured)

    def find_certificate(self, check: OptimalityCheck, displacement: Array) -> Certificate:
        torques = torque_limits.torques(self.constraints, check.forces)
        excess = torque_limits.beyond(torques, self.constraints.bound)
        residual = jnp.concatenate([check.residual[:6], excess])
        return find_certificate(self.problem, residual, displacement, self.constraints)


def _plus_identity(matrix: Array, factor: Array) -> Array:
    return matrix + factor * jnp.eye(len(matrix), dtype=matrix.dtype)[..., None]


def _with_identity(matrix: BorderedMatrix, strength: Array) -> BorderedMatrix:
    plain = [[*row[:-1], row[-1] + strength] for row in matrix.plain]
    return matrix._replace(plain=plain, rate_block=_plus_identity(matrix.rate_block, strength))


def _gradient_by_rates(torque: Array, rates: Array, bound: Array) -> Array:
    """Return the gradient by the rates: torque - bound sign(rate), or the excess over the bound at rate 0."""
    return jnp.where(rates == 0, torque_limits.beyond(torque, bound), torque - jnp.sign(rates) * bound)


class _RateSystem(NamedTuple):
    """The equations of a step once the object's coordinates are eliminated from them: those of the rates alone."""

    rate_block: Array
    """The Schur complement ``(q, q, B)``."""
    right: Array
    still: list[Array]
    """The object's coordinates where no rate changes, each ``(1, B)``."""
    by_rates: Array
    """How they change with each rate ``(6, q, B)``."""

    def by_object(self, rates: Array) -> Array:
        """Return the object's coordinates of a step, ``(6, B)``."""
        return jnp.concatenate(self.still) - jnp.sum(self.by_rates * rates, 1)


def _eliminate(matrix: BorderedMatrix, right: Array) -> _RateSystem:
    """Eliminate the object's coordinates from matrix x = right, ``(6 + q, B)``; their block is positive definite."""
    factors = ldl.factor(matrix.plain)
    still = ldl.solve(factors, [right[i : i + 1] for i in range(6)])
    by_rates = ldl.solve(factors, list(matrix.across))
    rate_block = matrix.rate_block - sum(a[:, None] * b for a, b in zip(matrix.across, by_rates, strict=True))
    right_by_rates = right[6:] - sum(a * x for a, x in zip(matrix.across, still, strict=True))
    return _RateSystem(rate_block, right_by_rates, still, jnp.stack(by_rates))


def _solve(matrix: Array, right: Array, free: Array) -> Array:
    """Solve matrix x = right for the rates that are free; the others are zero."""
    keep = free.astype(right.dtype)
    block, right = matrix * keep * keep[:, None], keep * right
    size = range(len(right))
    if len(right) > LARGEST_UNROLLED:
        return pivoted_ldl.solve(pivoted_ldl.factor(block, 0.0), right)
    rows = [[block[i, j : j + 1] for j in range(i)] + [jnp.where(free[i], block[i, i], 1)[None]] for i in size]
    return jnp.concatenate(ldl.solve(ldl.factor(rows), [right[i : i + 1] for i in size]))


class _NewtonPhases(NamedTuple):
    """Newton phases with ``width`` limits at a time, those that bind or are broken most."""

    width: int
    steps: tuple[int, ...]
    """Evaluations of each phase, after which the unfinished are gathered again and choose their limits anew."""


NEWTON_PHASES = (_NewtonPhases(3, (4, 4, 8, 20)), _NewtonPhases(6, (10, 30)), _NewtonPhases(12, (40,)))
ROUNDING = 4.0
"""Torques may be beyond their limits by so many tolerances of forces."""
TILE = 32
ROBUST_TILE = 16


def without_torques(problem: ProblemBatch) -> ProblemBatch:
    """Return the problem without limits of torques, so that the other phases do not gather them."""
    return replace(problem, torque_bounds=None)


def within_torques(problem: ProblemBatch, result: PhaseResult) -> PhaseResult:
    """Return the optimum within the limits of torques, from the optimum without them."""
    bounds = problem.torque_bounds
    if bounds is None:
        return result
    no_rates = jnp.zeros((problem.size, bounds.torque_max.shape[-1]), result.forces.dtype)
    # A quick comparison of all; what it suspects is compared with rounding where it is gathered.
    torque = torque_limits.torques_of_forces(bounds.torque_map, result.forces, result.moments)
    broken = jnp.sum(~(jnp.abs(torque) <= bounds.torque_max), 1)
    within = broken == 0
    is_unusable = ~jnp.all(jnp.isfinite(torque) & (bounds.torque_max >= 0), 1)
    # Forces that are allowed but not the optimum are no better a start than none.
    no_start = (result.verdict == Verdict.FEASIBLE) & ~within
    verdict = jnp.where(no_start, Verdict.NOT_CONVERGED, result.verdict)
    result = result._replace(undecided=(is_optimum(result.verdict) & ~within) | is_unusable, verdict=verdict)
    no_rates = varying_like(no_rates, problem, result)
    result = result._replace(torque_multiplier=no_rates, certificate_rates=no_rates)
    # One condition around all phases, since each condition copies the results that it may change.
    return lax.cond(jnp.any(result.undecided), partial(_within, problem, broken), lambda result: result, result)


def _within(problem: ProblemBatch, broken: Array, result: PhaseResult) -> PhaseResult:
    """Run the phases; ``broken`` ``(B,)`` counts the limits that the optimum without them breaks."""
    no_rates = result.certificate_rates
    assert no_rates is not None
    # The Newton phases prove nothing.
    result = result._replace(certificate_rates=None)
    if problem.free is None:
        joints = no_rates.shape[1]
        last = next((k for k, phases in enumerate(NEWTON_PHASES) if phases.width >= joints), len(NEWTON_PHASES) - 1)
        for phases in NEWTON_PHASES[: last + 1]:
            # Where more limits are broken than a phase has room for, it would end with some of them still broken.
            is_chosen = (broken <= phases.width) | (phases == NEWTON_PHASES[last])
            result = _newton_phases(problem, result, phases, is_chosen)
    result = result._replace(certificate_rates=no_rates)
    return over_chosen(_robust_tile, problem, result, result.undecided, ROBUST_TILE)


def _newton_phases(problem: ProblemBatch, result: PhaseResult, phases: _NewtonPhases, is_chosen: Array) -> PhaseResult:
    """Run Newton's method for the undecided problems of the mask ``is_chosen``, as far as it gets."""

    def newton(index: Array, result: PhaseResult) -> PhaseResult:
        tile = partial(_newton_tile, width=phases.width, max_evaluations=jnp.asarray(phases.steps, jnp.int32)[index])
        return over_chosen(tile, problem, result, result.undecided & is_chosen, TILE)

    # A loop rather than several calls: the phases are one compiled program.
    return lax.fori_loop(0, len(phases.steps), newton, result)


def _excess(problem: ProblemBatch, result: PhaseResult) -> Array:
    """Return the excess of each torque over its limit ``(B, j)``, rounding aside, relative to the terms of its sum.

    The batch must be ``cleaned``.
    """
    bounds = problem.torque_bounds
    assert bounds is not None
    torque = torque_limits.torques_of_forces(bounds.torque_map, result.forces, result.moments)
    # Forces are known to the rounding of the largest of them.
    size = jnp.sum(jnp.abs(bounds.torque_map), (1, 2)) * jnp.max(jnp.abs(result.forces), (1, 2))[:, None]
    beyond = jnp.abs(torque) - bounds.torque_max - ROUNDING * tolerances(torque.dtype).gradient * size
    return jnp.where(beyond > 0, beyond / jnp.where(size > 0, size, 1), beyond)


def _settled(problem: ProblemBatch, prior: PhaseResult, excess: Array, valid: Array) -> Array:
    """Return a mask of the problems that no limit changes."""
    unsolved = (prior.verdict != Verdict.NOT_CONVERGED) & ~is_optimum(prior.verdict)
    return valid[0] & (unsolved | (is_optimum(prior.verdict) & ~jnp.any(excess > 0, 1)))


def _merge(settled: Array, prior: PhaseResult, result: PhaseResult) -> PhaseResult:
    prior = prior._replace(undecided=jnp.zeros_like(settled))
    return jax.tree.map(
        lambda old, new: jnp.where(jnp.expand_dims(settled, range(1, old.ndim)), old, new), prior, result
    )


def _newton_tile(batch: ProblemBatch, prior: PhaseResult, width: int, max_evaluations: Array) -> PhaseResult:
    problem = _with_usable_torques(in_plain_axes(batch), batch)
    batch = torque_limits.cleaned(batch)
    scaling, ill_conditioned = problem.scaling, problem.ill_conditioned
    excess = _excess(batch, prior)
    settled = _settled(batch, prior, excess, problem.valid)
    chosen = _choose(excess, prior, width)
    constraints = torque_limits.torque_constraints(batch, problem.data, scaling, chosen)
    objective = TorqueLimitedObjective(problem, constraints)
    twist = problem.coordinates.from_twist(*multiplier_to_scaled(prior.multiplier, scaling))
    known_rates = jnp.sum(chosen * _binding(prior)[:, None], -1).T * scaling.weight_sum / scaling.force_unit
    start = jnp.concatenate([twist, vec3.safe_divide(known_rates, constraints.scale)])
    reached = maximise(objective, start, ill_conditioned, max_evaluations)
    best, is_optimal, *_ = objective.check_optimality(reached.point)
    is_optimal = is_optimal & ~ill_conditioned
    rates = jnp.sum(chosen * (constraints.scale * reached.point[6:]).T[..., None], 1)
    velocities = torque_limits.velocities_by_joints(constraints, reached.point[6:])
    scaled = ScaledSolution(
        forces=best,
        multiplier=reached.point[:6],
        findings=Findings(infeasible=jnp.zeros_like(is_optimal), optimal=is_optimal, closed_form=False),
        steps=reached.steps + prior.steps[None],
        certificate=no_certificate(twist),
        undecided=~is_optimal,
        joints=JointResult(velocities, rates.T, 0 * rates.T),
    )
    result = to_result(problem, scaled, Route.NEWTON)
    # Limits that were not chosen may be broken now.
    undecided = (result.verdict == Verdict.NOT_CONVERGED) | jnp.any(_excess(batch, result) > 0, 1)
    return _merge(settled, prior, result._replace(undecided=undecided & problem.valid[0], certificate_rates=None))


def _with_usable_torques(problem: ScaledProblem, batch: ProblemBatch) -> ScaledProblem:
    return problem._replace(valid=problem.valid & torque_limits.usable(batch)[None])


def _binding(result: PhaseResult) -> Array:
    assert result.torque_multiplier is not None
    return result.torque_multiplier


@fused_cpu_kernel
def _choose(excess: Array, prior: PhaseResult, width: int) -> Array:
    """Choose the limits that bind and those that are broken most: a 1 for each at its joint ``(B, width, j)``.

    Ones and zeros are summed, since sorting and gathering take longer for so few.
    """
    interest = jnp.where(_binding(prior) != 0, jnp.inf, excess)
    chosen = []
    for _ in range(min(width, excess.shape[1])):
        chosen.append(jax.nn.one_hot(jnp.argmax(interest, 1), excess.shape[1], dtype=excess.dtype))
        interest = jnp.where(chosen[-1] > 0, -jnp.inf, interest)
    return jnp.stack(chosen, 1)


def _robust_tile(batch: ProblemBatch, prior: PhaseResult) -> PhaseResult:
    problem = _with_usable_torques(in_principal_axes(batch), batch)
    batch = torque_limits.cleaned(batch)
    constraints = torque_limits.torque_constraints(batch, problem.data, problem.scaling, None)
    point = jnp.zeros((6 + len(constraints.bound), batch.size), constraints.bound.dtype)
    undecided = jnp.zeros((1, batch.size), bool)
    start = initial_state(point, squeezing_forces(problem.data), undecided, undecided)
    state = proximal_search(TorqueLimitedObjective(problem, constraints), start, robust_settings(point.dtype))
    joints = JointResult(
        velocities=torque_limits.velocities_by_joints(constraints, state.point[6:]),
        multiplier=constraints.scale * state.point[6:],
        rates=constraints.scale * state.certificate.direction[6:],
    )
    scaled = ScaledSolution(
        forces=state.forces,
        multiplier=state.point[:6],
        findings=Findings(state.infeasible, state.optimal, closed_form=False),
        steps=state.steps + prior.steps[None],
        certificate=state.certificate._replace(direction=state.certificate.direction[:6]),
        undecided=undecided,
        joints=joints,
    )
    result = to_result(problem, scaled, Route.ROBUST)
    return _merge(_settled(batch, prior, _excess(batch, prior), problem.valid), prior, result)
