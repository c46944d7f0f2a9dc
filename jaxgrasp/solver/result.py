"""What a kernel hands back for each problem, and how good it is: batch-first again, in the user's units."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.solution import Route, Verdict
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.fused_cpu_kernel import one_kernel
from jaxgrasp.numerics.vec3 import Vec
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import Lanes
from jaxgrasp.problem.contact_vec import Four
from jaxgrasp.problem.scaling import Frame, certificate_out, forces_out, moments_out, multiplier_out
from jaxgrasp.problem.spatial import Six
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.coordinates import Unknowns, unstretched


class Answer(NamedTuple):
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


class Joints(NamedTuple):
    """What limits of joint torques add to an outcome."""

    pull: Four
    """Velocities of the contacts that the joints' multipliers take off those of the object's."""
    multiplier: Array
    """``(j, B)``, in the lane's units of the multiplier."""
    rates: Array
    """``(j, B)``: of the certificate, where that is a proof."""


class Outcome(NamedTuple):
    """What a stage found in the lanes' own coordinates, before units."""

    forces: Four
    multiplier: Six
    verdict: Array
    steps: Array
    certificate: Six
    """A twist; read only where the verdict is INFEASIBLE."""
    undecided: Array
    joints: Joints | None = None
    """None where no joint's torque is limited."""


@one_kernel
def write(
    lanes: Lanes, frame: Frame, unknowns: Unknowns, valid: Array, size: int, outcome: Outcome, route: Route | Array
) -> Answer:
    """The outcome in the user's axes and units, with residual and objective measured on the forces themselves."""
    valid = valid & frame.sound
    solved = (outcome.verdict == Verdict.CLOSED_FORM_OPTIMAL) | (outcome.verdict == Verdict.OPTIMAL)
    answered = solved | (outcome.verdict == Verdict.OUTSIDE_CONES)
    rest, error, objective, _ = measure(lanes, outcome.forces, unknowns)
    unsound = answered & ~(error <= tolerances(error.dtype).balance)
    verdict = jnp.where(unsound, Verdict.NOT_CONVERGED, outcome.verdict)
    verdict = jnp.where(frame.weight > 0, verdict, Verdict.NO_CONTACTS)
    verdict = jnp.where(valid, verdict, Verdict.INVALID_DATA)
    unit = vec3.safe_divide(frame.load, frame.weight) * frame.load
    linear, angular = multiplier_out(*unknowns.twist(outcome.multiplier), frame)
    one = jnp.ones((1, size), error.dtype)
    certificate = _certificate(frame, outcome, verdict, rest, one)
    moments = moments_out(lanes, outcome.forces.spin, frame)
    proven, joints = verdict == Verdict.INFEASIBLE, outcome.joints
    return Answer(
        forces=jnp.stack([c * one for c in forces_out(outcome.forces.linear, frame)]).transpose(2, 1, 0),
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
        normal_multiplier=_normal_prices(lanes, frame, unknowns, outcome, one),
        torque_multiplier=None if joints is None else (joints.multiplier * _price_unit(frame) * one).T,
        certificate_rates=None if joints is None else (jnp.where(proven, joints.rates, 0) * one).T,
    )


def _normal_prices(lanes: Lanes, frame: Frame, unknowns: Unknowns, outcome: Outcome, one: Array) -> Array | None:
    if lanes.least is None and lanes.most is None:
        return None
    twist = dual.twist_at(lanes, outcome.multiplier, unknowns)
    if outcome.joints is not None:
        twist = contact_vec.sub(twist, outcome.joints.pull)
    return (dual.normal_prices(lanes, twist) * _price_unit(frame) * one).T


def _price_unit(frame: Frame) -> Array:
    """A multiplier of forces in the user's units for one of the lane's."""
    return vec3.safe_divide(frame.load, frame.weight)


def rank(frame: Frame, unknowns: Unknowns) -> Array:
    return jnp.where(frame.weight > 0, unknowns.rank(), 0)


class Measured(NamedTuple):
    """Forces as they are, whatever they were meant to be."""

    rest: Six
    """w - G f, but for what a guide carries of it."""
    error: Array
    objective: Array
    push: Array
    """Sum of the normal forces."""


def measure(lanes: Lanes, forces: Four, unknowns: Unknowns) -> Measured:
    """What the forces leave of the wrench, their objective, and their backward error

    |w - G f| / (|w| + sum of |G_i| max(|f_i|, s_i)), in the lanes' coordinates and as the unknowns see it: the larger.

    The squeezing force counts because f_i is computed from it: where zero is the right answer, an error
    cannot be measured against that.
    """
    plain = unstretched(lanes.force.x)
    push = jnp.maximum(contact_vec.norm(forces), lanes.squeeze)
    spins = None if lanes.lever is None else vec3.scale(lanes.lever, lanes.normals)
    objective, total_push, *through, fx, fy, fz, tx, ty, tz = vec3.totals(
        dual.spread(lanes, forces),
        vec3.dot(forces.linear, lanes.normals),
        plain.reach(lanes.arms, spins) * push,
        unknowns.reach(lanes.arms, spins) * push,
        *dual.wrench_terms(lanes, forces),
    )
    force, torque = vec3.sub(lanes.force, Vec(fx, fy, fz)), vec3.sub(lanes.torque, Vec(tx, ty, tz))
    rest, load = unknowns.felt(spatial.six(force, torque)), unknowns.felt(dual.load(lanes, plain))

    def relative(seen: Unknowns, through: Array) -> Array:
        left, asked = (spatial.length(seen.wrench(*spatial.parts(wrench))) for wrench in (rest, load))
        return vec3.safe_divide(left, asked + through)

    error = jnp.maximum(relative(plain, through[0]), relative(unknowns, through[1]))
    return Measured(rest, error, objective, total_push)


def _certificate(frame: Frame, outcome: Outcome, verdict: Array, rest: Six, one: Array) -> Array:
    """The stage's certificate where it proves something; with no contact at all, the unbalanced wrench itself.

    That of contacts which only squeeze may be no more than rounding, which proves nothing.
    """
    proven = verdict == Verdict.INFEASIBLE
    proof = jnp.where(proven, outcome.certificate, 0)
    bare = (verdict == Verdict.NO_CONTACTS) & (spatial.length(rest) > tolerances(rest.dtype).range)
    linear, angular = spatial.parts(jnp.where(bare, rest, proof))
    linear, angular = certificate_out(linear, angular, frame)
    return _rows((*linear, *angular), one)


def _row(array: Array, size: int) -> Array:
    return jnp.broadcast_to(array[0], (size,))


def _rows(arrays: tuple[Array, ...], one: Array) -> Array:
    return jnp.concatenate([a * one for a in arrays]).T
