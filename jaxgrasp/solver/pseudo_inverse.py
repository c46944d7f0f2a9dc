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
    """G W G^T in the lanes' coordinates: the identity, and this inertia over the angular unknowns."""

    inertia: list[list[Array]]
    factors: tuple[list[list[Array]], list[Array]]


def plain_metric(lanes: ContactData) -> tuple[Metric, ScaledAxes, Array]:
    """The metric in the axes as they are, its unknowns of one, and which lanes are too ill-conditioned for it."""
    matrix = inertia(lanes)
    factors, ill = _sound_factors(matrix)
    return Metric(matrix, factors), plain_axes(matrix[0][0]), ill


def _sound_factors(matrix: ldl.Lower) -> tuple[tuple[list[list[Array]], list[Array]], Array]:
    """The factors of a matrix, and the lanes in which its pivots are too small; there, the identity's factors."""
    lower, diagonal = ldl.factor(matrix)
    pivot = tolerances(diagonal[0].dtype).pivot
    # `not >=` rather than `<`, so that a NaN out of a zero pivot counts as ill.
    ill = ~((diagonal[0] >= pivot) & (diagonal[1] >= pivot) & (diagonal[2] >= pivot))
    safe = [jnp.where(ill, 1, d) for d in diagonal]
    return ([[jnp.where(ill, 0, entry) for entry in row] for row in lower], safe), ill


def metric_for(lanes: ContactData, frame: Scaling, whiten: Array) -> tuple[Metric, ScaledAxes, Array]:
    """By the scalar ``whiten`` either ``whitened_metric``, which suits every lane, or ``plain_metric``: one code."""
    matrix = inertia(lanes)
    scales = Vec3(*(jnp.where(whiten, s, 1) for s in _whitening(matrix, frame)))
    metric = _scaled_metric(matrix, scales)
    factors, ill = _sound_factors(metric.inertia)
    return Metric(metric.inertia, factors), ScaledAxes(scales), ill & ~whiten


def whitened_metric(lanes: ContactData, frame: Scaling) -> tuple[Metric, ScaledAxes]:
    """For lanes in principal axes: the unknowns that makes the metric the identity but for rounding.

    Axes along which the contacts have no spread get a unknowns of zero: no force can turn the object
    about them.
    """
    matrix = inertia(lanes)
    scales = _whitening(matrix, frame)
    return _scaled_metric(matrix, scales), ScaledAxes(scales)


def _whitening(matrix: ldl.Lower, frame: Scaling | Placement) -> Vec3:
    """Scales of the angular unknowns along principal axes; zero along those that are out of reach."""
    diagonal = [matrix[i][i] for i in range(3)]
    cut = (tolerances(diagonal[0].dtype).rank * rounding_growth(frame)) ** 2
    return Vec3(*(jnp.where(d > cut, 1 / jnp.sqrt(jnp.where(d > cut, d, 1)), 0) for d in diagonal))


def _scaled_metric(matrix: ldl.Lower, scales: Vec3) -> Metric:
    rows = [[scales[i] * scales[j] * matrix[i][j] for j in range(i + 1)] for i in range(3)]
    for i in range(3):
        rows[i][i] = jnp.where(scales[i] > 0, rows[i][i], 1)
    return Metric(rows, ldl.factor(rows))


class ConditionedProblem(NamedTuple):
    """Each lane in coordinates that suit it."""

    lanes: ContactData
    frame: Scaling
    metric: Metric
    unknowns: Coordinates
    ill: Array
    """Lanes that are too ill-conditioned for the axes as they are: along principal axes, whitened, refined."""


@fused_cpu_kernel
def conditioned(lanes: ContactData) -> ConditionedProblem:
    """Coordinates as they are where they will do, principal and whitened in other lanes.

    What only the others need stands in a loop that ends at once where there is none. Every lane's numbers are its own,
    whatever others stand beside it.
    """
    placed, where = place_contacts(lanes)
    matrix = inertia(placed)
    one, zero = jnp.ones_like(matrix[0][0]), jnp.zeros_like(matrix[0][0])
    own = (Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one))
    # Lanes where no contact carries anything are not worth the care.
    matrix = [[jnp.where(where.weight > 0, m, o) for m, o in zip(*rows, strict=False)] for rows in zip(matrix, own)]
    _, ill = _sound_factors(matrix)
    plain = placed._replace(torque=torque_about(where, lanes, carefully=False))

    def with_care(_, state):
        plain, axes, matrix, scales = state
        exact = torque_about(where, lanes, carefully=True)
        found = ldl.principal_axes(matrix)
        axes = tuple(vec3.where(ill, *pair) for pair in zip(found, axes, strict=True))
        turned = rotate(plain._replace(torque=vec3.where(ill, exact, plain.torque)), axes)
        along = inertia(turned)
        scales = vec3.where(ill, _whitening(along, where), scales)
        return turned, axes, jax.tree.map(partial(jnp.where, ill), along, matrix), scales

    given = varying_like((plain, own, matrix, Vec3(one, one, one)), placed)
    ready, axes, matrix, scales = lax.fori_loop(0, jnp.any(ill).astype(jnp.int32), with_care, given)
    ready, frame = scale_by_load(where, ready, axes)
    return ConditionedProblem(ready, frame, _scaled_metric(matrix, scales), ScaledAxes(scales), ill)


def closed_multiplier(lanes: ContactData, unknowns: Coordinates, metric: Metric) -> SpatialVec:
    """The multiplier that balances the wrench when no cone is imposed; eq. 10 with weights."""
    return _balancing(lanes, squeezing_forces(lanes), unknowns, metric)


@fused_cpu_kernel
def refined_multiplier(lanes: ContactData, unknowns: Coordinates, metric: Metric, ill: Array) -> SpatialVec:
    """The same, of ``ill`` lanes corrected by what it leaves: whitened, a metric is the identity but for rounding."""

    def balance(i, multiplier: SpatialVec) -> SpatialVec:
        more = _balancing(lanes, forces_without_cones(lanes, multiplier, unknowns), unknowns, metric)
        return multiplier + jnp.where((i == 0) | ill, more, 0)

    trips = 1 + jnp.any(ill).astype(jnp.int32)
    start = varying_like(jnp.zeros((6, lanes.force.x.shape[-1]), lanes.squeeze.dtype), lanes, metric)
    return lax.fori_loop(0, trips, balance, start)


def _balancing(lanes: ContactData, forces: ContactVec, unknowns: Coordinates, metric: Metric) -> SpatialVec:
    """The multiplier that balances what these forces leave of the wrench."""
    linear, angular = spatial.parts(dual.residual(lanes, forces, unknowns))
    return spatial.join(linear, Vec3(*ldl.solve(metric.factors, angular)))


def forces_without_cones(lanes: ContactData, multiplier: SpatialVec, unknowns: Coordinates) -> ContactVec:
    """Forces of eq. 8 with weights: s a + k (G^T multiplier), whatever friction says."""
    twist = dual.contact_velocities(lanes, multiplier, unknowns)
    return contact_vec.add(squeezing_forces(lanes), contact_vec.scale(lanes.weights, twist))


def squared_norm(metric: Metric, gradient: SpatialVec) -> Array:
    """Squared length of a wrench as the contacts see it: g.(G W G^T)^-1 g."""
    linear, angular = spatial.parts(gradient)
    return vec3.dot(linear, linear) + vec3.dot(angular, Vec3(*ldl.solve(metric.factors, angular)))
