"""What a pass returns for each problem, and how good it is: batch-first again, in the user's units."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.solution import Route, Verdict, is_optimum
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


class PassResult(NamedTuple):
    """The fields of a Solution, and whether this pass leaves the problem to the next one."""

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
    """Whether the next pass has more to say: where the verdict is none yet, or the load is hidden by rounding."""
    strength: Array
    """Strength of the proximal term with which an interrupted search goes on; 0 where none was interrupted."""
    moments: Array | None
    normal_multiplier: Array | None
    torque_multiplier: Array | None
    certificate_rates: Array | None


class Certificate(NamedTuple):
    """A direction, and what it proves."""

    direction: Array
    """A twist, of limited torques over the rates of the joints."""
    force_bound: Array
    """The total normal force that any allowed forces of the wrench would need at least ``(1, B)``, in units of the
    load; 0 where that is within any sensible force's reach, so that the direction proves nothing."""


def no_certificate(like: Array) -> Certificate:
    """One that proves nothing, of as many rows as a direction."""
    return Certificate(jnp.zeros_like(like), jnp.zeros_like(like[:1]))


class JointResult(NamedTuple):
    """What limits of joint torques add to a result."""

    velocities: ContactVec
    """Velocities of the contacts that the joints' multipliers take off those of the object's."""
    multiplier: Array
    """``(j, B)``, in the problem's units of the multiplier."""
    rates: Array
    """Rates of the joints in the certificate ``(j, B)``, where that is a proof."""


class ScaledResult(NamedTuple):
    """What a pass found in the problems' own coordinates, before units."""

    forces: ContactVec
    multiplier: SpatialVec
    verdict: Array
    steps: Array
    certificate: Certificate
    """Read only where the verdict is INFEASIBLE."""
    undecided: Array
    joints: JointResult | None = None
    """None where no joint's torque is limited."""


@fused_cpu_kernel
def to_result(problem: ScaledProblem, found: ScaledResult, route: Route | Array) -> PassResult:
    """What was found in the user's axes and units, with residual and objective measured on the forces themselves."""
    data, scaling, coordinates = problem.data, problem.scaling, problem.coordinates
    size, valid = problem.size, problem.valid & scaling.sound
    solved = is_optimum(found.verdict)
    answered = solved | (found.verdict == Verdict.OUTSIDE_CONES)
    residual, relative_residual, hidden, objective, _ = measure_forces(problem, found.forces)
    # The dual's value at the multiplier, which no allowed forces undercut.
    left = coordinates.wrench(*spatial.parts(residual))
    bound = objective + spatial.inner(found.multiplier, left)
    objective = jnp.where(found.verdict == Verdict.NOT_CONVERGED, bound, objective)
    unsound = answered & ~(relative_residual <= tolerances(relative_residual.dtype).balance)
    verdict = jnp.where(unsound, Verdict.NOT_CONVERGED, found.verdict)
    verdict = jnp.where(scaling.weight_sum > 0, verdict, Verdict.NO_CONTACTS)
    verdict = jnp.where(valid, verdict, Verdict.INVALID_DATA)
    unit = vec3.safe_divide(scaling.force_unit, scaling.weight_sum) * scaling.force_unit
    linear, angular = multiplier_from_scaled(*coordinates.twist(found.multiplier), scaling)
    one = jnp.ones((1, size), relative_residual.dtype)
    certificate = _certificate(scaling, found, verdict, residual, one)
    moments = moments_from_scaled(data, found.forces.spin, scaling)
    proven, joints = verdict == Verdict.INFEASIBLE, found.joints
    return PassResult(
        forces=jnp.stack([c * one for c in forces_from_scaled(found.forces.linear, scaling)]).transpose(2, 1, 0),
        multiplier=_rows((*linear, *angular), one),
        verdict=_row(verdict, size).astype(jnp.int32),
        residual=_row(relative_residual, size),
        objective=_row(unit * objective, size),
        steps=_row(found.steps, size).astype(jnp.int32),
        route=_row(jnp.full_like(verdict, route), size).astype(jnp.int32),
        rank=_row(rank(scaling, coordinates), size).astype(jnp.int32),
        certificate=certificate,
        force_bound=_row(jnp.where(proven, scaling.force_unit * found.certificate.force_bound, 0), size),
        undecided=_row((found.undecided | unsound | (solved & hidden)) & valid & (scaling.weight_sum > 0), size),
        strength=jnp.zeros((size,), relative_residual.dtype),
        moments=None if moments is None else (moments * one).T,
        normal_multiplier=_normal_multipliers(problem, found, one),
        torque_multiplier=None if joints is None else (joints.multiplier * _multiplier_unit(scaling) * one).T,
        certificate_rates=None if joints is None else (jnp.where(proven, joints.rates, 0) * one).T,
    )


def _normal_multipliers(problem: ScaledProblem, found: ScaledResult, one: Array) -> Array | None:
    data = problem.data
    if data.normal_min is None and data.normal_max is None:
        return None
    velocity = dual.contact_velocities(problem, found.multiplier)
    if found.joints is not None:
        velocity = contact_vec.sub(velocity, found.joints.velocities)
    return (dual.normal_multipliers(data, velocity) * _multiplier_unit(problem.scaling) * one).T


def _multiplier_unit(scaling: Scaling) -> Array:
    """A multiplier of forces in the user's units for one of the problem's."""
    return vec3.safe_divide(scaling.force_unit, scaling.weight_sum)


def rank(scaling: Scaling, coordinates: Coordinates) -> Array:
    return jnp.where(scaling.weight_sum > 0, coordinates.rank(), 0)


class Measurement(NamedTuple):
    """Residual, objective and total normal force of given forces, in the scaled problem."""

    residual: SpatialVec
    """w - G f, but for what a guide carries of it."""
    relative_residual: Array
    """The residual's size relative to the load."""
    hidden: Array
    """Whether it exceeds its tolerance relative to the load, and is excused by rounding of the forces alone."""
    objective: Array
    total_normal_force: Array
    """Sum of the normal forces."""


def measure_forces(problem: ScaledProblem, forces: ContactVec) -> Measurement:
    """The residual w - G f of the forces, their objective, and the residual relative to the load,

    |w - G f| / max(|w|, c sum of |G_i| |f_i|), for twists as the contacts' reach and as the coordinates count them: the
    larger.

    Beside the forces a load may be so light that their own rounding hides it: c is such that what rounding leaves
    counts as balanced.
    """
    data, coordinates, tol = problem.data, problem.coordinates, tolerances(problem.data.force.x.dtype)
    unit = 1 / problem.scaling.unweighted_radius
    plain = ScaledAxes(Vec3(unit, unit, unit))
    size = contact_vec.norm(forces)
    spins = None if data.spin_radius is None else vec3.scale(data.spin_radius, data.normals)
    objective, total_normal_force, *through, fx, fy, fz, tx, ty, tz = vec3.totals(
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

    def relative(seen: Coordinates, through: Array) -> tuple[Array, Array]:
        left, asked = (spatial.length(seen.wrench(*spatial.parts(wrench))) for wrench in (residual, load))
        hidden = (asked > 0) & (left > tol.balance * asked)
        return vec3.safe_divide(left, jnp.maximum(asked, tol.sums / tol.balance * through)), hidden

    as_they_are, as_seen = relative(plain, through[0]), relative(coordinates, through[1])
    relative_residual, hidden = jnp.maximum(as_they_are[0], as_seen[0]), as_they_are[1] | as_seen[1]
    return Measurement(residual, relative_residual, hidden, objective, total_normal_force)


def _certificate(scaling: Scaling, found: ScaledResult, verdict: Array, residual: SpatialVec, one: Array) -> Array:
    """The certificate of a pass where it proves something; with no contact at all, the unbalanced wrench itself.

    That of contacts which only squeeze may be no more than rounding, which proves nothing.
    """
    proven = verdict == Verdict.INFEASIBLE
    proof = jnp.where(proven, found.certificate.direction, 0)
    bare = (verdict == Verdict.NO_CONTACTS) & (spatial.length(residual) > tolerances(residual.dtype).range)
    linear, angular = spatial.parts(jnp.where(bare, residual, proof))
    linear, angular = certificate_from_scaled(linear, angular, scaling)
    return _rows((*linear, *angular), one)


def _row(array: Array, size: int) -> Array:
    return jnp.broadcast_to(array[0], (size,))


def _rows(arrays: tuple[Array, ...], one: Array) -> Array:
    return jnp.concatenate([a * one for a in arrays]).T
