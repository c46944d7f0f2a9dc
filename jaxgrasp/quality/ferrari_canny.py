"""The largest disturbance that a grasp resists whichever way it pushes: the radius of its ball of wrenches."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arguments import Progress
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.problem.wrench_discs import (
    About,
    Ellipsoid,
    Length,
    WrenchDiscs,
    differentiable_where,
    measured_discs,
    work,
)
from jaxgrasp.quality.closure import decide_all
from jaxgrasp.quality.grasp_input import (
    call_on_host,
    check_tolerance,
    count_of,
    in_turn,
    is_traced,
    range_of,
    read_grasps,
    with_derivative_of,
)
from jaxgrasp.quality.largest_ball import Balls, RoundedBodies, largest_balls, rounded
from jaxgrasp.quality.refine_facet import TouchingPoints, touch
from jaxgrasp.quality.wrench_sets import Bound, WrenchSets, check_bound, check_sides, pyramid
from jaxgrasp.validation.checked import checked

MAX_POINTS = 1000
FINER = (1e-2, 1e-4, 1e-6)
"""Parts of the tolerance that the search goes on to where the point of touch is not found from where it ended: on a few
grasps in a hundred, mostly by the first."""
LOCATED = 1e-6
"""Relative distance of the bounds with which the hardest wrench is located, whatever the tolerance."""
TOLERANCE = 1e-3
"""Relative distance of the bounds at which the search ends where no other is given."""
FINEST = 1e-9
"""The least tolerance that this is tried with: by finer ones rounding makes facets without end."""


class Epsilon(NamedTuple):
    """The radius of the largest ball of wrenches that a batch of grasps can exert, and where it ends."""

    lower: np.ndarray
    """``(...)`` [1, newtons per newton]: proven; 0 where the grasp is not closed."""
    upper: np.ndarray
    """``(...)``: proven."""
    direction: np.ndarray
    """``(..., 6)``: of the wrench (force, torque / length) about ``about`` that is hardest to exert, of length 1; with
    an ellipsoid of semi-axes A the wrench that is hardest for its size is A times the direction."""
    normal_force: np.ndarray
    """``(..., n)``: normal forces with which the grasp exerts ``upper`` times that wrench; zeros where it is not
    closed."""
    tangential: np.ndarray
    """``(..., n, 3)``: parts of the largest friction along two tangents, and of a soft finger's moment, times that
    force."""
    converged: np.ndarray
    """``(...)``: whether the bounds are within ``tol`` of each other, relative to the upper one. Where they are not,
    ``max_points`` or the room for the search's surfaces ended it, or rounding of the data alone, which is added to the
    bounds, is more than ``tol`` of the radius."""
    located: np.ndarray
    """``(...)``: whether the search itself came within ``tol``, or within 1e-6 where that is less, before rounding of
    the data was added: only there do ``direction`` and the forces belong to the radius, and only there has it a
    derivative (NaN elsewhere)."""

    def __str__(self) -> str:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        masks = {"closed": lower > 0, "not closed": upper <= 0, "undecided": (lower <= 0) & (upper > 0)}
        unconverged = count_of({"with bounds further apart than tol": (lower > 0) & ~np.asarray(self.converged)})
        note = "" if unconverged == "none" else f"; {unconverged}"
        return f"Epsilon: {count_of(masks)}; lower bound {range_of(lower)}; upper bound {range_of(upper)}{note}"


@checked
def ferrari_canny(
    grasp: Grasp,
    bound: Bound = "l1",
    *,
    sides: int | None = None,
    length: Length = None,
    about: About = None,
    ellipsoid: Ellipsoid = None,
    tol: float = TOLERANCE,
    max_points: int = MAX_POINTS,
    progress: Progress | None = None,
) -> Epsilon:
    """Compute proven bounds of the radius of the largest ball around the origin in the grasp's wrench space.

    It is the least of all h(d) over unit d, where h(d) is the largest power along the twist d of forces within
    friction whose normal forces have a sum of at most 1 (``"l1"``: the largest of all contacts' supports) or are at
    most 1 each (``"linf"``: the sum of the positive ones). Source: Ferrari and Canny, Planning optimal grasps, ICRA
    1992.

    Forces and torques are only comparable by a length. A larger length counts torques less: the radius falls, and
    radius times length grows. The radius depends on ``about`` too. So values agree with those of another program only
    with the same length, point and shape of friction. Its unit: a wrench of force F and
    torque T counts sqrt(F^2 + (T / length)^2).

    With an ``ellipsoid`` of the wrenches that a task asks for it is the largest factor on that ellipsoid with which all
    its wrenches are exerted: the ball in coordinates where the ellipsoid is one, and nothing else is compared with
    anything. Source: Li and Sastry, Task-oriented optimal grasping by multifingered robot hands, IEEE Journal of
    Robotics and Automation 4, 1988, there for another set of forces.

    Bounds are computed in float64 and hold for the grasp's data within rounding, which is added to them: 32 units in
    the last place of the data, times 1 + distance from the frame's origin / length, times the largest wrench of a unit
    normal force (times the number of contacts for ``"linf"``). Grasps of a batch are worked on side by side.

    Inside ``jit``, ``vmap`` and ``grad`` it calls the host back, nothing is checked, and results are JAX arrays in the
    precision of the points, rounded to the nearest; it reports no progress. Both bounds then have the radius's
    derivative, which is that of ``ferrari_canny_at``: NaN where the search left the bounds apart (``located``).

    Args:
        grasp: contacts ``(..., n)``.
        bound: what is bounded, ``"l1"`` or ``"linf"``.
        sides: edges of the pyramids inside the cones that stand for friction, the first one across the coordinate axis
            that is least along the normal; two more for the moments of soft fingers, if there are any. ``None``
            for exact cones.
        length: what torques are divided by, ``(...)`` > 0 [m]; where not given the root of the mean square of the
            distances of the contacts from ``about``.
        about: where torques are taken, ``(..., 3)`` [m]; where not given the mean of the contacts' points.
        ellipsoid: in place of ``length``, the semi-axes of an ellipsoid of wrenches about ``about`` as columns
            ``(..., 6, 6)`` [N, N.m], each the largest disturbance of its direction that the task brings. So
            ``numpy.diag([1, 1, 1, l, l, l])`` stands for the length l, and
            ``numpy.linalg.inv(numpy.linalg.cholesky(Q)).T`` for the metric w^T Q w <= 1.
        tol: relative distance of the bounds at which the search ends.
        max_points: corners of the inner surface at which it ends too, with bounds further apart (``converged`` is
            false then, and ``print`` says of how many grasps); 1000 at most. So many points, and 262,144 facets, bound
            time and memory for any grasp. Many equal soft fingers around an axis come to this limit under ``"linf"``,
            whose body is then nearly a ball over a range of directions: six end with bounds 2 % apart, eight with 4 %.
        progress: is told how many more grasps of a batch are done, every few hundred; what it raises ends the work.

    Raises:
        GraspError: for the first entry that is not usable, before anything is computed.
        ValueError: for an unknown bound, or other options that cannot be used.
    """
    check_bound(bound)
    if ellipsoid is not None and length is not None:
        raise ValueError("length and ellipsoid are both given: expected one, since either compares torques with forces")
    check_sides(sides)
    check_tolerance(tol)
    if not 1 <= max_points <= MAX_POINTS:
        raise ValueError(f"max_points is {max_points}: expected 1 to {MAX_POINTS}")
    if is_traced(grasp, length, about, ellipsoid):
        return _traced(grasp, bound, sides, (length, about, ellipsoid), tol, max_points)
    inputs = read_grasps(grasp, length, about, ellipsoid)
    corners = None if sides is None else pyramid(sides, inputs.soft)
    bodies = replace(inputs.bodies(), bound=bound, corners=corners)
    epsilon = in_turn(len(bodies.present), lambda indices: measure(bodies.take(indices), tol, max_points), progress)
    contacts = inputs.present.shape
    return Epsilon(*(array.reshape(contacts[:-1] + array.shape[1:]) for array in epsilon))


@checked
def ferrari_canny_at(
    grasp: Grasp, measurement: Epsilon, *, length: Length = None, about: About = None, ellipsoid: Ellipsoid = None
) -> Float[Array, "..."]:
    """Evaluate the radius near a grasp measured by ``ferrari_canny``, to differentiate it by the grasp.

    By the envelope theorem the radius moves as the work of ``measurement.normal_force`` and ``measurement.tangential``
    along ``measurement.direction`` does, since nearby neither another direction nor other forces change it to first
    order. So ``jax.grad`` of this, at the grasp measured, is the radius's derivative; its value there is
    ``measurement.upper`` but for rounding. (Where Newton's method does not find the point of touch, as where the ball
    touches the body along a whole curve, value and derivative are as good as finer bounds, and the value tells, by
    differing from ``measurement.upper``.) Where several directions are equally hard the derivative is that of one of
    them; where they are so within ``tol`` alone it may be that of one that is not the hardest, and a finer ``tol``
    tells them apart. First derivatives only. Where the grasp is not closed the radius is zero, and stays so; where
    that is not decided, or ``measurement.located`` is false because the search left its bounds apart, there is no
    derivative (NaN).

    Args:
        grasp: the grasp measured, of JAX arrays; works under ``jit``, ``vmap`` and ``grad``.
        measurement: what ``ferrari_canny`` returned, with any bound and any pyramids.
        length: as there; the default moves with the points.
        about: as there; likewise.
        ellipsoid: as there.

    Returns:
        ``(...)``.
    """
    return _compiled_radius(grasp, measurement, (length, about, ellipsoid))


Frame = tuple[Length, About, Ellipsoid]


@jax.jit
def _compiled_radius(grasp: Grasp, measurement: Epsilon, frame: Frame) -> Array:
    return _radius_at(measured_discs(grasp, *frame)[0], measurement)


def _radius_at(shapes: WrenchDiscs, measurement: Epsilon) -> Array:
    normal_force, tangential, direction = (
        jnp.asarray(array, shapes.centres.dtype)
        for array in (measurement.normal_force, measurement.tangential, measurement.direction)
    )
    located = jnp.asarray(measurement.located, bool) & jnp.any(direction != 0, -1)
    return differentiable_where(located, work(shapes, normal_force, tangential, direction), shapes)


def _traced(grasp: Grasp, bound: Bound, sides: int | None, frame: Frame, tol: float, max_points: int) -> Epsilon:
    count = grasp.friction.shape[-1]
    corners = None if sides is None else pyramid(sides, grasp.torsion is not None)

    def question(bodies: WrenchSets) -> Epsilon:
        return measure(replace(bodies, bound=bound, corners=corners), tol, max_points)

    shapes, answers = call_on_host(question, ((), (), (6,), (count,), (count, 3), (), ()), grasp, *frame)
    epsilon: Any = Epsilon(*answers[:5], *(flag > 0.5 for flag in answers[5:]))
    radius = _radius_at(shapes, epsilon)
    return epsilon._replace(
        lower=with_derivative_of(epsilon.lower, jnp.where(epsilon.lower > 0, radius, 0)),
        upper=with_derivative_of(epsilon.upper, radius),
    )


def measure(bodies: WrenchSets, tol: float, max_points: int) -> Epsilon:
    """Measure the radii of bodies in one flat batch."""
    grasps, count = bodies.present.shape
    closure = decide_all(bodies.alone_edges())
    epsilon = Epsilon(
        np.zeros(grasps),
        np.where(closure.decided, 0, _least_axis_reach(bodies)),
        np.where((closure.decided & ~closure.closed)[:, None], closure.twist, 0),
        np.zeros((grasps, count)),
        np.zeros((grasps, count, 3)),
        closure.decided.copy(),
        closure.decided.copy(),
    )
    closed = np.flatnonzero(closure.closed)
    if len(closed):
        slack, round_bodies = bodies.slack[closed], rounded(bodies.take(closed))
        balls, touched = _touching_balls(round_bodies, closure.margin[closed], slack, tol, max_points)
        lower = np.maximum(balls.lower - slack, closure.margin[closed])
        upper = np.minimum(balls.upper, touched.height) + slack
        epsilon.lower[closed], epsilon.upper[closed] = lower, upper
        epsilon.direction[closed] = round_bodies.original(touched.direction)
        epsilon.normal_force[closed], epsilon.tangential[closed] = touched.normal_force, touched.tangential
        epsilon.converged[closed] = lower >= (1 - tol) * upper
        epsilon.located[closed] = balls.lower >= (1 - max(tol, LOCATED)) * (upper - slack)
    return epsilon


def _touching_balls(
    bodies: RoundedBodies, inside: np.ndarray, slack: np.ndarray, tol: float, max_points: int
) -> tuple[Balls, TouchingPoints]:
    """Bound the largest balls and find where they touch the bodies; arguments as for ``largest_balls``.

    Newton's method may start too far from the point of touch, since directions are known by the root of the tolerance
    only: these bodies are searched again with finer ones.
    """
    balls = largest_balls(bodies, inside, slack, tol, max_points)
    touched = touch(bodies, balls)
    for part in FINER:
        remaining = np.flatnonzero(balls.converged & ~touched.exact)
        if not len(remaining) or part * tol < FINEST:
            break
        remaining_bodies = bodies.take(remaining)
        closer = largest_balls(remaining_bodies, inside[remaining], slack[remaining], part * tol, max_points)
        balls.lower[remaining] = np.maximum(balls.lower[remaining], closer.lower)
        balls.upper[remaining] = np.minimum(balls.upper[remaining], closer.upper)
        closest = touch(remaining_bodies, closer)
        better = closest.height <= touched.height[remaining]
        for array, replacement in zip(touched, closest):
            array[remaining[better]] = replacement[better]
    return balls, touched


def _least_axis_reach(bodies: WrenchSets) -> np.ndarray:
    """Compute the least support along the coordinate axes, an upper bound where no better one is known."""
    axes = np.broadcast_to(np.concatenate([np.eye(6), -np.eye(6)])[:, None], (12, len(bodies.present), 6))
    return np.min([bodies.reach(axis).height for axis in axes], 0) + bodies.slack
