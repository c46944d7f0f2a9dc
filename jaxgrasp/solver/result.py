"""The result of a phase for each problem, its verdict and its residual: batch-first again, in the user's units."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.solution import Route, Verdict
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.coordinates import Coordinates, ScaledAxes
from jaxgrasp.problem.scaled_problem import ScaledProblem
from jaxgrasp.problem.scaling import (
    Scaling,
    certificate_from_scaled,
    forces_from_scaled,
    moments_from_scaled,
    multiplier_from_scaled,
)
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual


class PhaseResult(NamedTuple):
    """The fields of a Solution, and whether this phase leaves the problem to the next one."""

    forces: Array
    multiplier: Array
    verdict: Array
    residual: Array
    objective: Array
    steps: Array
    route: Array
    rank: Array
    certificate: Array
    force_bound: Array
    undecided: Array
    """Problems for the next phase: those without a verdict yet, or whose load is hidden by rounding."""
    strength: Array
    """Strength of the proximal term with which an interrupted search goes on; 0 where none was interrupted."""
    moments: Array | None
    normal_multiplier: Array | None
    torque_multiplier: Array | None
    certificate_rates: Array | None


class Certificate(NamedTuple):
    """A direction, and the total normal force that it proves to be needed."""

    direction: Array
    """A twist, of limited torques over the rates of the joints."""
    force_bound: Array
    """Lower bound on the total normal force of any allowed forces of the wrench ``(1, B)``, in units of the load; 0
    where a sensible force reaches that bound, so that the direction proves nothing."""


def no_certificate(like: Array) -> Certificate:
    """Return a certificate that proves nothing, with as many rows as ``like``."""
    return Certificate(jnp.zeros_like(like), jnp.zeros_like(like[:1]))


class JointResult(NamedTuple):
    """The additions of joint torque limits to a solution."""

    velocities: ContactVec
    """Contact velocities of the joints' multipliers, which are subtracted from those of the object's."""
    multiplier: Array
    """``(j, B)``, in the problem's units of the multiplier."""
    rates: Array
    """Rates of the joints in the certificate ``(j, B)``, where that is a proof."""


class Findings(NamedTuple):
    """Outcome of a phase for each problem, before the verdict: masks ``(1, B)``."""

    infeasible: Array
    """A certificate proves that no allowed forces exist."""
    optimal: Array
    """The forces are the optimum of the problem that the phase solves; read only where it is not infeasible."""
    closed_form: Array | bool
    """The forces are the closed form, which is an answer outside the cones too."""
    feasible_only: Array | bool = False
    """The phase solved another objective with the same constraints: its forces are allowed, and may not be optimal."""
    resumable: Array | bool = False
    """Without an answer so far, more steps of the same kind may find one."""


class ScaledSolution(NamedTuple):
    """The answer of a phase in the problems' scaled coordinates."""

    forces: ContactVec
    multiplier: SpatialVec
    findings: Findings
    steps: Array
    certificate: Certificate
    """Read only where the problem is infeasible."""
    undecided: Array
    joints: JointResult | None = None
    """None where no joint's torque is limited."""


def decide_verdict(
    findings: Findings, is_balanced: Array | bool, has_contacts: Array | bool, is_valid: Array | bool
) -> Array:
    """Return the verdict of each problem from masks that broadcast against each other.

    ``is_balanced`` says that the forces balance the wrench, which they are held to where they are an answer;
    ``has_contacts``, that some contact can carry a force; ``is_valid``, that the data are numbers that can be used.
    """
    solved = jnp.where(findings.feasible_only, Verdict.FEASIBLE, Verdict.OPTIMAL)
    closed = jnp.where(findings.optimal, Verdict.CLOSED_FORM_OPTIMAL, Verdict.OUTSIDE_CONES)
    unsolved = jnp.where(findings.resumable, Verdict.OUTSIDE_CONES, Verdict.NOT_CONVERGED)
    verdict = jnp.where(findings.closed_form, closed, jnp.where(findings.optimal, solved, unsolved))
    is_answer = findings.optimal | jnp.asarray(findings.closed_form)
    verdict = jnp.where(is_answer & ~jnp.asarray(is_balanced), Verdict.NOT_CONVERGED, verdict)
    verdict = jnp.where(findings.infeasible, Verdict.INFEASIBLE, verdict)
    verdict = jnp.where(has_contacts, verdict, Verdict.NO_CONTACTS)
    return jnp.where(is_valid, verdict, Verdict.INVALID_DATA)


@fused_cpu_kernel
def to_result(
    problem: ScaledProblem, solution: ScaledSolution, route: Route | Array, balance: float | None = None
) -> PhaseResult:
    """Return the solution in the user's axes and units, with residual and objective measured on the forces themselves.

    An optimum that is not the closed form balances the load to ``balance``, by default the tolerance of the precision.
    """
    data, scaling, coordinates = problem.data, problem.scaling, problem.coordinates
    size, valid = problem.size, problem.valid & scaling.sound
    findings, has_contacts = solution.findings, scaling.weight_sum > 0
    is_answer = (findings.optimal | findings.closed_form) & ~findings.infeasible
    residual, relative_residual, hidden, objective, _ = measure_forces(problem, solution.forces)
    # Without an answer, the dual's value at the multiplier, w.x + L(f, x), below which no allowed forces are.
    bound = objective + spatial.inner(solution.multiplier, coordinates.wrench(*spatial.parts(residual)))
    objective = jnp.where(is_answer | findings.infeasible, objective, bound)
    tolerance = tolerances(relative_residual.dtype).balance
    is_balanced = relative_residual <= tolerance
    if balance is not None:
        is_balanced = is_balanced | (~jnp.asarray(findings.closed_form) & (relative_residual <= balance))
    unit = vec3.safe_divide(scaling.force_unit, scaling.weight_sum) * scaling.force_unit
    linear, angular = multiplier_from_scaled(*coordinates.twist(solution.multiplier), scaling)
    # Weights far below the forces have multipliers beyond the range of the precision.
    in_range = jnp.isfinite(vec3.taxicab(linear) + vec3.taxicab(angular) + unit * objective) | findings.feasible_only
    is_balanced = is_balanced & in_range
    verdict = decide_verdict(findings, is_balanced, has_contacts, valid)
    solved = findings.optimal & ~findings.infeasible
    more_to_do = solution.undecided | (is_answer & ~is_balanced) | (solved & hidden)
    batch_ones = jnp.ones((1, size), relative_residual.dtype)
    certificate = _certificate(scaling, solution, verdict, residual, batch_ones)
    moments = moments_from_scaled(data, solution.forces.spin, scaling)
    proven, joints = verdict == Verdict.INFEASIBLE, solution.joints
    return PhaseResult(
        forces=jnp.stack([c * batch_ones for c in forces_from_scaled(solution.forces.linear, scaling)]).transpose(
            2, 1, 0
        ),
        multiplier=_rows((*linear, *angular), batch_ones),
        verdict=_row(verdict, size).astype(jnp.int32),
        residual=_row(relative_residual, size),
        objective=_row(unit * objective, size),
        steps=_row(solution.steps, size).astype(jnp.int32),
        route=_row(jnp.full_like(verdict, route), size).astype(jnp.int32),
        rank=_row(rank(scaling, coordinates), size).astype(jnp.int32),
        certificate=certificate,
        force_bound=_row(jnp.where(proven, scaling.force_unit * solution.certificate.force_bound, 0), size),
        undecided=_row(more_to_do & valid & has_contacts, size),
        strength=jnp.zeros((size,), relative_residual.dtype),
        moments=None if moments is None else (moments * batch_ones).T,
        normal_multiplier=_normal_multipliers(problem, solution, batch_ones),
        torque_multiplier=None if joints is None else (joints.multiplier * _multiplier_unit(scaling) * batch_ones).T,
        certificate_rates=None if joints is None else (jnp.where(proven, joints.rates, 0) * batch_ones).T,
    )


def _normal_multipliers(problem: ScaledProblem, solution: ScaledSolution, batch_ones: Array) -> Array | None:
    data = problem.data
    if data.normal_min is None and data.normal_max is None:
        return None
    velocity = dual.contact_velocities(problem, solution.multiplier)
    if solution.joints is not None:
        velocity = contact_vec.sub(velocity, solution.joints.velocities)
    return (dual.normal_multipliers(data, velocity) * _multiplier_unit(problem.scaling) * batch_ones).T


def _multiplier_unit(scaling: Scaling) -> Array:
    """Return the factor from a multiplier of forces in scaled units to one in the user's units."""
    return vec3.safe_divide(scaling.force_unit, scaling.weight_sum)


def rank(scaling: Scaling, coordinates: Coordinates) -> Array:
    """Return the rank of the grasp matrix, 0 where no contact can carry a force."""
    return jnp.where(scaling.weight_sum > 0, coordinates.rank(), 0)


class Measurement(NamedTuple):
    """Residual, objective and total normal force of given forces, in the scaled problem."""

    residual: SpatialVec
    """w - G f, less the part that a guide carries."""
    relative_residual: Array
    """The residual's size relative to the load."""
    hidden: Array
    """The residual exceeds its tolerance relative to the load, and only rounding of the forces excuses it."""
    objective: Array
    total_normal_force: Array
    """Sum of the normal forces."""


def measure_forces(problem: ScaledProblem, forces: ContactVec) -> Measurement:
    """Measure the residual w - G f of forces, their objective, and the residual relative to the load.

    The relative residual is |w - G f| / max(|w|, c sum of |G_i| |f_i|), in units of length of the contacts' reach and
    in those of the coordinates: the larger; of soft fingers also ``_relative_torque``. A load may be so light beside
    the forces that their rounding hides it: c is such that a residual of rounding counts as balanced.
    """
    data, coordinates, tol = problem.data, problem.coordinates, tolerances(problem.data.force.x.dtype)
    unit = 1 / problem.scaling.unweighted_radius
    plain = ScaledAxes(Vec3(unit, unit, unit))
    size = contact_vec.norm(forces)
    spins = None if data.spin_radius is None else vec3.scale(data.spin_radius, data.normals)
    objective, total_normal_force, *force_sums, fx, fy, fz, tx, ty, tz = vec3.totals(
        dual.deviation_cost(data, forces),
        vec3.dot(forces.linear, data.normals),
        plain.wrench_bound(data.points, spins) * size,
        coordinates.wrench_bound(data.points, spins) * size,
        *dual.wrench_terms(data, forces),
    )
    force, torque = vec3.sub(data.force, Vec3(fx, fy, fz)), vec3.sub(data.torque, Vec3(tx, ty, tz))
    residual, load = (
        coordinates.not_guided(spatial.join(force, torque)),
        coordinates.not_guided(spatial.join(data.force, data.torque)),
    )

    # In units of the wrench itself, since the square of one that is far lighter than the squeeze would underflow.
    load_size = jnp.sum(jnp.abs(load), 0, keepdims=True)
    growth = jnp.where(load_size > 0, 1 / jnp.where(load_size > 0, load_size, 1), 1)

    def relative(units: Coordinates, force_sum: Array) -> tuple[Array, Array]:
        residual_size, required = (
            spatial.length(units.wrench(*spatial.parts(growth * wrench))) for wrench in (residual, load)
        )
        hidden = (required > 0) & (residual_size > tol.balance * required)
        rounded = tol.sums / tol.balance * force_sum * growth
        size = vec3.safe_divide(residual_size, jnp.maximum(required, rounded))
        # The squares of forces beyond all measure overflow.
        return jnp.where(rounded < jnp.inf, size, jnp.inf), hidden

    by_reach, by_coordinates = relative(plain, force_sums[0]), relative(coordinates, force_sums[1])
    relative_residual, hidden = jnp.maximum(by_reach[0], by_coordinates[0]), by_reach[1] | by_coordinates[1]
    # Of a guided object, whose residual is a work along the twists left to it, the coordinates measure that.
    if spins is not None and isinstance(coordinates, ScaledAxes):
        torque_residual = _relative_torque(problem, forces, spatial.parts(residual)[1])
        relative_residual = jnp.maximum(relative_residual, torque_residual)
    return Measurement(residual, relative_residual, hidden, objective, total_normal_force)


def _relative_torque(problem: ScaledProblem, forces: ContactVec, residual: Vec3) -> Array:
    """Return the unbalanced torque of soft fingers relative to the torques of forces and moments.

    A spin radius far beyond the spread of the points sets the unit of length, in which all torques of forces would pass
    for rounding. The tolerance ``torque`` corresponds to ``balance`` here.
    """
    data, scaling, tol = problem.data, problem.scaling, tolerances(residual.x.dtype)
    size = vec3.taxicab(forces.linear)
    moments = jnp.zeros_like(size)
    if forces.spin is not None and data.spin_radius is not None:
        moments = jnp.abs(data.spin_radius * forces.spin)
    sizes, torques = vec3.totals(size, vec3.taxicab(data.points) * size + moments)
    # Levers are known to the rounding of the points in the user's frame.
    lever = 64 * jnp.finfo(size.dtype).eps * vec3.norm(scaling.centre) / scaling.length
    rounding = lever * (vec3.taxicab(data.force) + sizes) / tol.balance
    return vec3.safe_divide(
        vec3.taxicab(residual), tol.torque / tol.balance * (vec3.taxicab(data.torque) + torques) + rounding
    )


def _certificate(
    scaling: Scaling, solution: ScaledSolution, verdict: Array, residual: SpatialVec, batch_ones: Array
) -> Array:
    """Return the certificate where it is a proof; with no contact at all, the unbalanced wrench itself.

    The unbalanced wrench of contacts which only squeeze may be rounding, which proves nothing.
    """
    proven = verdict == Verdict.INFEASIBLE
    proof = jnp.where(proven, solution.certificate.direction, 0)
    bare = (verdict == Verdict.NO_CONTACTS) & (spatial.length(residual) > tolerances(residual.dtype).range)
    linear, angular = spatial.parts(jnp.where(bare, residual, proof))
    linear, angular = certificate_from_scaled(linear, angular, scaling)
    return _rows((*linear, *angular), batch_ones)


def _row(array: Array, size: int) -> Array:
    return jnp.broadcast_to(array[0], (size,))


def _rows(arrays: tuple[Array, ...], batch_ones: Array) -> Array:
    return jnp.concatenate([a * batch_ones for a in arrays]).T
