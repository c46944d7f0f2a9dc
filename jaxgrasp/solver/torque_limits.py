"""Limits of joint torques: |R f| <= bound, where the rows of R are what the contact forces ask of the joints.

They tie the contacts together, so that no projection of each contact alone can respect them. The dual gets one more
coordinate for each limit, its multiplier, which is a speed (rate) of its joint: with the speeds e contact i moves by
G_i^T x - R_i^T e, and the dual loses the sum of bound |e|. It is not smooth where a speed is zero: a kink, on which
all limits that do not bind stay.
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl, pivoted_ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, TorqueBounds
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.metric import squared_norm
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.scaling import Scaling
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual, newton
from jaxgrasp.solver.dual import CandidateForces, DualProblem
from jaxgrasp.solver.newton import OptimalityCheck, ProximalTerm
from jaxgrasp.solver.result import measure_forces

LARGEST_UNROLLED = 6
"""Limits up to which a factorisation is written out: more take long to compile."""


class TorqueConstraints(NamedTuple):
    """Limits of a few joints, |map f| <= bound, in scaled units; rows have length 1 in the weights of the contacts."""

    map: ContactVec
    """Components ``(q, n, B)``."""
    bound: Array
    """``(q, B)``; 1 for rows of zeros, which nothing can break."""
    scale: Array
    """``(q, B)``: a row here over the user's."""


@fused_cpu_kernel
def torque_constraints(
    problem: ProblemBatch, data: ContactData, scaling: Scaling, chosen: Array | None = None
) -> TorqueConstraints:
    """The limits of the joints ``chosen`` by a 1 for each row ``(B, q, j)``; of all joints where not given."""
    constraints, bounds = _in_scaling(problem, data, scaling, chosen)
    square = contact_vec.dot(constraints, constraints)
    # By contacts that can move; where none does, the torque is what it is.
    seen, whole = jnp.sum(data.weights * square, 1), jnp.sum(square, 1)
    size = vec3.safe_sqrt(jnp.where(seen > 0, seen, whole))
    return _scaled(constraints, bounds, vec3.safe_divide(jnp.ones_like(size), size))


def torque_constraints_scaled_by(
    scale: Array, problem: ProblemBatch, data: ContactData, scaling: Scaling
) -> TorqueConstraints:
    """The limits of all joints with lengths that are known."""
    return _scaled(*_in_scaling(problem, data, scaling, None), scale)


def _scaled(constraints: ContactVec, bounds: Array, scale: Array) -> TorqueConstraints:
    return TorqueConstraints(
        contact_vec.scale(scale[:, None], constraints), jnp.where(scale > 0, scale * bounds, 1), scale
    )


def _in_scaling(
    problem: ProblemBatch, data: ContactData, scaling: Scaling, chosen: Array | None
) -> tuple[ContactVec, Array]:
    """Rows and bounds in a problem's axes and loads; rows of zeros for joints that are not bounded."""
    assert problem.torque_bounds is not None
    maps, bounds = jnp.transpose(problem.torque_bounds.torque_map, (2, 3, 1, 0)), problem.torque_bounds.torque_max.T
    # (c, j, n, B), (j, B)
    there, bounded = vec3.dot(data.normals, data.normals) > 0, jnp.isfinite(bounds)
    maps, bounds = jnp.where(there & bounded[:, None], maps, 0), jnp.where(bounded, bounds, 0)
    if chosen is not None:
        which = jnp.transpose(chosen, (1, 2, 0))  # (q, j, B)
        maps = jnp.sum(which[:, :, None] * maps[:, None], 2)
        bounds = jnp.sum(which * bounds, 1)
    linear = Vec3(*maps[:3])
    if scaling.axes is not None:
        linear = vec3.rotate(scaling.axes, linear)
    spin = None
    if data.spin_radius is not None:
        spin = scaling.length * data.spin_radius * maps[3] if len(maps) == 4 else 0 * linear.x
    return ContactVec(linear, spin), bounds / scaling.force_unit


def usable(problem: ProblemBatch) -> Array:
    """Whether the limits of torques are numbers that can be computed with ``(B,)``."""
    given = problem.torque_bounds
    assert given is not None
    asked = jnp.sum(jnp.abs(given.torque_map), (2, 3)) <= tolerances(given.torque_map.dtype).largest
    if problem.present is not None:
        asked = asked | ~(problem.present > 0.5)
    return jnp.all(asked, 1) & jnp.all(given.torque_max >= 0, 1)


def cleaned(problem: ProblemBatch) -> ProblemBatch:
    """The problem with zeros where its map of torques has no numbers."""
    given = problem.torque_bounds
    assert given is not None
    return replace(
        problem,
        torque_bounds=TorqueBounds(jnp.where(jnp.isfinite(given.torque_map), given.torque_map, 0), given.torque_max),
    )


def torques_of_forces(torque_map: Array, forces: Array, moments: Array | None) -> Array:
    """Torques ``(B, j)`` by the user's own map and forces ``(B, n, 3)``, as they came."""
    if torque_map.shape[2] == 4:
        spins = jnp.zeros_like(forces[..., 0]) if moments is None else moments
        forces = jnp.concatenate([forces, spins[..., None]], -1)
    # A product of matrices with one axis to sum over: ten times faster than a sum over two.
    flat = torque_map.reshape(len(torque_map), -1, torque_map.shape[-1])
    return jnp.einsum("bkj,bk->bj", flat, forces.reshape(len(forces), -1), precision=lax.Precision.HIGHEST)


def torques(constraints: TorqueConstraints, forces: ContactVec) -> Array:
    """R f ``(q, B)``."""
    return jnp.sum(contact_vec.dot(constraints.map, forces), 1)


def beyond(torque: Array, bound: Array) -> Array:
    """By how much torques exceed their bounds, with their sign."""
    return jnp.sign(torque) * jnp.maximum(jnp.abs(torque) - bound, 0)


def velocities_by_joints(constraints: TorqueConstraints, rates: Array) -> ContactVec:
    """R^T e: the velocities of the contacts by the joints."""
    parts = [jnp.sum(rates[:, None] * c, 0) for c in contact_vec.components(constraints.map)]
    return contact_vec.of_components(parts)


class BorderedMatrix(NamedTuple):
    """A symmetric matrix of the object's coordinates and the rates."""

    plain: Lower
    """The 6x6 block of the object's coordinates."""
    across: Array
    """The block of both ``(6, q, B)``."""
    own: Array
    """The block of the rates ``(q, q, B)``."""


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

    def forces(self, point: Array) -> CandidateForces:
        by_object = dual.contact_velocities(self.problem, point[:6])
        velocities = contact_vec.sub(by_object, velocities_by_joints(self.constraints, point[6:]))
        return dual.candidate_forces_at(self.problem.data, velocities)

    def evaluate(self, point: Array) -> TorqueDualEvaluation:
        constraints, rates = self.constraints, point[6:]
        best = self.forces(point)
        at = dual.evaluate_at(self.problem, best, point[:6])
        value = at.value - jnp.sum(constraints.bound * jnp.abs(rates), 0, keepdims=True)
        curvature = bordered_hessian(self.problem, constraints, best, at.curvature)
        gradient = jnp.concatenate([at.gradient, torques(constraints, best.forces)])
        if self.proximal is not None:
            strength, offset = self.proximal.strength, point - self.proximal.centre
            value, gradient = value - strength * spatial.inner(offset, offset) / 2, gradient - strength * offset
            curvature = _with_identity(curvature, strength)
        # With the proximal term, since that decides too on which side of the kink it goes up.
        gradient = jnp.concatenate([gradient[:6], _gradient_by_rates(gradient[6:], rates, constraints.bound)])
        return TorqueDualEvaluation(value, gradient, curvature, at.total_normal_force)

    def squared_norm(self, gradient: Array) -> Array:
        return squared_norm(self.problem.metric, gradient[:6]) + jnp.sum(gradient[6:] ** 2, 0, keepdims=True)

    def direction(self, at: TorqueDualEvaluation, point: Array, damping_factor: Array) -> Array:
        damping = newton.damping_of(self.squared_norm(at.gradient), damping_factor, self.proximal)
        plain = newton.damped(at.curvature.plain, self.problem.metric, damping)
        matrix = at.curvature._replace(plain=plain, own=_plus_identity(at.curvature.own, damping))
        system = _eliminate(matrix, at.gradient)
        rates, slope = point[6:], at.gradient[6:]
        # What is about to meet the kink goes there by itself: in Newton's step for all it would cut the others short.
        lands = (rates * slope < 0) & (jnp.abs(rates) <= jnp.sqrt(self.squared_norm(at.gradient)))
        at_kink = rates == 0
        free = ~lands & (~at_kink | (slope != 0))

        def without_falling(free: Array) -> tuple[Array, Array]:
            """Newton's step, and what of it would leave the kink on its falling side."""
            step = _solve(system.own, system.right, free)
            return step, free & at_kink & (step * slope < 0)

        def again(carry):
            free, (_, falls) = carry
            return free & ~falls, without_falling(free & ~falls)

        first = free, without_falling(free)
        _, (step, _) = lax.while_loop(lambda carry: jnp.any(carry[1][1]), again, first)
        return jnp.concatenate([system.by_object(step), jnp.where(lands, -rates, step)])

    def converged(self, at: TorqueDualEvaluation, point: Array) -> Array:
        squared_norm = self.squared_norm(at.gradient)
        return newton.has_converged(
            self.problem.data, point, at.gradient, squared_norm, at.value, at.total_normal_force
        )

    def clip_step(self, start: Array, trial: Array) -> Array:
        rates = jnp.where(start[6:] * trial[6:] < 0, 0, trial[6:])
        return jnp.concatenate([trial[:6], rates])

    def check_optimality(self, point: Array) -> OptimalityCheck:
        """Whether the best forces for ``point`` balance the wrench and break no limit, so that both are optimal."""
        best = newton.without_recomputation(self.forces(point).forces)
        found = measure_forces(self.problem, best)
        off = _gradient_by_rates(torques(self.constraints, best), point[6:], self.constraints.bound)
        residual = jnp.concatenate([self.problem.coordinates.wrench(*spatial.parts(found.residual)), off])
        return newton.optimality_by(self.problem.data, best, point, residual, self.squared_norm(residual), found)


def bordered_hessian(
    problem: DualProblem, constraints: TorqueConstraints, best: CandidateForces, plain: Lower
) -> BorderedMatrix:
    """The curvature of the object's coordinates and of the rates."""
    bent = dual.force_change(problem.data, best, constraints.map)
    wrench = jnp.stack(jnp.broadcast_arrays(*dual.wrench_terms(problem.data, bent)))  # (6, q, n, B)
    pairs = zip(contact_vec.components(constraints.map), contact_vec.components(bent), strict=True)
    # One sum over a stack of both: they share so much work that none should compute it alone.
    sums = jnp.sum(jnp.concatenate([wrench, sum(p[:, None] * q for p, q in pairs)]), 2)
    return BorderedMatrix(plain, -problem.coordinates.wrenches(sums[:6]), sums[6:])


def full_matrix(matrix: BorderedMatrix, keep: Array) -> Array:
    """All of a matrix, ``(6 + q, 6 + q, B)``, with zeros in rows and columns of rates that are not kept ``(q, B)``."""
    size = range(6)
    corner = jnp.stack([jnp.concatenate([matrix.plain[max(i, j)][min(i, j)] for j in size]) for i in size])
    across = matrix.across * keep
    own = matrix.own * keep * keep[:, None]
    return jnp.concatenate(
        [jnp.concatenate([corner, across], 1), jnp.concatenate([jnp.swapaxes(across, 0, 1), own], 1)]
    )


def _plus_identity(matrix: Array, factor: Array) -> Array:
    return matrix + factor * jnp.eye(len(matrix), dtype=matrix.dtype)[..., None]


def _with_identity(matrix: BorderedMatrix, strength: Array) -> BorderedMatrix:
    plain = [[*row[:-1], row[-1] + strength] for row in matrix.plain]
    return matrix._replace(plain=plain, own=_plus_identity(matrix.own, strength))


def _gradient_by_rates(torque: Array, rates: Array, bound: Array) -> Array:
    """The gradient by the rates: what a torque is beyond its bound, or short of it where the rate is not zero."""
    return jnp.where(rates == 0, beyond(torque, bound), torque - jnp.sign(rates) * bound)


class _RateSystem(NamedTuple):
    """The equations of a step once the object's coordinates are eliminated from them: those of the rates alone."""

    own: Array
    """The Schur complement ``(q, q, B)``."""
    right: Array
    still: list[Array]
    """The object's coordinates where no rate changes, each ``(1, B)``."""
    by_rates: Array
    """How they change with each rate ``(6, q, B)``."""

    def by_object(self, rates: Array) -> Array:
        """The object's coordinates of a step, ``(6, B)``."""
        return jnp.concatenate(self.still) - jnp.sum(self.by_rates * rates, 1)


def _eliminate(matrix: BorderedMatrix, right: Array) -> _RateSystem:
    """What is left for the rates of matrix x = right, ``(6 + q, B)``; the block of the object is positive definite."""
    factors = ldl.factor(matrix.plain)
    still = ldl.solve(factors, [right[i : i + 1] for i in range(6)])
    by_rates = ldl.solve(factors, list(matrix.across))
    own = matrix.own - sum(a[:, None] * b for a, b in zip(matrix.across, by_rates, strict=True))
    rest = right[6:] - sum(a * x for a, x in zip(matrix.across, still, strict=True))
    return _RateSystem(own, rest, still, jnp.stack(by_rates))


def _solve(matrix: Array, right: Array, free: Array) -> Array:
    """x with matrix x = right, but zero for the rates that are not free."""
    keep = free.astype(right.dtype)
    kept, right = matrix * keep * keep[:, None], keep * right
    size = range(len(right))
    if len(right) > LARGEST_UNROLLED:
        return pivoted_ldl.solve(pivoted_ldl.factor(kept, 0.0), right)
    rows = [[kept[i, j : j + 1] for j in range(i)] + [jnp.where(free[i], kept[i, i], 1)[None]] for i in size]
    return jnp.concatenate(ldl.solve(ldl.factor(rows), [right[i : i + 1] for i in size]))
