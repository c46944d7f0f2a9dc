"""The wrench closest to a given one that the contacts can exert."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.solution import Solution, Verdict, is_held, verdict_names
from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.numerics.no_derivative import refusing
from jaxgrasp.numerics.tiling import over_chosen
from jaxgrasp.problem import contact_vec, friction_cone, spatial
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, to_batch_last
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.flatten import Sharing
from jaxgrasp.problem.guided_motion import restricted_metric, unwhitened_coordinates
from jaxgrasp.problem.scaling import (
    Scaling,
    certificate_from_scaled,
    forces_from_scaled,
    moments_from_scaled,
    scale_in_principal_axes,
    wrench_from_scaled,
    wrench_to_scaled,
)
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.solver import dual, reach, transforms
from jaxgrasp.solver.dispatch import dispatch
from jaxgrasp.solver.dual import PlainProblem

TILE = 32
_dispatch = partial(dispatch, trailing_shapes=(("inertia", (6, 6)),))


class Reachable(NamedTuple):
    """The closest wrench that allowed forces exert, and those forces."""

    wrench: Float[Array, "*batch 6"]
    """[N, N.m] about the frame's origin."""
    forces: Float[Array, "*batch n 3"]
    """Allowed forces that exert it [N]; of all that do, those closest to the squeezing forces."""
    moments: Float[Array, "*batch n"] | None
    """About the normals of soft fingers, with those forces [N.m]; None where all contacts are hard."""
    distance: Float[Array, "*batch"]
    """Length of what is missed, wrench asked for less wrench exerted, in the metric asked for."""
    certificate: Float[Array, "*batch 6"]
    """A twist (linear, angular) about the frame's origin along which the wrench asked for works and no contact can,
    for [`jaxgrasp.verify_certificate`][]: what is missed, through the metric, of any size. Zero where nothing is."""
    verdict: Int[Array, "*batch"]
    """Code of a [`jaxgrasp.Verdict`][]: that of the optimum where the wrench asked for is reachable; INFEASIBLE
    or NO_CONTACTS where it is not and this one is the closest; NOT_CONVERGED where that could not be shown."""

    @property
    def verdict_name(self) -> Any:
        """Name of the verdict, such as ``"OPTIMAL"``; of a batch an array of names ``(*batch)``."""
        return verdict_names(self.verdict)


def reachable_wrench(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    inertia: Float[AnyArray, "*#batch 6 6"] | None = None,
    free: Float[AnyArray, "*#batch 6 k"] | None = None,
) -> Reachable:
    """Compute the wrench closest to ``wrench`` that forces inside the friction cones exert, and these forces.

    Where the wrench is reachable it is the answer itself, with the forces of
    [`jaxgrasp.constrained_optimum`][]. The missed wrench e = (force, torque) is measured by

    - |e|^2 = |force|^2 + |torque|^2 / L^2 [N^2], with the torque about the centroid of the contacts,
      weighted by the sharing, and L their weighted rms distance from it; or
    - |e|^2 = e.inertia^-1 e [N^2/kg], with ``inertia``: twice the kinetic energy that e gives to a body at
      rest in one second. The closest wrench then lets the object accelerate least.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts should exert ``(..., 6)`` [N, N.m].
        sharing: as for [`jaxgrasp.closed_form`][].
        inertia: spatial inertia about the frame's origin, in (linear, angular) order ``(..., 6, 6)``
            [kg, kg.m, kg.m^2]; symmetric, positive definite.
        free: of an object that a guide holds, the twists left to it, as for [`jaxgrasp.closed_form`][]. What is
            missed is then the shortest wrench that does its work along these.

    Returns:
        A Reachable. Where data are invalid the wrench and the forces are zero and the distance is infinite.

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
        NotImplementedError: when differentiated.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {"inertia": (inertia, (6, 6)), "free": (free, ())})
    return _dispatch(_closest, grasp, wrench, sharing, free=free, inertia=inertia)


def nearest_wrench(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    inertia: Float[AnyArray, "*#batch 6 6"] | None = None,
    free: Float[AnyArray, "*#batch 6 k"] | None = None,
) -> Reachable:
    """Compute as ``reachable_wrench`` does, for wrenches that are known to be out of reach, without another optimum.

    A wrench that is in reach is missed by the search's tolerance, and its verdict is INFEASIBLE or NOT_CONVERGED.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,))}, {"inertia": (inertia, (6, 6)), "free": (free, ())})
    return _dispatch(_nearest, grasp, wrench, sharing, free=free, inertia=inertia)


@jax.custom_jvp
def _nearest(problem: ProblemBatch, inertia: Array | None = None) -> Reachable:
    return _projected((problem, inertia), jnp.full(problem.size, Verdict.INFEASIBLE, jnp.int32))


@jax.custom_jvp
def _closest(problem: ProblemBatch, inertia: Array | None = None) -> Reachable:
    """Solve a flat batch: the constrained optimum of all, and a projection for problems without one."""
    return closest_of(problem, transforms.optimum()(problem), inertia)


def closest_of(problem: ProblemBatch, solution: Solution, inertia: Array | None = None) -> Reachable:
    """Return the closest wrenches of a flat batch whose constrained optima are known."""
    solved = is_held(solution.verdict)
    usable = solution.verdict != Verdict.INVALID_DATA
    answer = Reachable(
        wrench=jnp.where(usable[:, None], problem.wrench, 0),
        forces=jnp.where(solved[:, None, None], solution.forces, 0),
        moments=None if solution.moments is None else jnp.where(solved[:, None], solution.moments, 0),
        distance=jnp.where(usable, 0, jnp.inf).astype(problem.wrench.dtype),
        certificate=jnp.zeros_like(problem.wrench),
        verdict=solution.verdict,
    )
    if problem.size == 0:
        return answer
    return over_chosen(
        lambda arguments, prior: _projected(arguments, prior.verdict),
        (problem, inertia),
        answer,
        usable & ~solved,
        TILE,
    )


_refuse = refusing(
    "reachable_wrench has no derivatives: differentiate constrained_optimum where the wrench is reachable, "
    "wrench_margin where it is not"
)
_closest.defjvp(_refuse)
_nearest.defjvp(_refuse)


def _projected(arguments: tuple[ProblemBatch, Array | None], prior: Array) -> Reachable:
    """Return the closest wrenches of problems whose optima have the verdicts ``prior``."""
    batch, inertia = arguments
    data, valid = to_batch_last(batch)
    data, scaling = scale_in_principal_axes(data)
    full_metric, mass, sound = _metric(data, scaling, inertia)
    valid = jnp.broadcast_to(valid & sound & scaling.sound, (1, batch.size))
    coordinates = unwhitened_coordinates(batch, data, scaling)
    problem, metric = PlainProblem(data, coordinates), restricted_metric(full_metric, coordinates)
    point = reach.nearest_wrench(problem, metric, ~valid).point
    forces = _rescaled(problem, metric, point)
    batch_ones = jnp.ones_like(point[:1])
    residual = dual.residual(problem, forces)
    across = reach.solve_by(metric, residual)
    distance = jnp.sqrt(spatial.inner(residual, across))
    is_closest = _is_closest(problem, metric, forces, point, distance)
    was_unreachable = (prior == Verdict.INFEASIBLE) | (prior == Verdict.NOT_CONVERGED)
    verdict = jnp.where(was_unreachable, jnp.where(is_closest[0], Verdict.INFEASIBLE, Verdict.NOT_CONVERGED), prior)
    is_valid = valid[0]
    if batch.free is not None:
        residual = reach.times(full_metric, spatial.join(*coordinates.twist(across)))
    missed_wrench = wrench_from_scaled(scaling.force_unit * residual, scaling).T
    moments = moments_from_scaled(data, forces.spin, scaling)
    stacked = jnp.stack([c * batch_ones for c in forces_from_scaled(forces.linear, scaling)]).transpose(2, 1, 0)
    linear, angular = certificate_from_scaled(
        *coordinates.twist(vec3.safe_divide(point, spatial.length(point))), scaling
    )
    return Reachable(
        wrench=jnp.where(is_valid[:, None], batch.wrench - missed_wrench, 0),
        forces=jnp.where(is_valid[:, None, None], stacked, 0),
        moments=None if moments is None else jnp.where(is_valid[:, None], (moments * batch_ones).T, 0),
        distance=jnp.where(is_valid, (scaling.force_unit * distance / jnp.sqrt(mass))[0], jnp.inf),
        certificate=jnp.where(is_valid[:, None], spatial.join(linear, angular).T, 0),
        verdict=jnp.where(is_valid, verdict, Verdict.INVALID_DATA).astype(jnp.int32),
    )


def _metric(data: ContactData, scaling: Scaling, inertia: Array | None) -> tuple[Lower, Array, Array]:
    """Compute the metric per unit of mass in the problems' coordinates, that mass, and the mask of sound metrics."""
    batch_ones = jnp.ones_like(data.force.x)
    if inertia is None:
        return reach.identity(batch_ones), batch_ones, batch_ones > 0
    half_scaled = [wrench_to_scaled(inertia[:, :, j].T, scaling) for j in range(6)]  # A J, column by column
    scaled_inertia = [
        wrench_to_scaled(jnp.stack([column[i] for column in half_scaled]), scaling) for i in range(6)
    ]  # A (A J)^T
    mass = (scaled_inertia[0][:1] + scaled_inertia[1][1:2] + scaled_inertia[2][2:3]) / 3
    entries = [[vec3.safe_divide(scaled_inertia[i][j : j + 1], mass) for j in range(i + 1)] for i in range(6)]
    _, pivots = ldl.factor(entries)
    sound = jnp.all(jnp.concatenate([mass, *pivots]) > 0, 0, keepdims=True)
    unit = reach.identity(mass)
    metric = [[jnp.where(sound, a, b) for a, b in zip(*rows, strict=True)] for rows in zip(entries, unit, strict=True)]
    return metric, jnp.where(sound, mass, 1), sound


def _rescaled(problem: PlainProblem, metric: Lower, point: SpatialVec) -> ContactVec:
    """Compute the multiplier's forces; multiply the adjustable ones by the factor, about 1, that is closest."""
    forces = dual.candidate_forces(problem, point).forces
    adjustable, no_forces = problem.data.weights > 0, contact_vec.sub(forces, forces)
    held, free = contact_vec.where(adjustable, no_forces, forces), contact_vec.where(adjustable, forces, no_forces)
    target = dual.residual(problem, held)
    exerted = target - dual.residual(problem, forces)
    along = reach.solve_by(metric, exerted)
    square = spatial.inner(exerted, along)
    share = jnp.where(square > 0, vec3.safe_divide(spatial.inner(target, along), square), 1)
    return contact_vec.add(held, contact_vec.scale(share, free))


def _is_closest(problem: PlainProblem, metric: Lower, forces: ContactVec, point: SpatialVec, distance: Array) -> Array:
    """Check that the multiplier's direction proves that forces as large as these come no closer (Moreau)."""
    data, velocity = problem.data, dual.contact_velocities(problem, point)
    adjustable = data.weights > 0
    push = jnp.max(jnp.where(adjustable, friction_cone.work_per_normal_force(velocity, data.cone), 0), 0, keepdims=True)
    fixed = jnp.where(adjustable, 0, data.squeeze * vec3.dot(velocity.linear, data.normals))
    work = spatial.inner(dual.required_wrench(problem), point) - jnp.sum(fixed, 0, keepdims=True)
    best = work - push * dual.total_normal_force(data, forces)
    size = jnp.sqrt(spatial.inner(point, reach.times(metric, point)))
    loose = 2**10 * jnp.finfo(distance.dtype).eps ** 0.5
    return (distance > 0) & (best >= (1 - loose) * size * distance)
