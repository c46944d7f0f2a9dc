"""Reachable limit of a grasp: the largest theta for which allowed forces give w + theta d, between checked bounds.

    maximise theta  subject to  G f = w + theta d,  f in the cones;
    its dual:  minimise -y.w  subject to  y.d = 1,  no contact able to work along y.

Clarabel solves the pair; what it says is then mended and checked in extended precision, and only that counts:

- any y with y.d > 0 along which no contact can work bounds theta by -(y.w) / (y.d), for y.G f <= 0;
- any allowed forces that balance bound theta from below.

Rounded answers would miss both by a last digit, so Clarabel is asked for a little more than is needed: that each
contact works against y by ``slack``, and that each force has ``slack`` to spare along its normal.
"""

from typing import NamedTuple

import numpy as np

from jaxgrasp.testing.references import Centred, Problems, Wide, centred, norm, or_one, resultant, tangents

SLACKS = (1e-11, 1e-9, 1e-7)
"""Tried in turn, as parts of the load and of the multiplier, until both bounds hold."""
CUT = 1e-12
"""Singular values of the grasp matrix below this part of the largest are directions out of reach."""
BALANCED = 1e-14
"""Share of the load by which forces may miss the wrench: the rounding of a wrench given in double precision."""


class Limit(NamedTuple):
    """Bounds of the largest theta ``(B,)``: ``lower <= theta <= upper``; -inf and inf where nothing was proven."""

    lower: np.ndarray
    upper: np.ndarray
    forces: np.ndarray
    """Allowed forces ``(B, n, 3)`` [N] that give w + lower d; NaN where ``lower`` is not finite."""

    @property
    def width(self) -> np.ndarray:
        """Distance of the bounds relative to theta; inf where one of them is missing, or theta is not positive."""
        bounded = np.isfinite(self.lower) & np.isfinite(self.upper) & (self.lower > 0)
        lower, upper = (np.where(bounded, bound, 1) for bound in (self.lower, self.upper))
        return np.where(bounded, (upper - lower) / lower, np.inf)


class _Line(NamedTuple):
    """w + theta d in centred coordinates, both of unit length, in extended precision."""

    scaled: Centred
    start: np.ndarray
    direction: np.ndarray
    load: np.ndarray
    stride: np.ndarray
    """Theta in the user's units per unit of theta in these coordinates."""

    def take(self, lanes: np.ndarray) -> "_Line":
        scaled = Centred(*(x[lanes] for x in self.scaled))
        return _Line(scaled, *(x[lanes] for x in self[1:]))


def reachable_limit(problem: Problems, weights: np.ndarray, direction: np.ndarray) -> Limit:
    """Bound sup {theta: allowed forces give wrench + theta direction}, by an independent solver.

    Args:
        problem: contacts and the wrench w at theta = 0.
        weights: sharing weights ``(B, n)``; only which of them are zero matters: such contacts keep s a.
        direction: d ``(B, 6)`` about the frame's origin, in the range of the grasp matrix.

    Returns:
        A Limit. Both bounds are inf where forces strictly inside the cones give d itself. Nothing is proven, and the
        bounds stay infinitely apart, where no theta is reachable, without friction, or where contacts pinch (forces
        that balance to zero) though the grasp is not force-closed.

    Raises:
        ImportError: if Clarabel or SciPy is missing.
    """
    line = _line(problem, weights, direction)
    count, n = problem.squeeze.shape
    limit = Limit(np.full(count, -np.inf), np.full(count, np.inf), np.full((count, n, 3), np.nan))
    for slack in SLACKS:
        open_ended = np.flatnonzero(~(np.isfinite(limit.lower) & np.isfinite(limit.upper)))
        _tighten(limit, line.take(open_ended), open_ended, slack)
    unbounded = np.flatnonzero(~np.isfinite(limit.upper))
    endless = unbounded[_gives_direction(line.take(unbounded))]
    limit.lower[endless] = np.inf
    limit.forces[endless] = np.nan
    return limit


def _line(problem: Problems, weights: np.ndarray, direction: np.ndarray) -> _Line:
    scaled = centred(problem, weights)
    held = np.where(scaled.weights > 0, 0, scaled.squeeze)[..., None] * scaled.normals
    start = scaled.wrench - resultant(scaled, held)
    load = or_one(norm(start))
    force, torque = np.asarray(direction, Wide)[:, :3], np.asarray(direction, Wide)[:, 3:]
    about = (torque - np.cross(scaled.centre, force)) / scaled.length[:, None]
    along = np.concatenate([force, about], -1)
    size = or_one(norm(along))
    return _Line(scaled, start / load[:, None], along / size[:, None], load, load / size)


def _tighten(limit: Limit, line: _Line, lanes: np.ndarray, slack: float) -> None:
    """Solve the given lanes of a batch with ``slack``, and update ``limit`` with the bounds that hold."""
    if not len(lanes):
        return
    scaled, free = line.scaled, line.scaled.weights > 0
    spare = np.where(free, slack, 0)[..., None] * scaled.normals
    solved = _solve(line, line.start - resultant(scaled, spare), slack)
    forces = _balanced(line, solved.forces + spare, line.start + solved.theta[:, None] * line.direction)
    reached = _allowed(scaled, forces)
    better = reached & (solved.theta * line.stride > limit.lower[lanes])
    limit.lower[lanes[better]] = (solved.theta * line.stride)[better]
    held = np.where(free, 0, scaled.squeeze)[..., None] * scaled.normals
    limit.forces[lanes[better]] = (forces * line.load[:, None, None] + held)[better]
    work = np.sum(solved.multiplier * line.direction, -1)
    proves = (work > 0) & (_largest_work(scaled, solved.multiplier) <= 0)
    bound = -np.sum(solved.multiplier * line.start, -1) / np.where(proves, work, 1)
    limit.upper[lanes] = np.minimum(limit.upper[lanes], np.where(proves, bound * line.stride, np.inf))


def _gives_direction(line: _Line) -> np.ndarray:
    """Return a mask ``(B,)`` of problems where forces strictly inside the cones give d: theta is then unbounded."""
    if not len(line.load):
        return np.zeros(0, bool)
    solved = _solve(line, 0 * line.start, 0.0)
    rising = solved.theta > 0
    forces = solved.forces / np.where(rising, solved.theta, 1)[:, None, None]
    return rising & _allowed(line.scaled, _balanced(line, forces, line.direction), strictly=True)


def _balanced(line: _Line, forces: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Move forces ``(B, n, 3)`` as little as possible until they give ``target`` ``(B, 6)``; NaN where they cannot."""
    free = line.scaled.weights > 0
    inverse = np.linalg.pinv(_grasp_matrix(line.scaled), rcond=CUT)
    forces = np.where(np.isfinite(forces), forces, 0)
    for _ in range(4):
        residual = target - resultant(line.scaled, forces)
        forces = forces + np.einsum("bji,bi->bj", inverse, residual).reshape(forces.shape)
        forces = np.where(free[..., None], forces, 0)
    is_unbalanced = norm(target - resultant(line.scaled, forces)) > BALANCED * (1 + norm(forces).sum(-1))
    return np.where(is_unbalanced[:, None, None], np.nan, forces)


def _allowed(scaled: Centred, forces: np.ndarray, strictly: bool = False) -> np.ndarray:
    along = np.sum(forces * scaled.normals, -1)
    room = scaled.friction * along - norm(forces - along[..., None] * scaled.normals)
    fixed = scaled.weights <= 0
    inside = (room > 0) if strictly else (room >= 0) & (along >= 0)
    return np.all(inside | fixed, -1)


def _largest_work(scaled: Centred, twist: np.ndarray) -> np.ndarray:
    """Return the largest work of any contact along a twist, per unit of normal force ``(B,)``."""
    v = scaled.velocities(twist)
    along = np.sum(v * scaled.normals, -1)
    support = along + scaled.friction * norm(v - along[..., None] * scaled.normals)
    return np.max(np.where(scaled.weights > 0, support, -np.inf), -1)


def _grasp_matrix(scaled: Centred) -> np.ndarray:
    """Return G ``(B, 6, 3n)`` in double precision; columns of contacts with weight zero are zero."""
    columns = [scaled.velocities(np.broadcast_to(e, (len(scaled.wrench), 6))) for e in np.eye(6, dtype=Wide)]
    matrix = np.stack(columns, 1) * (scaled.weights > 0)[:, None, :, None]
    return np.asarray(matrix.reshape(len(matrix), 6, -1), float)


class _Solved(NamedTuple):
    """Clarabel's unchecked solution in the line's coordinates; NaN where Clarabel failed."""

    theta: np.ndarray
    forces: np.ndarray
    multiplier: np.ndarray


def _solve(line: _Line, start: np.ndarray, slack: float) -> _Solved:
    scaled = line.scaled
    matrix = _grasp_matrix(scaled)
    left, sizes, _ = np.linalg.svd(matrix, full_matrices=False)
    significant = sizes > CUT * sizes[:, :1]
    normals, friction = np.asarray(scaled.normals, float), np.asarray(scaled.friction, float)
    answers = []
    for i in range(len(start)):
        axes = np.stack([np.stack([a, *(-m * t for t in tangents(a))]) for a, m in zip(normals[i], friction[i])])
        free = np.flatnonzero(scaled.weights[i] > 0)
        basis = left[i][:, significant[i]]
        motion = (matrix[i].T @ basis).reshape(len(axes), 3, -1)
        cones = (axes @ motion)[free]
        theta, along_axes, y = _clarabel(
            cones, basis.T @ np.asarray(start[i], float), basis.T @ np.asarray(line.direction[i], float), slack
        )
        forces = np.zeros((len(axes), 3))
        forces[free] = np.einsum("ni,nij->nj", along_axes, axes[free])
        answers.append((theta, forces, basis @ y))
    return _Solved(*(np.stack([a[part] for a in answers]).astype(Wide) for part in range(3)))


def _clarabel(
    cones: np.ndarray, start: np.ndarray, direction: np.ndarray, slack: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """Solve the dual; return theta, forces along each cone's axes, and y. If infeasible, a ray: theta > 0.

    ``cones`` ``(n, 3, r)`` maps y to (work along the normal, minus friction times work across it), which must be
    at most ``-slack`` by its first entry less the length of the others.
    """
    clarabel, sparse = _solver()
    n, _, size = cones.shape
    rows = sparse.csc_matrix(np.concatenate([direction[None], cones.reshape(-1, size)]))
    bound = np.concatenate([[1.0], np.tile([-slack, 0.0, 0.0], n)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-13
    settings.tol_infeas_abs = settings.tol_infeas_rel = 1e-10
    kinds = [clarabel.ZeroConeT(1)] + [clarabel.SecondOrderConeT(3)] * n
    answer = clarabel.DefaultSolver(sparse.csc_matrix((size, size)), -start, rows, bound, kinds, settings).solve()
    z = np.asarray(answer.z)
    return -z[0], z[1:].reshape(n, 3), np.asarray(answer.x)


def _solver() -> tuple:
    try:
        import clarabel
        from scipy import sparse
    except ImportError as error:
        raise ImportError("problems at the reachable limit need Clarabel: pip install 'jaxgrasp[bench]'") from error
    return clarabel, sparse
