"""Where a body's largest ball touches its surface: the direction to many digits, and the forces of that wrench.

Contact i exerts x_i = (normal force p_i, lean) in the cone Q = {|lean| <= p}. At the touching point e d, with a
multiplier for every bound of forces, t for their sum or t_i for each,

    sum over contacts of c_i p_i + B_i lean_i = e d,    |d| = 1,
    x_i in Q,   y_i = (t - c_i.d, -B_i^T d) in Q,   x_i.y_i = 0,
    the force bounded <= 1,   t >= 0,   t (1 - the force bounded) = 0.

The last two lines are x_i = projection on Q of x_i - y_i, and t = max(0, t + force - 1). Newton's method on all of it,
by derivatives of the projections' pieces, starts from the bounds' surface; what it finds is taken only if the body
reaches no further there.
"""

from typing import NamedTuple

import numpy as np

from jaxgrasp.quality.largest_ball import Ball
from jaxgrasp.quality.wrench_sets import Reach, WrenchSet

STEPS = 20
SOLVED = 1e-10
"""Largest residual of the equations, relative to the body's size."""
COUNTS = 1e-6
"""Share of the whole force that a contact presses with, if it presses."""


class TouchingPoint(NamedTuple):
    """A direction that the body reaches least along, as far as known, and the forces of the point where it ends."""

    height: float
    direction: np.ndarray
    press: np.ndarray
    """``(n,)``."""
    lean: np.ndarray
    """``(n, 3)``."""


class _Guess(NamedTuple):
    direction: np.ndarray
    height: float
    forces: np.ndarray
    """``(n, 4)``: normal force and lean."""
    tolls: np.ndarray
    """``(1,)`` or ``(n,)``: the multipliers of bounds."""


def touch(body: WrenchSet, ball: Ball) -> TouchingPoint:
    """The best that is known of where the body's largest ball touches it."""
    found = _by_weights(body, ball.direction, ball.touched)
    if body.corners is not None:
        return _of_facet(body, found, ball)
    for start in (found, _of_facet(body, found, ball)):
        better = _newton(body, start)
        if better is not None and better.height <= min(found.height, ball.upper):
            return better
    return found


def _by_weights(body: WrenchSet, direction: np.ndarray, near: Reach) -> TouchingPoint:
    """Forces of the point of the hull of some wrenches that comes closest to where the ball ends."""
    from scipy.optimize import nnls

    height = float(body.reach(direction[None]).height[0])
    ones = np.full((1, len(near.points)), body.size)
    target = np.append(height * direction, body.size)
    weights, _ = nnls(np.vstack([near.points.T, ones]), target)
    weights = weights / weights.sum()
    return TouchingPoint(height, direction, weights @ near.press, np.einsum("p,pnk->nk", weights, near.lean))


def _of_facet(body: WrenchSet, found: TouchingPoint, ball: Ball) -> TouchingPoint:
    """The plane through the wrenches that carry the point, where no rounding drew them aside."""
    from scipy.optimize import nnls

    corners = ball.touched.points
    used, _ = nnls(np.vstack([corners.T, np.ones(len(corners))]), np.append(found.height * found.direction, 1))
    across, *_ = np.linalg.lstsq(corners[used > COUNTS], np.ones(np.sum(used > COUNTS)))
    direction = across / np.linalg.norm(across)
    better = _by_weights(body, direction, ball.touched)
    return better if better.height <= found.height else found


def _newton(body: WrenchSet, start: TouchingPoint) -> TouchingPoint | None:
    """The equations' solution near the start, where there is one; cones only."""
    discs = np.concatenate([body.centres[..., None], body.spans], 2) / body.size
    count = len(discs)
    values, _ = body.supports(start.direction[None])
    tolls = np.array([start.height]) if body.bound == "l1" else np.maximum(values[0], 0)
    forces = np.concatenate([start.press[:, None], start.lean], 1)
    now = _Guess(start.direction, start.height / body.size, forces, tolls / body.size)
    for _ in range(STEPS):
        residual, slope = _equations(discs, now)
        if np.abs(residual).max() <= SOLVED:
            return _checked(body, now)
        step, *_ = np.linalg.lstsq(slope, residual)
        moved = step[7 : 7 + 4 * count].reshape(count, 4)
        now = _Guess(
            now.direction - step[:6], now.height - step[6], now.forces - moved, now.tolls - step[7 + 4 * count :]
        )
    return None


def _equations(discs: np.ndarray, now: _Guess) -> tuple[np.ndarray, np.ndarray]:
    """Residual and Jacobian by (direction, height, forces, tolls) for discs ``(n, 6, 4)`` of size 1."""
    count, bounds, d = len(discs), len(now.tolls), now.direction
    ends, first = 7 + 4 * count, np.eye(4)[0]
    owner = np.zeros(count, int) if bounds == 1 else np.arange(count)
    slack = now.tolls[owner, None] * first - np.einsum("j,njk->nk", d, discs)
    projected, bend = _project(now.forces - slack)
    bounded = np.bincount(owner, now.forces[:, 0], bounds)
    paid = now.tolls + bounded - 1
    residual = np.concatenate(
        [
            np.einsum("njk,nk->j", discs, now.forces) - now.height * d,
            [(d @ d - 1) / 2],
            (now.forces - projected).ravel(),
            now.tolls - np.maximum(paid, 0),
        ]
    )
    slope = np.zeros((ends + bounds, ends + bounds))
    slope[:6, :6], slope[:6, 6], slope[6, :6] = -now.height * np.eye(6), -d, d
    slope[:6, 7:ends] = np.swapaxes(discs, 0, 1).reshape(6, -1)
    slope[7:ends, :6] = -np.einsum("nkl,njl->nkj", bend, discs).reshape(-1, 6)
    for contact in range(count):
        rows = slice(7 + 4 * contact, 11 + 4 * contact)
        slope[rows, rows] = np.eye(4) - bend[contact]
        slope[rows, ends + owner[contact]] = bend[contact] @ first
        slope[ends + owner[contact], 7 + 4 * contact] = -float(paid[owner[contact]] > 0)
    slope[ends:, ends:] = np.diag((paid <= 0).astype(float))
    return residual, slope


def _project(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Projection of ``(n, 4)`` on Q = {|last three| <= first}, and its derivative ``(n, 4, 4)``."""
    first, rest = vectors[:, 0], vectors[:, 1:]
    size = np.linalg.norm(rest, axis=1)
    unit = rest / np.where(size > 0, size, 1)[:, None]
    ratio = (first / np.where(size > 0, size, 1))[:, None, None]
    edge = np.concatenate([np.ones((len(unit), 1)), unit], 1)
    bend = edge[:, :, None] * edge[:, None]
    bend[:, 1:, 1:] = (1 + ratio) * np.eye(3) - ratio * bend[:, 1:, 1:]
    inside, polar = size <= first, size <= -first
    projected = np.where(polar[:, None], 0, (first + size)[:, None] / 2 * edge)
    bend = np.where(polar[:, None, None], 0, bend / 2)
    return np.where(inside[:, None], vectors, projected), np.where(inside[:, None, None], np.eye(4), bend)


def _checked(body: WrenchSet, now: _Guess) -> TouchingPoint:
    direction = now.direction / np.linalg.norm(now.direction)
    return TouchingPoint(float(body.reach(direction[None]).height[0]), direction, now.forces[:, 0], now.forces[:, 1:])
