"""Objects that a guide holds: the coordinates of the few twists that it allows.

The guide carries whatever else is asked for, at no price, so only the wrench's work along its free twists must be
balanced: the dual is the free object's, restricted to those.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch
from jaxgrasp.problem.coordinates import Coordinates, GuidedMotion, Metric, ScaledAxes, plain_axes, whitened_metric
from jaxgrasp.problem.scaling import Scaling, inertia, rounding_growth, twist_to_scaled
from jaxgrasp.problem.spatial import SpatialVec, join, parts
from jaxgrasp.problem.tolerances import tolerances


class Mixing(NamedTuple):
    """Matrix from the user's free twists to the coordinates: constant where derivatives are taken."""

    reached: Array
    """``(B, k, k)``: a column for each coordinate."""
    lost: Array


def directions_to_scaled(free: Array, scaling: Scaling) -> Array:
    """Free twists about the user's origin ``(B, 6, k)`` in a problem's axes and lengths."""
    finite, columns = jnp.where(jnp.isfinite(free), free, 0), []
    for j in range(free.shape[-1]):
        linear, angular = twist_to_scaled(*parts(finite[..., j].T), scaling)
        columns.append(join(linear, vec3.scale(scaling.length, angular)))
    return jnp.stack(columns, -1).transpose(1, 0, 2)


def mixing(directions: Array, data: ContactData, scaling: Scaling) -> Mixing:
    """For problems in principal axes: the coordinates whose metric is the identity, but for rounding.

    The contacts' own metric is diagonal there, so its root is known to its last digit and so are singular values
    that are tiny; forming the metric along the free twists would square their condition.
    """
    rank = tolerances(directions.dtype).rank
    basis, onto = _basis(directions, scaling)
    _, singular_values, turned = _thin_svd(_root_metric(data, scaling, rank)[..., None] * basis)
    reached = (singular_values > rank * rounding_growth(scaling)[0][:, None])[:, None]
    across = onto @ jnp.swapaxes(turned, 1, 2)
    scale = 1 / jnp.where(reached, singular_values[:, None], 1)
    return Mixing(jnp.where(reached, across * scale, 0), jnp.where(reached, 0, across))


def whitened_coordinates(problem: ProblemBatch, data: ContactData, scaling: Scaling) -> tuple[Metric, Coordinates]:
    """For problems in principal axes: whitened coordinates, and G W G^T in them, the identity but for rounding."""
    if problem.free is None:
        return whitened_metric(data, scaling)
    directions = directions_to_scaled(problem.free, scaling)
    return identity_metric(data.force.x), guided_coordinates(directions, mixing(directions, data, scaling))


def unwhitened_coordinates(problem: ProblemBatch, data: ContactData, scaling: Scaling) -> Coordinates:
    """Coordinates that are the twist as it is, along orthonormal axes where a guide holds the object."""
    if problem.free is None:
        return plain_axes(data.force.x)
    directions = directions_to_scaled(problem.free, scaling)
    return GuidedMotion(_columns(_basis(directions, scaling)[0]), ())


def restricted_metric(metric: Lower, coordinates: Coordinates) -> Lower:
    """Return a metric of twists as one of the coordinates; the identity for coordinates that are unused."""
    if isinstance(coordinates, ScaledAxes):
        return metric
    rows = coordinates.curvature([list(row) for row in metric])
    idle = coordinates.unused()
    return [[*row[:-1], row[-1] + idle[i : i + 1]] for i, row in enumerate(rows)]


def guided_coordinates(directions: Array, mixed: Mixing) -> GuidedMotion:
    """Return the coordinates along free twists, mixed by the matrix ``mixed``."""
    columns, lost = (_columns(jnp.sum(directions[..., None] * m[:, None], 2)) for m in mixed)
    return GuidedMotion(columns, lost)


def identity_metric(like: Array) -> Metric:
    """G W G^T in coordinates that are scaled to make it the identity."""
    unit, zero = jnp.ones_like(like), jnp.zeros_like(like)
    matrix = [[unit], [zero, unit], [zero, zero, unit]]
    return Metric(matrix, ldl.factor(matrix))


def _basis(directions: Array, scaling: Scaling) -> tuple[Array, Array]:
    """Return an orthonormal basis of the free twists ``(B, 6, k)``, and the matrix that makes it of them ``(B, k, k)``.

    Twists that are repeated, or are sums of others, add columns of zeros; in a frame far away rounding makes such sums
    less exact.
    """
    size = jnp.sqrt(jnp.sum(directions**2, 1, keepdims=True))
    size = jnp.where(size > 0, size, 1)
    left, spread, right = _thin_svd(directions / size)
    new = (spread > tolerances(directions.dtype).rank * rounding_growth(scaling)[0][:, None])[:, None]
    onto = jnp.swapaxes(right, 1, 2) / jnp.where(new, spread[:, None], 1) / jnp.swapaxes(size, 1, 2)
    return jnp.where(new, left, 0), jnp.where(new, onto, 0)


def _thin_svd(matrix: Array) -> tuple[Array, Array, Array]:
    left, values, right = jnp.linalg.svd(matrix, full_matrices=False)
    return left, values, right


def _root_metric(data: ContactData, scaling: Scaling, rank: float) -> Array:
    """Square roots of the metric's diagonal in principal axes ``(B, 6)``."""
    matrix = inertia(data)
    cut = (rank * rounding_growth(scaling)) ** 2
    roots = [vec3.safe_sqrt(jnp.where(matrix[i][i] > cut, matrix[i][i], 0)) for i in range(3)]
    unit = jnp.ones_like(roots[0])
    return jnp.concatenate([unit, unit, unit, *roots]).T


def _columns(array: Array) -> tuple[SpatialVec, ...]:
    return tuple(array[..., j].T for j in range(array.shape[-1]))
