"""The largest disturbance that a grasp resists whichever way it pushes: the radius of its ball of wrenches."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.model.arrays import Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.quality.closure import decide
from jaxgrasp.quality.grasp_input import check_tolerance, read_grasps
from jaxgrasp.quality.largest_ball import largest_ball
from jaxgrasp.quality.refine_facet import touch
from jaxgrasp.quality.summary_line import count_of, range_of
from jaxgrasp.quality.wrench_discs import About, Length, discs, known_where, work
from jaxgrasp.quality.wrench_sets import Bound, WrenchSet, check_bound, check_sides, pyramid
from jaxgrasp.validation.checked import checked

MAX_POINTS = 1000


class Epsilon(NamedTuple):
    """The radius of the largest ball of wrenches that a batch of grasps can exert, and where it ends."""

    lower: np.ndarray
    """``(...)`` [1, newtons per newton]: proven; 0 where the grasp is not closed."""
    upper: np.ndarray
    """``(...)``: proven."""
    direction: np.ndarray
    """``(..., 6)``: of the wrench (force, torque / length) about ``about`` that is hardest to exert, of length 1."""
    press: np.ndarray
    """``(..., n)``: normal forces with which the grasp exerts ``upper`` times that wrench; zeros where it is not
    closed."""
    lean: np.ndarray
    """``(..., n, 3)``: parts of the largest friction along two tangents, and of a soft finger's moment, times press."""

    def __str__(self) -> str:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        which = {"closed": lower > 0, "not closed": upper <= 0, "undecided": (lower <= 0) & (upper > 0)}
        return f"Epsilon: {count_of(which)}; lower bound {range_of(lower)}; upper bound {range_of(upper)}"


@checked
def ferrari_canny(
    grasp: Grasp,
    bound: Bound = "l1",
    *,
    sides: int | None = None,
    length: Length = None,
    about: About = None,
    tol: float = 1e-3,
    max_points: int = MAX_POINTS,
) -> Epsilon:
    """The radius of the largest ball around the origin in the grasp's wrench space, between proven bounds.

    It is the least of all h(d) over unit d, where h(d) is the largest power along the twist d of forces within
    friction whose normal forces have a sum of at most 1 (``"l1"``: the largest of all contacts' supports) or are at
    most 1 each (``"linf"``: the sum of the positive ones). Source: Ferrari and Canny, Planning optimal grasps, ICRA
    1992.

    Forces and torques are only comparable by a length. The larger it is, the less torques count, and the smaller is
    the radius; times the length it grows. About another point it is another radius too. So values agree with
    those of another program only with the same length, point and shape of friction. Its unit: a wrench of force F and
    torque T counts sqrt(F^2 + (T / length)^2).

    Bounds are computed in float64 and hold for the grasp's data within rounding, which is added to them: 32 units in
    the last place of the data, times 1 + distance from the frame's origin / length, times the largest wrench of a unit
    normal force (times the number of contacts for ``"linf"``). A point of the body costs about a millisecond at a
    hundred points, and more the more there are.

    Args:
        grasp: contacts ``(..., n)``, concrete; a batch is a loop.
        bound: what is bounded, ``"l1"`` or ``"linf"``.
        sides: edges of the pyramids inside the cones that stand for friction, the first one across the coordinate axis
            that is least along the normal; two more for the moments of soft fingers, if there are any. ``None``
            for exact cones.
        length: what torques are divided by, ``(...)`` > 0 [m]; where not given the root of the mean square of the
            distances of the contacts from ``about``.
        about: where torques are taken, ``(..., 3)`` [m]; where not given the mean of the contacts' points.
        tol: relative distance of the bounds at which the search ends.
        max_points: corners of the inner surface at which it ends too, with bounds further apart.

    Raises:
        GraspError: for the first entry that is not usable, before anything is computed.
        ValueError: for an unknown bound, or other options that cannot be used.
        TypeError: for traced arrays: see ``ferrari_canny_at``.
    """
    check_bound(bound)
    check_sides(sides)
    check_tolerance(tol)
    if max_points < 1:
        raise ValueError(f"max_points is {max_points}: expected 1 or more")
    given = read_grasps(grasp, length, about)
    corners = None if sides is None else pyramid(sides, given.soft)
    shape = given.present.shape
    lower, upper, directions = np.zeros(shape[:-1]), np.zeros(shape[:-1]), np.zeros((*shape[:-1], 6))
    press, lean = np.zeros(shape), np.zeros((*shape, 3))
    for index, own, body in given.bodies():
        bounds, found = _of_body(replace(body, bound=bound, corners=corners), tol, max_points)
        lower[index], upper[index] = bounds
        directions[index], press[index][own], lean[index][own] = found
    return Epsilon(lower, upper, directions, press, lean)


@checked
def ferrari_canny_at(
    grasp: Grasp, found: Epsilon, *, length: Length = None, about: About = None
) -> Float[Array, "..."]:
    """The radius near a grasp that ``ferrari_canny`` has measured, for derivatives by points, normals and friction.

    By the envelope theorem the radius moves as the work of the forces ``found.press``, ``found.lean`` along
    ``found.direction`` does, since nearby neither another direction nor other forces change it to first order. So
    ``jax.grad`` of this, at the grasp measured, is the radius's derivative; its value there is ``found.upper`` but for
    rounding. (On a few grasps in a hundred the search ends without the point of touch to all digits; value and
    derivative are then as good as the bounds, and the value tells, by differing from ``found.upper``.) Where several
    directions are equally hard the derivative is that of one of them. First derivatives only. Where the grasp
    is not closed the radius is zero, and stays so; where that is not decided there is no derivative (NaN).

    Args:
        grasp: the grasp measured, of JAX arrays; works under ``jit``, ``vmap`` and ``grad``.
        found: what ``ferrari_canny`` returned, with any bound and any pyramids.
        length: as there; the default moves with the points.
        about: as there; likewise.

    Returns:
        ``(...)``.
    """
    return _worked(grasp, found, length, about)


@jax.jit
def _worked(grasp: Grasp, found: Epsilon, length: Length, about: About) -> Array:
    shapes = discs(grasp, length, about)
    press, lean, direction = (
        jnp.asarray(array, shapes.centres.dtype) for array in (found.press, found.lean, found.direction)
    )
    return known_where(jnp.any(direction != 0, -1), work(shapes, press, lean, direction), shapes)


def _of_body(body: WrenchSet, tol: float, max_points: int) -> tuple[tuple[float, float], tuple[np.ndarray, ...]]:
    """The bounds, and (direction, press, lean)."""
    count = len(body.centres)
    nothing = np.zeros(count), np.zeros((count, 3))
    closure = decide(_wrenches_alone(body))
    if not closure.decided:
        return (0.0, _some_reach(body)), (np.zeros(6), *nothing)
    if not closure.closed:
        return (0.0, 0.0), (closure.twist, *nothing)
    ball = largest_ball(body, closure.margin, tol, max_points)
    found = touch(body, ball)
    return (ball.lower, min(ball.upper, found.height + body.slack)), found[1:]


def _wrenches_alone(body: WrenchSet) -> WrenchSet:
    """The body of summed forces that has its discs, or the edges of its pyramids as contacts without friction."""
    if body.corners is None:
        return replace(body, bound="l1")
    edges = body.centres[:, None] + np.einsum("njk,ck->ncj", body.spans, body.corners)
    edges = edges.reshape(-1, 6)
    return replace(body, centres=edges, spans=np.zeros((len(edges), 6, 3)), bound="l1", corners=None)


def _some_reach(body: WrenchSet) -> float:
    """Along the coordinate axes: an upper bound where nothing better is known."""
    return float(body.reach(np.concatenate([np.eye(6), -np.eye(6)])).height.min() + body.slack)
