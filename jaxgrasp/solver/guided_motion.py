"""Objects that a guide holds: the unknowns of the few twists that it allows.

The guide carries whatever else is asked for, at no price, so only the wrench's work along its free twists must be
balanced: the dual is the free object's, restricted to those.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxgrasp.numerics import ldl, vec3
from jaxgrasp.numerics.ldl import Lower
from jaxgrasp.problem.batch_last import ContactData, ProblemBatch
from jaxgrasp.problem.scaling import Scaling, inertia, rounding_growth, twist_to_scaled
from jaxgrasp.problem.spatial import SpatialVec, join, parts
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver.coordinates import Coordinates, GuidedMotion, ScaledAxes, plain_axes
from jaxgrasp.solver.pseudo_inverse import Metric, whitened_metric


class Mixing(NamedTuple):
    """How the unknowns come out of the free twists that the user gave: constants where derivatives are taken."""

    reached: Array
    """``(B, k, k)``: a column for each unknown."""
    lost: Array


def directions_to_scaled(free: Array, frame: Scaling) -> Array:
    """Free twists about the user's origin ``(B, 6, k)`` in a lane's axes and lengths."""
    known, columns = jnp.where(jnp.isfinite(free), free, 0), []
    for j in range(free.shape[-1]):
        linear, angular = twist_to_scaled(*parts(known[..., j].T), frame)
        columns.append(join(linear, vec3.scale(frame.length, angular)))
    return jnp.stack(columns, -1).transpose(1, 0, 2)


def mixing(directions: Array, lanes: ContactData, frame: Scaling) -> Mixing:
    """For lanes in principal axes: the unknowns whose metric is the identity, but for rounding.

    The contacts' own metric is diagonal there, so its root is known to its last digit and so are singular values
    that are tiny; forming the metric along the free twists would square their condition.
    """
    rank = tolerances(directions.dtype).rank
    basis, onto = _basis(directions, frame)
    _, seen, turned = _thin_svd(_root_metric(lanes, frame, rank)[..., None] * basis)
    reached = (seen > rank * rounding_growth(frame)[0][:, None])[:, None]
    across = onto @ jnp.swapaxes(turned, 1, 2)
    scale = 1 / jnp.where(reached, seen[:, None], 1)
    return Mixing(jnp.where(reached, across * scale, 0), jnp.where(reached, 0, across))


def whitened_coordinates(problem: ProblemBatch, lanes: ContactData, frame: Scaling) -> tuple[Metric, Coordinates]:
    """Unknowns, for lanes in principal axes, in which G W G^T is the identity but for rounding, and what it is."""
    if problem.free is None:
        return whitened_metric(lanes, frame)
    directions = directions_to_scaled(problem.free, frame)
    return identity_metric(lanes.force.x), guided_coordinates(directions, mixing(directions, lanes, frame))


def unwhitened_coordinates(problem: ProblemBatch, lanes: ContactData, frame: Scaling) -> Coordinates:
    """Unknowns that are a twist as it is, along orthonormal axes where a guide holds the object."""
    if problem.free is None:
        return plain_axes(lanes.force.x)
    directions = directions_to_scaled(problem.free, frame)
    return GuidedMotion(_columns(_basis(directions, frame)[0]), ())


def restricted_metric(metric: Lower, unknowns: Coordinates) -> Lower:
    """A metric of twists as one of the unknowns; of what is idle, the identity."""
    if isinstance(unknowns, ScaledAxes):
        return metric
    rows = unknowns.curvature([list(row) for row in metric])
    idle = unknowns.idle()
    return [[*row[:-1], row[-1] + idle[i : i + 1]] for i, row in enumerate(rows)]


def guided_coordinates(directions: Array, mixed: Mixing) -> GuidedMotion:
    """The unknowns along free twists, mixed so."""
    columns, lost = (_columns(jnp.sum(directions[..., None] * m[:, None], 2)) for m in mixed)
    return GuidedMotion(columns, lost)


def identity_metric(like: Array) -> Metric:
    """G W G^T, as unknowns see it that are scaled for that."""
    one, zero = jnp.ones_like(like), jnp.zeros_like(like)
    matrix = [[one], [zero, one], [zero, zero, one]]
    return Metric(matrix, ldl.factor(matrix))


def _basis(directions: Array, frame: Scaling) -> tuple[Array, Array]:
    """An orthonormal basis of the free twists ``(B, 6, k)``, and how it comes out of them ``(B, k, k)``.

    Twists that are given twice, or as sums of others, add columns of zeros; in a frame far away they are less exactly
    what they were meant to be.
    """
    size = jnp.sqrt(jnp.sum(directions**2, 1, keepdims=True))
    size = jnp.where(size > 0, size, 1)
    left, spread, right = _thin_svd(directions / size)
    new = (spread > tolerances(directions.dtype).rank * rounding_growth(frame)[0][:, None])[:, None]
    onto = jnp.swapaxes(right, 1, 2) / jnp.where(new, spread[:, None], 1) / jnp.swapaxes(size, 1, 2)
    return jnp.where(new, left, 0), jnp.where(new, onto, 0)


def _thin_svd(matrix: Array) -> tuple[Array, Array, Array]:
    left, values, right = jnp.linalg.svd(matrix, full_matrices=False)
    return left, values, right


def _root_metric(lanes: ContactData, frame: Scaling, rank: float) -> Array:
    """Square roots of the metric's diagonal in principal axes ``(B, 6)``."""
    matrix = inertia(lanes)
    cut = (rank * rounding_growth(frame)) ** 2
    roots = [vec3.safe_sqrt(jnp.where(matrix[i][i] > cut, matrix[i][i], 0)) for i in range(3)]
    one = jnp.ones_like(roots[0])
    return jnp.concatenate([one, one, one, *roots]).T


def _columns(array: Array) -> tuple[SpatialVec, ...]:
    return tuple(array[..., j].T for j in range(array.shape[-1]))
