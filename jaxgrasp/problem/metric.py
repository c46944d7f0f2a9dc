"""The metric G W G^T, plain or whitened; its inverse measures wrenches, |g|^2 = g.(G W G^T)^-1 g."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.coordinates import ScaledAxes, plain_axes
from jaxgrasp.problem.scaling import Placement, Scaling, inertia, rounding_growth
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances


class Metric(NamedTuple):
    """G W G^T in the problems' coordinates: the identity, and this inertia over the angular coordinates."""

    inertia: list[list[Array]]
    factors: tuple[list[list[Array]], list[Array]]


def plain_metric(data: ContactData) -> tuple[Metric, ScaledAxes, Array]:
    """Return the metric in the user's axes, scales of one, and a mask of problems too ill-conditioned for it."""
    matrix = inertia(data)
    factors, ill_conditioned = sound_factors(matrix)
    return Metric(matrix, factors), plain_axes(matrix[0][0]), ill_conditioned


def sound_factors(matrix: ldl.Lower) -> tuple[tuple[list[list[Array]], list[Array]], Array]:
    """Factor a matrix; where its pivots are too small, return the identity's factors and a mask of those problems."""
    lower, diagonal = ldl.factor(matrix)
    pivot = tolerances(diagonal[0].dtype).pivot
    # `not >=` rather than `<`, so that a NaN out of a zero pivot counts as ill.
    ill_conditioned = ~((diagonal[0] >= pivot) & (diagonal[1] >= pivot) & (diagonal[2] >= pivot))
    safe = [jnp.where(ill_conditioned, 1, d) for d in diagonal]
    return ([[jnp.where(ill_conditioned, 0, entry) for entry in row] for row in lower], safe), ill_conditioned


def metric_for(data: ContactData, scaling: Scaling, whiten: Array) -> tuple[Metric, ScaledAxes, Array]:
    """Return ``whitened_metric``, which suits every problem, or ``plain_metric``, by the scalar ``whiten``."""
    matrix = inertia(data)
    scales = Vec3(*(jnp.where(whiten, s, 1) for s in whitening_scales(matrix, scaling)))
    metric = scaled_metric(matrix, scales)
    factors, ill_conditioned = sound_factors(metric.inertia)
    return Metric(metric.inertia, factors), ScaledAxes(scales), ill_conditioned & ~whiten


def whitened_metric(data: ContactData, scaling: Scaling) -> tuple[Metric, ScaledAxes]:
    """Return the metric of problems in principal axes, in coordinates that make it the identity but for rounding.

    Axes along which the contacts have no spread get a scale of zero: no force can turn the object about them.
    """
    matrix = inertia(data)
    scales = whitening_scales(matrix, scaling)
    return scaled_metric(matrix, scales), ScaledAxes(scales)


def whitening_scales(matrix: ldl.Lower, scaling: Scaling | Placement) -> Vec3:
    """Return scales of the angular coordinates along principal axes; zero where no contact can turn the object."""
    diagonal = [matrix[i][i] for i in range(3)]
    cut = (tolerances(diagonal[0].dtype).rank * rounding_growth(scaling)) ** 2
    return Vec3(*(jnp.where(d > cut, 1 / jnp.sqrt(jnp.where(d > cut, d, 1)), 0) for d in diagonal))


def scaled_metric(matrix: ldl.Lower, scales: Vec3) -> Metric:
    """Return the metric of the inertia ``matrix`` in angular coordinates of these scales."""
    rows = [[scales[i] * scales[j] * matrix[i][j] for j in range(i + 1)] for i in range(3)]
    for i in range(3):
        rows[i][i] = jnp.where(scales[i] > 0, rows[i][i], 1)
    return Metric(rows, ldl.factor(rows))


def squared_norm(metric: Metric, gradient: SpatialVec) -> Array:
    """Return the squared norm of a wrench in the inverse metric, g.(G W G^T)^-1 g."""
    linear, angular = spatial.parts(gradient)
    return vec3.dot(linear, linear) + vec3.dot(angular, Vec3(*ldl.solve(metric.factors, angular)))


def add_damping(curvature: ldl.Lower, metric: Metric, damping: Array) -> ldl.Lower:
    """Return ``curvature + damping * metric``, lower triangles 6x6; the metric is the identity in the linear part."""
    rows = [list(row) for row in curvature]
    for i in range(3):
        rows[i][i] = rows[i][i] + damping
        for j in range(i + 1):
            rows[3 + i][3 + j] = rows[3 + i][3 + j] + damping * metric.inertia[i][j]
    return rows
