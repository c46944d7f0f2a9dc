"""The dual of problems with limits of joint torques: coordinates of the object, and a rate for each joint."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl, pivoted_ldl
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.metric import add_damping, squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.solver import dual, torque_limits
from jaxgrasp.solver.dual import CandidateForces
from jaxgrasp.solver.infeasibility import find_certificate
from jaxgrasp.solver.newton import ProximalTerm, residual_damping
from jaxgrasp.solver.optimality import (
    OptimalityCheck,
    OptimalityMeasures,
    compare_with_tolerances,
    has_converged,
    without_recomputation,
)
from jaxgrasp.solver.result import Certificate, measure_forces
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
