"""The closed form of eqs. 11 and 15 in centred coordinates: a scalar, and a 3x3 system."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.fused_cpu_kernel import fused_cpu_kernel
from jaxgrasp.numerics.shard_map_loop import varying_like
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import contact_vec, spatial
from jaxgrasp.problem.batch_last import ContactData, squeezing_forces
from jaxgrasp.problem.contact_vec import ContactVec
from jaxgrasp.problem.scaling import (
    Placement,
    Scaling,
    inertia,
    place_contacts,
    rotate,
    rounding_growth,
    scale_by_load,
    torque_about,
)
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import dual
from jaxgrasp.solver.coordinates import Coordinates, ScaledAxes, plain_axes


class Metric(NamedTuple):
    """G W G^T in the problems' coordinates: the identity, and this inertia over the angular coordinates."""

    inertia: list[list[Array]]
    factors: tuple[list[list[Array]], list[Array]]


def plain_metric(data: ContactData) -> tuple[Metric, ScaledAxes, Array]:
    """The metric in the axes as they are, its coordinates of one, and which problems are too ill-conditioned for it."""
    matrix = inertia(data)
    factors, ill_conditioned = _sound_factors(matrix)
    return Metric(matrix, factors), plain_axes(matrix[0][0]), ill_conditioned


def _sound_factors(matrix: ldl.Lower) -> tuple[tuple[list[list[Array]], list[Array]], Array]:
    """The factors of a matrix, and the problems in which its pivots are too small; there, the identity's factors."""
    lower, diagonal = ldl.factor(matrix)
    pivot = tolerances(diagonal[0].dtype).pivot
    # `not >=` rather than `<`, so that a NaN out of a zero pivot counts as ill.
    ill_conditioned = ~((diagonal[0] >= pivot) & (diagonal[1] >= pivot) & (diagonal[2] >= pivot))
    safe = [jnp.where(ill_conditioned, 1, d) for d in diagonal]
    return ([[jnp.where(ill_conditioned, 0, entry) for entry in row] for row in lower], safe), ill_conditioned


def metric_for(data: ContactData, scaling: Scaling, whiten: Array) -> tuple[Metric, ScaledAxes, Array]:
    """By the scalar ``whiten`` either ``whitened_metric``, which suits every problem, or ``plain_metric``: one code."""
    matrix = inertia(data)
    scales = Vec3(*(jnp.where(whiten, s, 1) for s in _whitening(matrix, scaling)))
    metric = _scaled_metric(matrix, scales)
    factors, ill_conditioned = _sound_factors(metric.inertia)
    return Metric(metric.inertia, factors), ScaledAxes(scales), ill_conditioned & ~whiten


def whitened_metric(data: ContactData, scaling: Scaling) -> tuple[Metric, ScaledAxes]:
    """For problems in principal axes: the coordinates that makes the metric the identity but for rounding.

    Axes along which the contacts have no spread get a coordinates of zero: no force can turn the object
    about them.
    """
    matrix = inertia(data)
    scales = _whitening(matrix, scaling)
    return _scaled_metric(matrix, scales), ScaledAxes(scales)


def _whitening(matrix: ldl.Lower, scaling: Scaling | Placement) -> Vec3:
    """Scales of the angular coordinates along principal axes; zero along those that are out of reach."""
    diagonal = [matrix[i][i] for i in range(3)]
    cut = (tolerances(diagonal[0].dtype).rank * rounding_growth(scaling)) ** 2
    return Vec3(*(jnp.where(d > cut, 1 / jnp.sqrt(jnp.where(d > cut, d, 1)), 0) for d in diagonal))


def _scaled_metric(matrix: ldl.Lower, scales: Vec3) -> Metric:
    rows = [[scales[i] * scales[j] * matrix[i][j] for j in range(i + 1)] for i in range(3)]
    for i in range(3):
        rows[i][i] = jnp.where(scales[i] > 0, rows[i][i], 1)
    return Metric(rows, ldl.factor(rows))


class ConditionedProblem(NamedTuple):
    """Each problem in coordinates that suit it."""

    data: ContactData
    scaling: Scaling
    metric: Metric
    coordinates: Coordinates
    ill_conditioned: Array
    """Problems that are too ill-conditioned for the axes as they are: along principal axes, whitened, refined."""


@fused_cpu_kernel
def conditioned(data: ContactData) -> ConditionedProblem:
    """Coordinates as they are where they will do, principal and whitened in other problems.

    What only the others need stands in a loop that ends at once where there is none. Every problem's numbers are its own,
    whatever others stand beside it.
    """
    placed, where = place_contacts(data)
    matrix = inertia(placed)
    one, zero = jnp.ones_like(matrix[0][0]), jnp.zeros_like(matrix[0][0])
    own = (Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one))
    # Problems where no contact carries anything are not worth the care.
    matrix = [[jnp.where(where.weight > 0, m, o) for m, o in zip(*rows, strict=False)] for rows in zip(matrix, own)]
    _, ill_conditioned = _sound_factors(matrix)
    plain = placed._replace(torque=torque_about(where, data, carefully=False))

    def with_care(_, state):
        plain, axes, matrix, scales = state
        exact = torque_about(where, data, carefully=True)
        found = ldl.principal_axes(matrix)
        axes = tuple(vec3.where(ill_conditioned, *pair) for pair in zip(found, axes, strict=True))
        turned = rotate(plain._replace(torque=vec3.where(ill_conditioned, exact, plain.torque)), axes)
        along = inertia(turned)
        scales = vec3.where(ill_conditioned, _whitening(along, where), scales)
        return turned, axes, jax.tree.map(partial(jnp.where, ill_conditioned), along, matrix), scales

    given = varying_like((plain, own, matrix, Vec3(one, one, one)), placed)
    ready, axes, matrix, scales = lax.fori_loop(0, jnp.any(ill_conditioned).astype(jnp.int32), with_care, given)
    ready, scaling = scale_by_load(where, ready, axes)
    return ConditionedProblem(ready, scaling, _scaled_metric(matrix, scales), ScaledAxes(scales), ill_conditioned)


def closed_multiplier(data: ContactData, coordinates: Coordinates, metric: Metric) -> SpatialVec:
    """The multiplier that balances the wrench when no cone is imposed; eq. 10 with weights."""
    return _balancing(data, squeezing_forces(data), coordinates, metric)


@fused_cpu_kernel
def refined_multiplier(
    data: ContactData, coordinates: Coordinates, metric: Metric, ill_conditioned: Array
) -> SpatialVec:
    """The same, of ``ill_conditioned`` problems corrected by what it leaves: whitened, a metric is the identity but for rounding."""

    def balance(i, multiplier: SpatialVec) -> SpatialVec:
        more = _balancing(data, forces_without_cones(data, multiplier, coordinates), coordinates, metric)
        return multiplier + jnp.where((i == 0) | ill_conditioned, more, 0)

    trips = 1 + jnp.any(ill_conditioned).astype(jnp.int32)
    start = varying_like(jnp.zeros((6, data.force.x.shape[-1]), data.squeeze.dtype), data, metric)
    return lax.fori_loop(0, trips, balance, start)


def _balancing(data: ContactData, forces: ContactVec, coordinates: Coordinates, metric: Metric) -> SpatialVec:
    """The multiplier that balances what these forces leave of the wrench."""
    linear, angular = spatial.parts(dual.residual(data, forces, coordinates))
    return spatial.join(linear, Vec3(*ldl.solve(metric.factors, angular)))


def forces_without_cones(data: ContactData, multiplier: SpatialVec, coordinates: Coordinates) -> ContactVec:
    """Forces of eq. 8 with weights: s a + k (G^T multiplier), whatever friction says."""
    twist = dual.contact_velocities(data, multiplier, coordinates)
    return contact_vec.add(squeezing_forces(data), contact_vec.scale(data.weights, twist))


def squared_norm(metric: Metric, gradient: SpatialVec) -> Array:
    """Squared length of a wrench as the contacts see it: g.(G W G^T)^-1 g."""
    linear, angular = spatial.parts(gradient)
    return vec3.dot(linear, linear) + vec3.dot(angular, Vec3(*ldl.solve(metric.factors, angular)))
