"""The shortest vector in a polyhedron, by a primal active-set method (see ``kuhn_tucker.py``)."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.literature.linear import LinearProgram, solve_plain

ROUNDING = 1e-11
"""Slacks, steps and multipliers below this, relative to the size of the vectors, count as zero."""
PARALLEL = 1e-9
"""Sine of the angle between a step and a face below which the face does not block it: what a working set may span."""
VIOLATED = 1e-7
"""What a point may violate before the polyhedron counts as empty: what HiGHS itself leaves."""


class Shortest(NamedTuple):
    """Minimise |z|^2 / 2 subject to rows z <= bounds, rows of unit length."""

    rows: np.ndarray
    bounds: np.ndarray


class Vertex(NamedTuple):
    """The optimum, and how often the working set changed on the way."""

    z: np.ndarray
    changes: int


def first_point(problem: Shortest) -> tuple[np.ndarray | None, int]:
    """Zero, if it is inside; else the point farthest inside, up to a distance of one; and the pivots it took."""
    rows, bounds = problem
    unknowns = rows.shape[1]
    if np.all(bounds >= 0):
        return np.zeros(unknowns), 0
    distance = np.append(np.zeros(unknowns), 1.0)
    program = LinearProgram(
        cost=-distance,
        equal=np.zeros((0, unknowns + 1)),
        right=np.zeros(0),
        rows=np.vstack([np.column_stack([rows, np.ones(len(rows))]), distance]),
        bounds=np.append(bounds, 1.0),
    )
    found = solve_plain(program)
    if found.x is None or found.x[-1] < -VIOLATED:
        return None, found.pivots
    return found.x[:-1], found.pivots


def shortest(problem: Shortest, start: np.ndarray, max_steps: int) -> Vertex | None:
    """The shortest vector, searched from a point inside; None where the steps run out."""
    rows, z = problem.rows, start
    # A start on a face may be a rounding beyond it.
    bounds = np.maximum(problem.bounds, rows @ z)
    working: list[int] = []
    still = 0
    for changes in range(max_steps):
        target, multipliers = _on_faces(rows[working], bounds[working])
        step = target - z
        size = max(float(np.linalg.norm(z)), float(np.linalg.norm(target)))
        careful = still > len(rows)
        # As many faces as unknowns leave no step but rounding.
        if np.linalg.norm(step) <= ROUNDING * size or len(working) == len(z):
            leaving = _leaving(working, multipliers, ROUNDING * size, careful)
            if leaving is None:
                return Vertex(z, changes)
            working.remove(leaving)
            continue
        share, blocking = _blocking(rows, bounds, z, step, working)
        still = 0 if share * np.linalg.norm(step) > ROUNDING * size else still + 1
        z = z + share * step
        if blocking is None:
            continue
        working.append(blocking)
    return None


def _on_faces(rows: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shortest vector with rows z = bounds, and its multipliers."""
    if not len(rows):
        return np.zeros(rows.shape[1]), np.zeros(0)
    orthogonal, upper = np.linalg.qr(rows.T)
    across = np.linalg.solve(upper.T, bounds)
    return orthogonal @ across, -np.linalg.solve(upper, across)


def _leaving(working: list[int], multipliers: np.ndarray, rounding: float, careful: bool) -> int | None:
    """The face whose multiplier pulls most; or the first that pulls, so that no sequence repeats."""
    pulling = [face for face, multiplier in zip(working, multipliers, strict=True) if multiplier < -rounding]
    if not pulling:
        return None
    return min(pulling) if careful else working[int(np.argmin(multipliers))]


def _blocking(rows, bounds, z, step, working: list[int]) -> tuple[float, int | None]:
    """How much of a step stays inside, and which face stops it; the first of equals."""
    speed = rows @ step
    speed[working] = 0
    against = np.flatnonzero(speed > PARALLEL * np.linalg.norm(step))
    if not len(against):
        return 1.0, None
    shares = np.maximum(bounds[against] - rows[against] @ z, 0) / speed[against]
    nearest = int(np.argmin(shares))
    if shares[nearest] >= 1:
        return 1.0, None
    return float(shares[nearest]), int(against[nearest])
