"""Largest growth of a wrench along a direction for which allowed forces exert it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.force.limited_margin import limited_margin
from jaxgrasp.model.arguments import Progress, check_arguments
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import BOUNDS, Grasp, Limits
from jaxgrasp.numerics import vec3
from jaxgrasp.numerics.no_derivative import nan_tangents_where, refusing
from jaxgrasp.numerics.tiling import over_tiles
from jaxgrasp.problem import spatial
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.problem.flatten import Sharing
from jaxgrasp.problem.scaling import wrench_to_scaled
from jaxgrasp.problem.spatial import SpatialVec
from jaxgrasp.problem.tolerances import tolerances
from jaxgrasp.solver import reach
from jaxgrasp.solver.dispatch import dispatch
from jaxgrasp.solver.wrench_boundary import (
    BoundaryPoint,
    UnitWeightProblem,
    boundary_point,
    with_unit_weights,
    with_wrench,
    work_along,
)

TILE = 32


def wrench_margin(
    grasp: Grasp,
    wrench: Float[AnyArray, "*#batch 6"],
    direction: Float[AnyArray, "*#batch 6"],
    sharing: Sharing = "squeeze",
    *,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> Float[Array, "..."]:
    """Compute the largest theta for which forces inside the friction cones exert wrench + theta direction.

    With ``limits`` it is what this hand resists, by the normal forces that its contacts and the torques that its
    joints are able to exert: one cone program for each problem. Without, the forces may be as large as they need.
    How they are shared matters only for contacts of weight zero, which hold their squeezing force, and with limits
    carry nothing.

    Without limits, where a direction is resisted only by forces some hundred thousand
    times the load or more, the margin is not to be relied on: by contacts that lie on a line but for 1e-5 of
    its length it stops short, at what smaller forces reach; by friction beyond 1e5, or a pinch that misses
    closing by less than 1e-6, it goes too far, up to +inf.

    With limits it is found to some 1e-8 of what the contacts can exert, as a rule; in single precision to 1e-5, and
    about a quarter is left open (NaN); so is, in double precision, up to a half of the grasps whose contacts lie within
    1e-7 to 1e-2 of a line. A contact without a limit of its own presses with at most a thousand times the
    geometric mean of the others' (of the load, where there are none); a margin that rests on more is called endless.

    A thousand grasps take 0.2 to 0.7 seconds of the processor once compiled; with limits 0.4 seconds at three contacts
    to 1.3 at ten (``python -m benchmarks.margins``).

    Differentiable once, by everything but the sharing, limits too: at the limit a hyperplane bounds what the contacts
    exert, and the margin moves as that does. Where several do, the derivative is that of one.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the wrench's.
        wrench: what the contacts exert already ``(..., 6)`` [N, N.m].
        direction: of the wrench to be added ``(..., 6)``, of any size.
        sharing: as for [`jaxgrasp.closed_form`][]; with limits one of its names.
        limits: as for [`jaxgrasp.constrained_optimum`][].
        progress: as for [`jaxgrasp.least_friction`][].

    Returns:
        ``(...)``, in units of the direction. Negative where the wrench lies out of reach itself, but can be
        led back. +inf where no theta is too large, as on a force-closed grasp; -inf where no theta, positive
        or negative, is in reach, or the data are invalid; with limits NaN where rounding leaves it open, as it may
        where these leave forces no room at all (``normal_min`` is ``normal_max``). The derivative of an endless
        margin is zero, since its inverse stays zero; where there is no margin, there is none (NaN).

    Example:
        A block on a table of friction 0.5 presses on it with 10 N: 5 N push it aside.

        >>> import numpy as np
        >>> from jaxgrasp import Grasp, wrench_margin
        >>> corners = np.array([[1.0, 0, 0], [-0.5, 0.87, 0], [-0.5, -0.87, 0]])
        >>> block = Grasp(corners, np.tile([0.0, 0, 1], (3, 1)), friction=np.full(3, 0.5), squeeze=np.ones(3))
        >>> held, aside = np.array([0.0, 0, 10, 0, 0, 0]), np.array([1.0, 0, 0, 0, 0, 0])
        >>> round(float(wrench_margin(block, held, aside)), 6)
        5.0

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    check_arguments(grasp, {"wrench": (wrench, (6,)), "direction": (direction, (6,))}, {})
    if limits is None or all(getattr(limits, name, 0) is None for name in BOUNDS):
        return dispatch(_margin, grasp, wrench, sharing, direction=direction, progress=progress)
    if not isinstance(sharing, str):
        raise ValueError("sharing is an array: expected 'squeeze' or 'uniform' with limits")
    return dispatch(limited_margin, grasp, wrench, sharing, limits=limits, direction=direction, progress=progress)


@jax.custom_jvp
def _margin(problem: ProblemBatch, direction: Array) -> Array:
    return over_tiles(_margin_of_tile, (problem, direction), problem.size, TILE, problem.count)


@_margin.defjvp
def _margin_tangent(primals, tangents):
    """Differentiate by the envelope theorem: theta + n.(G f - wrench - theta direction) is stationary at the limit."""
    theta, boundary = bound_along(*primals)
    finite = jnp.isfinite(theta)
    far = jnp.where(finite, theta, 0)[:, None]

    def work(problem: ProblemBatch, direction: Array) -> Array:
        return work_along(problem, problem.wrench + far * direction, boundary)

    _, moved = jax.jvp(work, primals, tangents)
    return theta, nan_tangents_where(jnp.isneginf(theta), jnp.where(finite, moved, 0), primals, tangents)


@jax.custom_jvp
def bound_along(problem: ProblemBatch, direction: Array) -> tuple[Array, BoundaryPoint]:
    """Compute the margins of a flat batch ``(B,)`` along directions ``(B, 6)``, and the point that bounds each."""
    return over_tiles(_bound_of_tile, (problem, direction), problem.size, TILE)


bound_along.defjvp(refusing("wrench_margin has first derivatives only"))


class _Line(NamedTuple):
    """Wrenches load + theta ray."""

    unit_weight: UnitWeightProblem
    direction: SpatialVec
    """Direction of the line in the problem's axes and units, of the same size as the ray."""
    ray: SpatialVec
    """Direction of the line in the problem's coordinates, of length 1, or 0."""
    size: Array
    """Length in these of the direction that the ray stands for."""
    valid: Array


class _End(NamedTuple):
    """Point where a line leaves the reachable wrenches."""

    theta: Array
    path: reach.PenaltyPath
    """Penalty path whose multipliers are normal to the hyperplane that bounds the reachable wrenches."""


def _line(problem: ProblemBatch, direction: Array) -> _Line:
    unit_weight = with_unit_weights(problem)
    limits = tolerances(direction.dtype)
    l1_norm = jnp.sum(jnp.abs(direction.T), 0, keepdims=True)
    valid = unit_weight.valid & (l1_norm <= limits.largest) & ((l1_norm == 0) | (l1_norm >= limits.smallest))
    plain = wrench_to_scaled(jnp.where(valid, direction.T, 0), unit_weight.scaling)
    ray = unit_weight.coordinates.wrench(*spatial.parts(plain))
    size = spatial.length(ray)
    return _Line(unit_weight, vec3.safe_divide(plain, size), vec3.safe_divide(ray, size), size, valid)


def _end(line: _Line) -> _End:
    problem, metric = line.unit_weight, reach.identity(line.size)
    # Whether the contacts exert the direction itself, and then whether any theta is in reach. A loop rather than two
    # calls: they are one piece of compiled code. A plane without a normal, of length 0, confines nothing.
    load = spatial.join(problem.data.force, problem.data.torque)
    wrenches = jnp.stack(jnp.broadcast_arrays(line.direction, load))
    planes = jnp.stack([jnp.zeros_like(line.ray), line.ray])

    def nearest(wrench_and_plane: tuple[Array, Array]) -> reach.NearestWrench:
        wrench, plane = wrench_and_plane
        return reach.nearest_wrench(with_wrench(problem, wrench), metric, ~line.valid, plane)

    (_, start), (is_endless, is_reachable) = lax.map(nearest, (wrenches, planes))
    theta, path = reach.ray_search(problem, line.ray, start, is_endless | ~is_reachable)
    theta = jnp.where(is_endless, jnp.inf, theta)
    return _End(jnp.where(is_reachable & line.valid, theta, -jnp.inf), path)


def _in_units(line: _Line, end: _End) -> Array:
    finite = jnp.isfinite(end.theta)
    theta = jnp.where(finite, end.theta, 0)
    return jnp.where(finite, line.unit_weight.scaling.force_unit * vec3.safe_divide(theta, line.size), end.theta)[0]


def _margin_of_tile(arguments: tuple[ProblemBatch, Array]) -> Array:
    line = _line(*arguments)
    return _in_units(line, _end(line))


def _bound_of_tile(arguments: tuple[ProblemBatch, Array]) -> tuple[Array, BoundaryPoint]:
    line = _line(*arguments)
    end, data = _end(line), line.unit_weight.data
    return _in_units(line, end), boundary_point(line.unit_weight, data, data, end.path, line.size)
