"""Coordinates of a multiplier, a virtual twist scaled as the contacts see it, or a guide's; and their metric G W G^T.

An object that is free moves along every twist: its coordinates are the twist itself, the angular ones scaled. One that
a guide holds moves along few: its coordinates count along those, and the rest of the six stay unused at zero.

The metric is plain or whitened; its inverse measures wrenches, |g|^2 = g.(G W G^T)^-1 g.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.numerics.vec3 import Vec3
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ContactData
from jaxgrasp.problem.scaling import Placement, Scaling, inertia, rounding_growth
from jaxgrasp.problem.spatial import SpatialVec, inner, join, parts
from jaxgrasp.problem.tolerances import tolerances


class ScaledAxes(NamedTuple):
    """The twist of a free object, its angular part scaled along the axes; a scale of 0 removes that direction.

    So directions that the contacts hardly reach are as large as the others.
    """

    scales: Vec3

    def twist(self, x: SpatialVec) -> tuple[Vec3, Vec3]:
        """Linear and angular parts of the twist that the coordinates stand for."""
        linear, angular = parts(x)
        return linear, vec3.times(self.scales, angular)

    def from_twist(self, linear: Vec3, angular: Vec3) -> SpatialVec:
        """Return the coordinates of a twist."""
        return join(linear, Vec3(*(vec3.safe_divide(a, s) for a, s in zip(angular, self.scales, strict=True))))

    def wrench(self, force: Vec3, torque: Vec3) -> SpatialVec:
        """Return the generalised force ``(6, B)`` of a wrench: its work for a unit of each coordinate."""
        return join(force, vec3.times(self.scales, torque))

    def wrenches(self, several: Array) -> Array:
        """``wrench`` of several ``(6, q, B)``."""
        return jnp.concatenate([several[:3], jnp.stack(self.scales) * several[3:]])

    def curvature(self, plain: list[list[Array]]) -> Lower:
        """Transform a symmetric 6x6 matrix over twists to one over the coordinates."""
        s = self.scales
        rows = [
            [s[i] * h for h in row[:3]] + [s[i] * s[j] * h for j, h in enumerate(row[3:])]
            for i, row in enumerate(plain[3:])
        ]
        return plain[:3] + rows

    def not_guided(self, wrench: SpatialVec) -> SpatialVec:
        """Return the part of a wrench that no guide carries."""
        return wrench

    def unreached(self, wrench: SpatialVec) -> SpatialVec:
        """Return the part of a wrench that no contact reaches."""
        force, torque = parts(wrench)
        zero = jnp.zeros_like(force.x)
        return join(Vec3(zero, zero, zero), Vec3(*(jnp.where(s > 0, 0, t) for s, t in zip(self.scales, torque))))

    def unused(self) -> SpatialVec:
        """1 for each coordinate that stands for nothing, else 0."""
        zero = Vec3(*(jnp.zeros_like(s) for s in self.scales))
        return join(zero, Vec3(*((s == 0).astype(s.dtype) for s in self.scales)))

    def wrench_bound(self, points: Vec3, spins: Vec3 | None) -> Array:
        """Bound ``(n, B)`` on |``wrench``| of a unit force at each contact; ``spins`` are normals times spin radii."""
        size2 = vec3.dot(points, points)
        reach2 = sum(s * s * (size2 - r * r) for s, r in zip(self.scales, points, strict=True))
        if spins is not None:
            turned = vec3.times(self.scales, spins)
            reach2 = reach2 + vec3.dot(turned, turned)
        return jnp.sqrt(1 + jnp.maximum(reach2, 0))

    def rank(self) -> Array:
        """Directions of wrench that the contacts reach."""
        return sum(((s > 0).astype(jnp.int32) for s in self.scales), jnp.int32(3))


class GuidedMotion(NamedTuple):
    """Twists along which a guide lets the object move, orthogonal, and scaled as the contacts see them."""

    columns: tuple[SpatialVec, ...]
    """A twist for each coordinate; zero where it is unused."""
    lost: tuple[SpatialVec, ...]
    """Twists of length 1 that the guide allows and no contact reaches; zero where there are none."""

    def twist(self, x: SpatialVec) -> tuple[Vec3, Vec3]:
        first, *remaining = [x[j : j + 1] * column for j, column in enumerate(self.columns)]
        return parts(sum(remaining, first))

    def from_twist(self, linear: Vec3, angular: Vec3) -> SpatialVec:
        twist = join(linear, angular)
        return self._padded([vec3.safe_divide(inner(c, twist), inner(c, c)) for c in self.columns])

    def wrench(self, force: Vec3, torque: Vec3) -> SpatialVec:
        joined = join(force, torque)
        return self._padded([inner(column, joined) for column in self.columns])

    def wrenches(self, several: Array) -> Array:
        components = jnp.stack([jnp.sum(column[:, None] * several, 0) for column in self.columns])
        return jnp.concatenate([components, jnp.zeros((6 - len(components), *components.shape[1:]), components.dtype)])

    def curvature(self, plain: list[list[Array]]) -> Lower:
        bent = [
            jnp.concatenate(jnp.broadcast_arrays(*ldl.multiply(plain, [c[i : i + 1] for i in range(6)])))
            for c in self.columns
        ]
        zero = jnp.zeros_like(plain[0][0])
        used = range(len(self.columns))
        return [
            [inner(self.columns[i], bent[j]) if i in used and j in used else zero for j in range(i + 1)]
            for i in range(6)
        ]

    def not_guided(self, wrench: SpatialVec) -> SpatialVec:
        along = [vec3.safe_divide(inner(c, wrench), inner(c, c)) * c for c in self.columns]
        return sum(along, self.unreached(wrench))

    def unreached(self, wrench: SpatialVec) -> SpatialVec:
        return sum((inner(direction, wrench) * direction for direction in self.lost), jnp.zeros_like(wrench))

    def unused(self) -> SpatialVec:
        zero = jnp.zeros_like(self.columns[0][:1])
        unused = [(inner(c, c) == 0).astype(zero.dtype) for c in self.columns]
        return jnp.concatenate(unused + [zero + 1] * (6 - len(unused)))

    def wrench_bound(self, points: Vec3, spins: Vec3 | None) -> Array:
        reach2 = jnp.zeros_like(points.x)
        for column in self.columns:
            linear, angular = parts(column)
            velocity = vec3.add(linear, vec3.cross(angular, points))
            reach2 = reach2 + vec3.dot(velocity, velocity)
            if spins is not None:
                reach2 = reach2 + vec3.dot(angular, spins) ** 2
        return jnp.sqrt(reach2)

    def rank(self) -> Array:
        return sum(((inner(c, c) > 0).astype(jnp.int32) for c in self.columns), jnp.int32(0))

    def _padded(self, rows: list[Array]) -> SpatialVec:
        """Pad the rows with zeros below to six."""
        zero = jnp.zeros_like(rows[0])
        return jnp.concatenate(jnp.broadcast_arrays(*rows, *[zero] * (6 - len(rows))))


Coordinates = ScaledAxes | GuidedMotion


def plain_axes(like: Array) -> ScaledAxes:
    """Return the coordinates of a free object, which are its twist."""
    unit = jnp.ones_like(like)
    return ScaledAxes(Vec3(unit, unit, unit))


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
