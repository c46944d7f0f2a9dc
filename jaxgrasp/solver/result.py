"""What a kernel hands back for each problem, and how good it is: batch-first again, in the user's units."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.solution import Route, Verdict
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.contact_vec import ContactVec
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
from jaxgrasp.solver.coordinates import Coordinates, plain_axes


class PassResult(NamedTuple):
    """The fields of a Solution, and whether this stage leaves the problem to the next one."""

    forces: Array
    multiplier: Array
    verdict: Array
    residual: Array
    objective: Array
    steps: Array
    route: Array
    rank: Array
    certificate: Array
    undecided: Array
    moments: Array | None
    normal_multiplier: Array | None
    torque_multiplier: Array | None
    certificate_rates: Array | None


class JointResult(NamedTuple):
    """What limits of joint torques add to an outcome."""

    pull: ContactVec
    """Velocities of the contacts that the joints' multipliers take off those of the object's."""
    multiplier: Array
    """``(j, B)``, in the problem's units of the multiplier."""
    rates: Array
    """``(j, B)``: of the certificate, where that is a proof."""


class ScaledResult(NamedTuple):
    """What a stage found in the problems' own coordinates, before units."""

    forces: ContactVec
    multiplier: SpatialVec
    verdict: Array
    steps: Array
    certificate: SpatialVec
    """A twist; read only where the verdict is INFEASIBLE."""
    undecided: Array
    joints: JointResult | None = None
    """None where no joint's torque is limited."""


@fused_cpu_kernel
def to_result(
    data: ContactData,
    scaling: Scaling,
    coordinates: Coordinates,
    valid: Array,
    size: int,
    scaled_result: ScaledResult,
    route: Route | Array,
) -> PassResult:
    """The outcome in the user's axes and units, with residual and objective measured on the forces themselves."""
    valid = valid & scaling.sound
    solved = (scaled_result.verdict == Verdict.CLOSED_FORM_OPTIMAL) | (scaled_result.verdict == Verdict.OPTIMAL)
    answered = solved | (scaled_result.verdict == Verdict.OUTSIDE_CONES)
    residual, error, objective, _ = measure_forces(data, scaled_result.forces, coordinates)
    unsound = answered & ~(error <= tolerances(error.dtype).balance)
    verdict = jnp.where(unsound, Verdict.NOT_CONVERGED, scaled_result.verdict)
    verdict = jnp.where(scaling.weight > 0, verdict, Verdict.NO_CONTACTS)
    verdict = jnp.where(valid, verdict, Verdict.INVALID_DATA)
    unit = vec3.safe_divide(scaling.load, scaling.weight) * scaling.load
    linear, angular = multiplier_from_scaled(*coordinates.twist(scaled_result.multiplier), scaling)
    one = jnp.ones((1, size), error.dtype)
    certificate = _certificate(scaling, scaled_result, verdict, residual, one)
    moments = moments_from_scaled(data, scaled_result.forces.spin, scaling)
    proven, joints = verdict == Verdict.INFEASIBLE, scaled_result.joints
    return PassResult(
        forces=jnp.stack([c * one for c in forces_from_scaled(scaled_result.forces.linear, scaling)]).transpose(
            2, 1, 0
        ),
        multiplier=_rows((*linear, *angular), one),
        verdict=_row(verdict, size).astype(jnp.int32),
        residual=_row(error, size),
        objective=_row(unit * objective, size),
        steps=_row(scaled_result.steps, size).astype(jnp.int32),
        route=_row(jnp.full_like(verdict, route), size).astype(jnp.int32),
        rank=_row(rank(scaling, coordinates), size).astype(jnp.int32),
        certificate=certificate,
        undecided=_row(scaled_result.undecided & valid & (scaling.weight > 0), size),
        moments=None if moments is None else (moments * one).T,
        normal_multiplier=_normal_multipliers(data, scaling, coordinates, scaled_result, one),
        torque_multiplier=None if joints is None else (joints.multiplier * _multiplier_unit(scaling) * one).T,
        certificate_rates=None if joints is None else (jnp.where(proven, joints.rates, 0) * one).T,
    )


def _normal_multipliers(
    data: ContactData, scaling: Scaling, coordinates: Coordinates, scaled_result: ScaledResult, one: Array
) -> Array | None:
    if data.normal_min is None and data.normal_max is None:
        return None
    twist = dual.contact_velocities(data, scaled_result.multiplier, coordinates)
    if scaled_result.joints is not None:
        twist = contact_vec.sub(twist, scaled_result.joints.pull)
    return (dual.normal_multipliers(data, twist) * _multiplier_unit(scaling) * one).T


def _multiplier_unit(scaling: Scaling) -> Array:
    """A multiplier of forces in the user's units for one of the problem's."""
    return vec3.safe_divide(scaling.load, scaling.weight)


def rank(scaling: Scaling, coordinates: Coordinates) -> Array:
    return jnp.where(scaling.weight > 0, coordinates.rank(), 0)


class Measurement(NamedTuple):
    """Forces as they are, whatever they were meant to be."""

    residual: SpatialVec
    """w - G f, but for what a guide carries of it."""
    error: Array
    objective: Array
    total_normal_force: Array
    """Sum of the normal forces."""


def measure_forces(data: ContactData, forces: ContactVec, coordinates: Coordinates) -> Measurement:
    """What the forces leave of the wrench, their objective, and their backward error

    |w - G f| / (|w| + sum of |G_i| max(|f_i|, s_i)), in the problems' coordinates and as the coordinates see it: the larger.

    The squeezing force counts because f_i is computed from it: where zero is the right answer, an error
    cannot be measured against that.
    """
    plain = plain_axes(data.force.x)
    push = jnp.maximum(contact_vec.norm(forces), data.squeeze)
    spins = None if data.spin_radius is None else vec3.scale(data.spin_radius, data.normals)
    objective, total_push, *through, fx, fy, fz, tx, ty, tz = vec3.totals(
        dual.deviation_cost(data, forces),
        vec3.dot(forces.linear, data.normals),
        plain.leverage(data.points, spins) * push,
        coordinates.leverage(data.points, spins) * push,
        *dual.wrench_terms(data, forces),
    )
    force, torque = vec3.sub(data.force, Vec3(fx, fy, fz)), vec3.sub(data.torque, Vec3(tx, ty, tz))
    residual, load = (
        coordinates.not_guided(spatial.join(force, torque)),
        coordinates.not_guided(dual.required_wrench(data, plain)),
    )

    def relative(seen: Coordinates, through: Array) -> Array:
        left, asked = (spatial.length(seen.wrench(*spatial.parts(wrench))) for wrench in (residual, load))
        return vec3.safe_divide(left, asked + through)

    error = jnp.maximum(relative(plain, through[0]), relative(coordinates, through[1]))
    return Measurement(residual, error, objective, total_push)


def _certificate(
    scaling: Scaling, scaled_result: ScaledResult, verdict: Array, residual: SpatialVec, one: Array
) -> Array:
    """The stage's certificate where it proves something; with no contact at all, the unbalanced wrench itself.

    That of contacts which only squeeze may be no more than rounding, which proves nothing.
    """
    proven = verdict == Verdict.INFEASIBLE
    proof = jnp.where(proven, scaled_result.certificate, 0)
    bare = (verdict == Verdict.NO_CONTACTS) & (spatial.length(residual) > tolerances(residual.dtype).range)
    linear, angular = spatial.parts(jnp.where(bare, residual, proof))
    linear, angular = certificate_from_scaled(linear, angular, scaling)
    return _rows((*linear, *angular), one)


def _row(array: Array, size: int) -> Array:
    return jnp.broadcast_to(array[0], (size,))


def _rows(arrays: tuple[Array, ...], one: Array) -> Array:
    return jnp.concatenate([a * one for a in arrays]).T
