"""The closed form of eqs. 11 and 15 in centred coordinates: a scalar, and a 3x3 system."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force import dual, fours, sixes
from jaxgrasp.force.fours import Four
from jaxgrasp.force.frame import Frame, blur, inertia
from jaxgrasp.force.lanes import Lanes, squeezing
from jaxgrasp.force.sixes import Six
from jaxgrasp.force.tolerances import tolerances
from jaxgrasp.force.unknowns import Stretch, Unknowns, unstretched
from jaxgrasp.numerics import symmetric, vec
from jaxgrasp.numerics.vec import Vec


class Metric(NamedTuple):
    """G W G^T in the lanes' coordinates: the identity, and this inertia over the angular unknowns."""

    inertia: list[list[Array]]
    factors: tuple[list[list[Array]], list[Array]]


def plain_metric(lanes: Lanes) -> tuple[Metric, Stretch, Array]:
    """The metric in the axes as they are, its unknowns of one, and which lanes are too ill-conditioned for it."""
    matrix = inertia(lanes)
    factors, ill = _sound_factors(matrix)
    return Metric(matrix, factors), unstretched(matrix[0][0]), ill


def _sound_factors(matrix: symmetric.Lower) -> tuple[tuple[list[list[Array]], list[Array]], Array]:
    """The factors of a matrix, and the lanes in which its pivots are too small; there, the identity's factors."""
    lower, diagonal = symmetric.factor(matrix)
    pivot = tolerances(diagonal[0].dtype).pivot
    # `not >=` rather than `<`, so that a NaN out of a zero pivot counts as ill.
    ill = ~((diagonal[0] >= pivot) & (diagonal[1] >= pivot) & (diagonal[2] >= pivot))
    safe = [jnp.where(ill, 1, d) for d in diagonal]
    return ([[jnp.where(ill, 0, entry) for entry in row] for row in lower], safe), ill


def metric_for(lanes: Lanes, frame: Frame, whiten: Array) -> tuple[Metric, Stretch, Array]:
    """By the scalar ``whiten`` either ``whitened_metric``, which suits every lane, or ``plain_metric``: one code."""
    metric, stretch = whitened_metric(lanes, frame, whiten)
    factors, ill = _sound_factors(metric.inertia)
    return Metric(metric.inertia, factors), stretch, ill & ~whiten


def whitened_metric(lanes: Lanes, frame: Frame, whiten: bool | Array = True) -> tuple[Metric, Stretch]:
    """For lanes in principal axes: the unknowns that makes the metric the identity but for rounding.

    Axes along which the contacts have no spread get a unknowns of zero: no force can turn the object
    about them.
    """
    matrix = inertia(lanes)
    diagonal = [matrix[i][i] for i in range(3)]
    cut = (tolerances(diagonal[0].dtype).rank * blur(frame)) ** 2
    scales = Vec(*(jnp.where(d > cut, 1 / jnp.sqrt(jnp.where(d > cut, d, 1)), 0) for d in diagonal))
    if whiten is not True:
        scales = Vec(*(jnp.where(whiten, s, 1) for s in scales))
    rows = [[scales[i] * scales[j] * matrix[i][j] for j in range(i + 1)] for i in range(3)]
    for i in range(3):
        rows[i][i] = jnp.where(scales[i] > 0, rows[i][i], 1)
    return Metric(rows, symmetric.factor(rows)), Stretch(scales)


def closed_multiplier(lanes: Lanes, unknowns: Unknowns, metric: Metric) -> Six:
    """The multiplier that balances the wrench when no cone is imposed; eq. 10 with weights."""
    return _balancing(lanes, squeezing(lanes), unknowns, metric)


def refined_multiplier(lanes: Lanes, unknowns: Unknowns, metric: Metric) -> Six:
    """The same, corrected by what it leaves unbalanced: a whitened metric is only the identity but for rounding."""

    def balance(_, multiplier: Six) -> Six:
        return multiplier + _balancing(lanes, free_forces(lanes, multiplier, unknowns), unknowns, metric)

    return lax.fori_loop(0, 2, balance, jnp.zeros((6, lanes.squeeze.shape[-1]), lanes.squeeze.dtype))


def _balancing(lanes: Lanes, forces: Four, unknowns: Unknowns, metric: Metric) -> Six:
    """The multiplier that balances what these forces leave of the wrench."""
    linear, angular = sixes.parts(dual.residual(lanes, forces, unknowns))
    return sixes.six(linear, Vec(*symmetric.solve(metric.factors, angular)))


def free_forces(lanes: Lanes, multiplier: Six, unknowns: Unknowns) -> Four:
    """Forces of eq. 8 with weights: s a + k (G^T multiplier), whatever friction says."""
    twist = dual.twist_at(lanes, multiplier, unknowns)
    return fours.add(squeezing(lanes), fours.scale(lanes.weights, twist))


def whitened_square(metric: Metric, gradient: Six) -> Array:
    """Squared length of a wrench as the contacts see it: g.(G W G^T)^-1 g."""
    linear, angular = sixes.parts(gradient)
    return vec.dot(linear, linear) + vec.dot(angular, Vec(*symmetric.solve(metric.factors, angular)))
