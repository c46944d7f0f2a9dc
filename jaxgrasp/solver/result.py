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
    """``(j, B)``, in the lane's units of the multiplier."""
    rates: Array
    """``(j, B)``: of the certificate, where that is a proof."""


class ScaledResult(NamedTuple):
    """What a stage found in the lanes' own coordinates, before units."""

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
    lanes: ContactData,
    frame: Scaling,
    unknowns: Coordinates,
    valid: Array,
    size: int,
    outcome: ScaledResult,
    route: Route | Array,
) -> PassResult:
    """The outcome in the user's axes and units, with residual and objective measured on the forces themselves."""
    valid = valid & frame.sound
    solved = (outcome.verdict == Verdict.CLOSED_FORM_OPTIMAL) | (outcome.verdict == Verdict.OPTIMAL)
    answered = solved | (outcome.verdict == Verdict.OUTSIDE_CONES)
    rest, error, objective, _ = measure_forces(lanes, outcome.forces, unknowns)
    unsound = answered & ~(error <= tolerances(error.dtype).balance)
    verdict = jnp.where(unsound, Verdict.NOT_CONVERGED, outcome.verdict)
    verdict = jnp.where(frame.weight > 0, verdict, Verdict.NO_CONTACTS)
    verdict = jnp.where(valid, verdict, Verdict.INVALID_DATA)
    unit = vec3.safe_divide(frame.load, frame.weight) * frame.load
    linear, angular = multiplier_from_scaled(*unknowns.twist(outcome.multiplier), frame)
    one = jnp.ones((1, size), error.dtype)
    certificate = _certificate(frame, outcome, verdict, rest, one)
    moments = moments_from_scaled(lanes, outcome.forces.spin, frame)
    proven, joints = verdict == Verdict.INFEASIBLE, outcome.joints
    return PassResult(
        forces=jnp.stack([c * one for c in forces_from_scaled(outcome.forces.linear, frame)]).transpose(2, 1, 0),
        multiplier=_rows((*linear, *angular), one),
        verdict=_row(verdict, size).astype(jnp.int32),
        residual=_row(error, size),
        objective=_row(unit * objective, size),
        steps=_row(outcome.steps, size).astype(jnp.int32),
        route=_row(jnp.full_like(verdict, route), size).astype(jnp.int32),
        rank=_row(rank(frame, unknowns), size).astype(jnp.int32),
        certificate=certificate,
        undecided=_row(outcome.undecided & valid & (frame.weight > 0), size),
        moments=None if moments is None else (moments * one).T,
        normal_multiplier=_normal_multipliers(lanes, frame, unknowns, outcome, one),
        torque_multiplier=None if joints is None else (joints.multiplier * _multiplier_unit(frame) * one).T,
        certificate_rates=None if joints is None else (jnp.where(proven, joints.rates, 0) * one).T,
    )


def _normal_multipliers(
    lanes: ContactData, frame: Scaling, unknowns: Coordinates, outcome: ScaledResult, one: Array
) -> Array | None:
    if lanes.least is None and lanes.most is None:
        return None
    twist = dual.contact_velocities(lanes, outcome.multiplier, unknowns)
    if outcome.joints is not None:
        twist = contact_vec.sub(twist, outcome.joints.pull)
    return (dual.normal_multipliers(lanes, twist) * _multiplier_unit(frame) * one).T


def _multiplier_unit(frame: Scaling) -> Array:
    """A multiplier of forces in the user's units for one of the lane's."""
    return vec3.safe_divide(frame.load, frame.weight)


def rank(frame: Scaling, unknowns: Coordinates) -> Array:
    return jnp.where(frame.weight > 0, unknowns.rank(), 0)


class Measurement(NamedTuple):
    """Forces as they are, whatever they were meant to be."""

    rest: SpatialVec
    """w - G f, but for what a guide carries of it."""
    error: Array
    objective: Array
    push: Array
    """Sum of the normal forces."""


def measure_forces(lanes: ContactData, forces: ContactVec, unknowns: Coordinates) -> Measurement:
    """What the forces leave of the wrench, their objective, and their backward error

    |w - G f| / (|w| + sum of |G_i| max(|f_i|, s_i)), in the lanes' coordinates and as the unknowns see it: the larger.

    The squeezing force counts because f_i is computed from it: where zero is the right answer, an error
    cannot be measured against that.
    """
    plain = plain_axes(lanes.force.x)
    push = jnp.maximum(contact_vec.norm(forces), lanes.squeeze)
    spins = None if lanes.lever is None else vec3.scale(lanes.lever, lanes.normals)
    objective, total_push, *through, fx, fy, fz, tx, ty, tz = vec3.totals(
        dual.deviation_cost(lanes, forces),
        vec3.dot(forces.linear, lanes.normals),
        plain.reach(lanes.arms, spins) * push,
        unknowns.reach(lanes.arms, spins) * push,
        *dual.wrench_terms(lanes, forces),
    )
    force, torque = vec3.sub(lanes.force, Vec3(fx, fy, fz)), vec3.sub(lanes.torque, Vec3(tx, ty, tz))
    rest, load = unknowns.felt(spatial.join(force, torque)), unknowns.felt(dual.required_wrench(lanes, plain))

    def relative(seen: Coordinates, through: Array) -> Array:
        left, asked = (spatial.length(seen.wrench(*spatial.parts(wrench))) for wrench in (rest, load))
        return vec3.safe_divide(left, asked + through)

    error = jnp.maximum(relative(plain, through[0]), relative(unknowns, through[1]))
    return Measurement(rest, error, objective, total_push)


def _certificate(frame: Scaling, outcome: ScaledResult, verdict: Array, rest: SpatialVec, one: Array) -> Array:
    """The stage's certificate where it proves something; with no contact at all, the unbalanced wrench itself.

    That of contacts which only squeeze may be no more than rounding, which proves nothing.
    """
    proven = verdict == Verdict.INFEASIBLE
    proof = jnp.where(proven, outcome.certificate, 0)
    bare = (verdict == Verdict.NO_CONTACTS) & (spatial.length(rest) > tolerances(rest.dtype).range)
    linear, angular = spatial.parts(jnp.where(bare, rest, proof))
    linear, angular = certificate_from_scaled(linear, angular, frame)
    return _rows((*linear, *angular), one)


def _row(array: Array, size: int) -> Array:
    return jnp.broadcast_to(array[0], (size,))


def _rows(arrays: tuple[Array, ...], one: Array) -> Array:
    return jnp.concatenate([a * one for a in arrays]).T
