"""Problems as the solver sees them: batch-last data of order one, how they were scaled, coordinates, and their metric.

The ways to scale a problem differ in what they cost and in what they can take: the axes as they are suit most,
principal axes with whitened coordinates suit all.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.iterate import varying_like
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch, to_batch_last
from jaxgrasp.problem.coordinates import (
    Coordinates,
    Metric,
    ScaledAxes,
    metric_for,
    plain_metric,
    scaled_metric,
    sound_factors,
    whitening_scales,
)
from jaxgrasp.problem.guided_motion import whitened_coordinates
from jaxgrasp.problem.scaling import (
    Scaling,
    inertia,
    normalise,
    place_contacts,
    rotate,
    scale_by_load,
    scale_in_principal_axes,
    torque_about,
)


class ScaledProblem(NamedTuple):
    """Problems in coordinates of order one, along the last axis."""

    data: ContactData
    scaling: Scaling
    coordinates: Coordinates
    """What the numbers of a multiplier stand for."""
    metric: Metric
    """G W G^T in these coordinates."""
    valid: Array
    """Problems whose data are usable ``(1, B)``."""
    ill_conditioned: Array
    """Problems that the axes as they are do not suit."""

    @property
    def size(self) -> int:
        """B, also where all wrenches share one grasp."""
        return self.valid.shape[-1]


def in_plain_axes(problem: ProblemBatch) -> ScaledProblem:
    """Along the user's axes: what ends up ill-conditioned needs others."""
    data, valid = to_batch_last(problem)
    data, scaling = normalise(data)
    metric, coordinates, ill_conditioned = plain_metric(data)
    return ScaledProblem(data, scaling, coordinates, metric, valid, ill_conditioned)


def in_principal_axes(problem: ProblemBatch) -> ScaledProblem:
    """Along principal axes, whitened: with care, for any problem."""
    data, valid = to_batch_last(problem)
    data, scaling = scale_in_principal_axes(data)
    metric, coordinates = whitened_coordinates(problem, data, scaling)
    return ScaledProblem(data, scaling, coordinates, metric, valid, jnp.zeros_like(data.force.x, bool))


def in_suitable_axes(problem: ProblemBatch) -> ScaledProblem:
    """Each problem along axes that suit it; where a guide holds the object, with care for all."""
    if problem.free is None:
        return _in_suitable_axes(*to_batch_last(problem))
    robust = in_principal_axes(problem)
    return robust._replace(ill_conditioned=jnp.ones_like(robust.scaling.force_unit, bool))


def in_principal_or_user_axes(problem: ProblemBatch, data: ContactData, valid: Array, robust: Array) -> ScaledProblem:
    """Scale as ``in_principal_axes`` where the scalar ``robust`` is true, else along the user's axes: one program.

    ``data`` are those of the batch, or a changed copy of them.
    """
    data, scaling = scale_in_principal_axes(data, robust)
    metric, coordinates, ill_conditioned = _coordinates(problem, data, scaling, robust)
    return ScaledProblem(data, scaling, coordinates, metric, valid, ill_conditioned)


@fused_cpu_kernel
def _coordinates(
    problem: ProblemBatch, data: ContactData, scaling: Scaling, robust: Array
) -> tuple[Metric, Coordinates, Array]:
    """Metric and coordinates, whitened if ``robust``; and which problems they do not suit."""
    if problem.free is None:
        return metric_for(data, scaling, robust)
    metric, coordinates = whitened_coordinates(problem, data, scaling)
    return metric, coordinates, jnp.zeros_like(data.force.x, bool)


@fused_cpu_kernel
def _in_suitable_axes(data: ContactData, valid: Array) -> ScaledProblem:
    """Scale along the user's axes where they are well-conditioned, else along whitened principal axes.

    The second kind's work stands in a loop that ends at once where there is no such problem. Each problem's numbers
    are the same to the bit whatever problems stand beside it.
    """
    placed, where = place_contacts(data)
    matrix = inertia(placed)
    unit, zero = jnp.ones_like(matrix[0][0]), jnp.zeros_like(matrix[0][0])
    user_axes = (Vec3(unit, zero, zero), Vec3(zero, unit, zero), Vec3(zero, zero, unit))
    # Where no contact can carry a force, the identity: no principal axes are needed.
    has_contacts = where.weight_sum > 0
    pairs = zip(matrix, user_axes, strict=True)
    matrix = [[jnp.where(has_contacts, m, o) for m, o in zip(*rows, strict=False)] for rows in pairs]
    _, ill_conditioned = sound_factors(matrix)
    plain = placed._replace(torque=torque_about(where, data, compensates=False))

    def with_principal_axes(_, state):
        plain, axes, matrix, scales = state
        exact = torque_about(where, data, compensates=True)
        principal = ldl.principal_axes(matrix)
        axes = tuple(vec3.where(ill_conditioned, *pair) for pair in zip(principal, axes, strict=True))
        turned = rotate(plain._replace(torque=vec3.where(ill_conditioned, exact, plain.torque)), axes)
        along = inertia(turned)
        scales = vec3.where(ill_conditioned, whitening_scales(along, where), scales)
        return turned, axes, jax.tree.map(partial(jnp.where, ill_conditioned), along, matrix), scales

    start = varying_like((plain, user_axes, matrix, Vec3(unit, unit, unit)), placed)
    trips = jnp.any(ill_conditioned).astype(jnp.int32)
    ready, axes, matrix, scales = lax.fori_loop(0, trips, with_principal_axes, start)
    ready, scaling = scale_by_load(where, ready, axes)
    return ScaledProblem(ready, scaling, ScaledAxes(scales), scaled_metric(matrix, scales), valid, ill_conditioned)
