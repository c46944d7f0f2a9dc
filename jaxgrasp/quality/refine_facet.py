"""Point where a body's largest ball touches its surface: the direction to many digits, and that wrench's forces.

Contact i exerts x_i = (normal force p_i, tangential force q_i) in the cone Q = {|q| <= p}. At the touching point e d,
with a multiplier for every bound of forces, t for their sum or t_i for each,

    sum over contacts of c_i p_i + B_i q_i = e d,    |d| = 1,
    x_i in Q,   y_i = (t - c_i.d, -B_i^T d) in Q,   x_i.y_i = 0,
    the force bounded <= 1,   t >= 0,   t (1 - the force bounded) = 0.

The last two lines are x_i = projection on Q of x_i - y_i, and t = max(0, t + force - 1). Newton's method on all of it,
by derivatives of the projections' pieces, starts from the bounds' surface; what it finds is taken only if the body
reaches no further there. All of it is done in the coordinates of ``rounded_bodies.py``: there |scales * d| = 1, and the
wrench is e scales^2 * d.
"""

from typing import NamedTuple

import numpy as np

from jaxgrasp.quality.largest_ball import Balls, RoundedBodies
from jaxgrasp.quality.wrench_sets import Support, WrenchSets

STEPS = 20
SOLVED = 1e-10
"""Largest residual of the equations, relative to the body's size."""
COUNTS = 1e-6
"""Share of the whole force that a contact presses with, if it presses."""
TINY = 1e-13
"""Term added to the equations' diagonal: a hard finger inside its cone has a moment that nothing depends on."""


class TouchingPoints(NamedTuple):
    """Directions that bodies reach least along, as far as known, and the forces of the points where they end."""

    height: np.ndarray
    """``(G,)``."""
    direction: np.ndarray
    """``(G, 6)``, mapped."""
    normal_force: np.ndarray
    """``(G, n)``."""
    tangential: np.ndarray
    """``(G, n, 3)``."""
    exact: np.ndarray
    """``(G,)``: whether these solve the equations; those of pyramids are the corners' planes, and always count."""

    def put(self, indices: np.ndarray, replacements: "TouchingPoints") -> None:
        """Overwrite the points ``indices`` (g,) with others ``(g, ...)`` that are exact."""
        for array, replacement in zip(self, replacements):
            array[indices[replacements.exact]] = replacement[replacements.exact]

    def where(self, mask: np.ndarray, replacements: "TouchingPoints") -> "TouchingPoints":
        """Return the entries of these points where the mask ``(G,)`` is true, and those of others elsewhere."""
        pairs = (
            (mask.reshape(-1, *[1] * (array.ndim - 1)), array, replacement)
            for array, replacement in zip(self, replacements)
        )
        return TouchingPoints(*(np.where(*pair) for pair in pairs))


class _Iterate(NamedTuple):
    direction: np.ndarray
    """``(G, 6)``."""
    height: np.ndarray
    """``(G,)``."""
    forces: np.ndarray
    """``(G, n, 4)``: normal and tangential force."""
    bound_multipliers: np.ndarray
    """``(G, 1)`` or ``(G, n)``: the multipliers of bounds."""


def touch(bodies: RoundedBodies, balls: Balls) -> TouchingPoints:
    """Compute the points where the bodies' largest balls touch them, by Newton's method where it converges."""
    corners = [bodies.bodies.reach(balls.corners[:, corner]) for corner in range(6)]
    nearest = Support(*(np.stack(parts, 1) for parts in zip(*corners)))
    points = _of_corners(bodies, balls, nearest)
    if bodies.bodies.corners is not None:
        return points._replace(exact=np.ones(len(balls.upper), bool))
    refined = _newton(bodies, points)
    points = refined.where(refined.exact, points)
    unsolved = np.flatnonzero(~points.exact)
    if len(unsolved):
        unsolved_bodies = bodies.take(unsolved)
        start = _by_weights(
            unsolved_bodies,
            balls.upper[unsolved],
            balls.direction[unsolved],
            Support(*(part[unsolved] for part in nearest)),
        )
        points.put(unsolved, _newton(unsolved_bodies, start))
    return points


def _of_corners(bodies: RoundedBodies, balls: Balls, nearest: Support) -> TouchingPoints:
    """Compute first touching points from the planes through the facets' corners, and the forces of these points.

    Where rounding spoils a plane, or the body reaches further along it than the ball, the ball's direction is kept.
    """
    is_complete = np.any(balls.corners != 0, 2).all(1)
    points = np.where(is_complete[:, None, None], nearest.points, np.eye(6))
    with np.errstate(all="ignore"):
        across = _solved(points, np.ones((len(points), 6)))
        weights = _solved(np.swapaxes(points, 1, 2), bodies.scales**2 * across)
        weights /= weights.sum(1, keepdims=True)
        direction = bodies.normalised(across)
        # Weights of points that nearly coincide, as two of one disc may, say something by their sum alone.
        usable = is_complete & (np.abs(weights).max(1) < 1 / SOLVED) & np.isfinite(direction).all(1)
    direction = np.where(usable[:, None], direction, balls.direction)
    height = bodies.bodies.reach(direction).height
    lower = height <= balls.upper * (1 + SOLVED)
    weights = np.where(usable[:, None], weights, 1 / 6)
    normal_force = np.maximum(np.matmul(weights[:, None], nearest.normal_force)[:, 0], 0)
    direction, height = np.where(lower[:, None], direction, balls.direction), np.where(lower, height, balls.upper)
    tangential = _within(np.einsum("gp,gpnk->gnk", weights, nearest.tangential), normal_force)
    return TouchingPoints(height, direction, normal_force, tangential, np.zeros(len(height), bool))


def _by_weights(bodies: RoundedBodies, upper: np.ndarray, direction: np.ndarray, nearest: Support) -> TouchingPoints:
    """Compute the forces of the points in the hulls of the corners' wrenches that are closest to the balls' ends."""
    from scipy.optimize import nnls

    weights, size = np.zeros(nearest.height.shape), bodies.bodies.size
    wrenches = upper[:, None] * bodies.scales**2 * direction
    for index, points in enumerate(nearest.points):
        rows = np.vstack([points.T, np.full((1, len(points)), size[index])])
        weights[index], _ = nnls(rows / size[index], np.append(wrenches[index], size[index]) / size[index])
    weights /= np.maximum(weights.sum(1, keepdims=True), COUNTS)
    normal_force = np.einsum("gp,gpn->gn", weights, nearest.normal_force)
    tangential = np.einsum("gp,gpnk->gnk", weights, nearest.tangential)
    return TouchingPoints(upper, direction, normal_force, tangential, np.zeros(len(upper), bool))


def _within(tangential: np.ndarray, normal_force: np.ndarray) -> np.ndarray:
    """Shorten tangential forces to the size of the normal force at most."""
    size = np.linalg.norm(tangential, axis=-1)
    return tangential * np.where(size > normal_force, normal_force / np.where(size > 0, size, 1), 1)[..., None]


def _newton(rounded: RoundedBodies, start: TouchingPoints) -> TouchingPoints:
    """Solve the equations from the start on, for cones; ``exact`` says where that succeeded."""
    bodies, metric = rounded.bodies, rounded.scales**2
    grasps = len(bodies.present)
    size = np.maximum(bodies.size, np.finfo(float).tiny)
    chosen = _pressing(bodies, start)
    grasp_rows = np.arange(grasps)[:, None]
    discs = bodies.discs[grasp_rows, chosen] / size[:, None, None, None]
    total = bodies.bound == "l1"
    bound_multipliers = (
        start.height[:, None] if total else np.maximum(bodies.supports(start.direction)[0][grasp_rows, chosen], 0)
    )
    forces = np.concatenate([start.normal_force[..., None], start.tangential], -1)[grasp_rows, chosen]
    # The steps below write into these arrays: copies, since the start is what a run that fails falls back on.
    iterate = _Iterate(start.direction.copy(), start.height / size, forces, bound_multipliers / size[:, None])
    unsolved = np.ones(grasps, bool)
    for _ in range(STEPS):
        moving = np.flatnonzero(unsolved)
        subset = _Iterate(*(part[moving] for part in iterate))
        with np.errstate(all="ignore"):
            residual, slope = _equations(discs[moving], metric[moving], subset)
            is_far = ~(np.abs(residual).max(1) <= SOLVED)
            unsolved[moving[~is_far]] = False
            sound = is_far & np.isfinite(slope).all((1, 2))
            moving, residual, slope = moving[sound], residual[sound], slope[sound]
            if not len(moving):
                break
            slope += TINY * np.eye(slope.shape[1])
            step = _solved(slope, residual)
        _move(iterate, moving, step)
    return _checked(rounded, start, iterate, chosen, ~unsolved)


def _pressing(bodies: WrenchSets, start: TouchingPoints) -> np.ndarray:
    """Return the indices ``(G, k)`` of the contacts whose forces are unknown, as many for each grasp.

    Where the sum of forces is bounded, contacts that press come first, and contacts that none needs are left out.
    """
    if bodies.bound == "linf":
        return np.broadcast_to(np.arange(bodies.present.shape[1]), bodies.present.shape)
    most = int((start.normal_force > COUNTS).sum(1).max(initial=1))
    return np.argsort(-start.normal_force, 1, kind="stable")[:, : max(most, 1)]


def _solved(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve systems ``(G, m, m)`` for ``(G, m)``; all of them by least squares if a matrix is singular."""
    try:
        return np.linalg.solve(matrices, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return np.einsum("gij,gj->gi", np.linalg.pinv(matrices), right)


def _move(iterate: _Iterate, moving: np.ndarray, step: np.ndarray) -> None:
    """Take a step of Newton's method, some grasps of a guess."""
    count = iterate.forces.shape[1]
    iterate.direction[moving] -= step[:, :6]
    iterate.height[moving] -= step[:, 6]
    iterate.forces[moving] -= step[:, 7 : 7 + 4 * count].reshape(-1, count, 4)
    iterate.bound_multipliers[moving] -= step[:, 7 + 4 * count :]


def _equations(discs: np.ndarray, metric: np.ndarray, iterate: _Iterate) -> tuple[np.ndarray, np.ndarray]:
    """Compute residual and Jacobian by (direction, height, forces, bound_multipliers) for discs ``(G, n, 4, 6)``.

    The discs have size 1, and ``metric`` (G, 6) are the squared scales of directions.
    """
    (grasps, count), bounds, d = discs.shape[:2], iterate.bound_multipliers.shape[1], iterate.direction
    ends = 7 + 4 * count
    owner = np.zeros(count, int) if bounds == 1 else np.arange(count)
    flat = discs.reshape(grasps, 4 * count, 6)
    slack = -np.matmul(flat, d[..., None]).reshape(grasps, count, 4)
    slack[..., 0] += iterate.bound_multipliers[:, owner]
    projected, bend = _project(iterate.forces - slack)
    bounded = iterate.forces[..., 0].sum(1, keepdims=True) if bounds == 1 else iterate.forces[..., 0]
    shifted = iterate.bound_multipliers + bounded - 1
    exerted = np.matmul(iterate.forces.reshape(grasps, 1, -1), flat)[:, 0]
    along = metric * d
    residual = np.concatenate(
        [
            exerted - iterate.height[:, None] * along,
            (np.sum(d * along, 1)[:, None] - 1) / 2,
            (iterate.forces - projected).reshape(grasps, -1),
            iterate.bound_multipliers - np.maximum(shifted, 0),
        ],
        1,
    )
    slope = np.zeros((grasps, ends + bounds, ends + bounds))
    slope[:, :6, :6] = -(iterate.height[:, None] * metric)[..., None] * np.eye(6)
    slope[:, :6, 6], slope[:, 6, :6] = -along, along
    slope[:, :6, 7:ends] = np.swapaxes(flat, 1, 2)
    slope[:, 7:ends, :6] = -np.matmul(bend, discs).reshape(grasps, -1, 6)
    for contact in range(count):
        rows, multiplier_column = slice(7 + 4 * contact, 11 + 4 * contact), ends + owner[contact]
        slope[:, rows, rows] = np.eye(4) - bend[:, contact]
        slope[:, rows, multiplier_column] = bend[:, contact, :, 0]
        slope[:, multiplier_column, 7 + 4 * contact] = -(shifted[:, owner[contact]] > 0).astype(float)
    slope[:, ends:, ends:] = np.where(shifted <= 0, 1.0, 0)[..., None] * np.eye(bounds)
    return residual, slope


def _project(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the projection of ``(..., 4)`` on Q = {|last three| <= first}, and its derivative ``(..., 4, 4)``."""
    first, tangential = vectors[..., 0], vectors[..., 1:]
    size = np.sqrt(np.sum(tangential**2, -1))
    unit = tangential / np.where(size > 0, size, 1)[..., None]
    ratio = (first / np.where(size > 0, size, 1))[..., None, None]
    edge = np.concatenate([np.ones((*first.shape, 1)), unit], -1)
    bend = edge[..., :, None] * edge[..., None, :]
    bend[..., 1:, 1:] = (1 + ratio) * np.eye(3) - ratio * bend[..., 1:, 1:]
    inside, polar = size <= first, size <= -first
    projected = np.where(polar[..., None], 0, (first + size)[..., None] / 2 * edge)
    bend = np.where(polar[..., None, None], 0, bend / 2)
    return np.where(inside[..., None], vectors, projected), np.where(inside[..., None, None], np.eye(4), bend)


def _checked(
    rounded: RoundedBodies, start: TouchingPoints, iterate: _Iterate, chosen: np.ndarray, solved: np.ndarray
) -> TouchingPoints:
    """Return the points of Newton's method, exact where it ended and the body reaches no further than at the start."""
    with np.errstate(all="ignore"):
        direction = rounded.normalised(iterate.direction)
    direction = np.where(solved[:, None], direction, start.direction)
    height = rounded.bodies.reach(direction).height
    forces = np.zeros((*rounded.bodies.present.shape, 4))
    forces[np.arange(len(chosen))[:, None], chosen] = iterate.forces
    exact = solved & (height <= start.height * (1 + SOLVED))
    return TouchingPoints(height, direction, forces[..., 0], forces[..., 1:], exact)
