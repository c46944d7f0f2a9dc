"""Linear programs by SciPy's HiGHS: the plain program, or its compact dual (see ``orin_oh.py``).

Friction pyramids and limits as inequalities, rows . forces <= bounds, each row of unit length.

A slack is thus a distance in the space of contact forces [N], for every type of row.
"""

from typing import Literal, NamedTuple

import numpy as np

from jaxgrasp.literature.method_input import MethodStatus
from jaxgrasp.literature.scaled_problems import HostProblem

Pyramid = Literal["inscribed", "circumscribed"]
"""Edges on the cone, so that friction allows all forces; or facets on the cone, which contain it."""


def check_pyramid(sides: int, pyramid: Pyramid) -> None:
    """Raise ValueError for an invalid number of sides or type of pyramid."""
    if sides < 3:
        raise ValueError(f"sides is {sides}: expected 3 or more")
    if pyramid not in ("inscribed", "circumscribed"):
        raise ValueError(f"pyramid is {pyramid!r}: expected 'inscribed' or 'circumscribed'")


def constraint_rows(problem: HostProblem, sides: int, pyramid: Pyramid) -> tuple[np.ndarray, np.ndarray]:
    """Collect all inequalities: facets, then normal forces from below and above, then torques both ways."""
    parts = (facet_rows(problem, sides, pyramid), normal_rows(problem), torque_rows(problem))
    rows, bounds = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rows, bounds


def facet_rows(problem: HostProblem, sides: int, pyramid: Pyramid) -> tuple[np.ndarray, np.ndarray]:
    """Build the facets ``(m sides, 3m)``; the first edge leans towards the first tangent.

    The directions of the edges depend on the frame, and jump as a normal turns.
    """
    angles = (2 * np.arange(sides) + 1) * np.pi / sides
    around = np.stack([np.cos(angles), np.sin(angles)], -1)
    slope = problem.friction * (np.cos(np.pi / sides) if pyramid == "inscribed" else 1.0)
    outward = np.einsum("kt,mtc->mkc", around, problem.tangents)
    rows = (outward - slope[:, None, None] * problem.normals[:, None]) / np.sqrt(1 + slope**2)[:, None, None]
    return _apart(rows), np.zeros(rows.shape[0] * sides)


def normal_rows(problem: HostProblem) -> tuple[np.ndarray, np.ndarray]:
    """Build the bounds of normal forces: from below by the preload, or zero; from above where one is given."""
    normals = _apart(problem.normals[:, None])
    bounded = np.isfinite(problem.normal_max)
    rows = np.concatenate([-normals, normals[bounded]])
    return rows, np.concatenate([-problem.normal_min, problem.normal_max[bounded]])


def torque_rows(problem: HostProblem) -> tuple[np.ndarray, np.ndarray]:
    """Build the bounds of torques in both directions, for joints that are bounded and that any contact loads."""
    size = np.linalg.norm(problem.torque_rows, axis=-1)
    is_active = np.isfinite(problem.torque_max) & (size > 0)
    rows = problem.torque_rows[is_active] / size[is_active, None]
    bounds = problem.torque_max[is_active] / size[is_active]
    return np.concatenate([rows, -rows]), np.concatenate([bounds, bounds])


def _apart(rows: np.ndarray) -> np.ndarray:
    """Expand rows of each contact's own force ``(m, k, 3)`` to rows of all forces ``(m k, 3m)``."""
    contacts, count = rows.shape[:2]
    wide = np.zeros((contacts, count, contacts, 3))
    wide[np.arange(contacts), :, np.arange(contacts)] = rows
    return wide.reshape(contacts * count, 3 * contacts)


OPTIMAL, STOPPED, INFEASIBLE, UNBOUNDED = 0, 1, 2, 3
"""SciPy's codes; a further code stands for numerical difficulties, or for a program that is either of the last two."""


class LinearProgram(NamedTuple):
    """Program min cost . x subject to equal x = right and rows x <= bounds, x of any sign."""

    cost: np.ndarray
    equal: np.ndarray
    right: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray


class LinearOptimum(NamedTuple):
    """Result of a linear program; ``x`` is None unless SOLVED."""

    status: MethodStatus
    x: np.ndarray | None
    value: float
    pivots: int


class Size(NamedTuple):
    """Size of the program that a simplex method gets."""

    rows: int
    columns: int
    nonzeros: int


def solve_plain(program: LinearProgram) -> LinearOptimum:
    """Solve the plain program, by the dual simplex method."""
    result = highs(program.cost, program.rows, program.bounds, program.equal, program.right, (None, None))
    if result.status in (OPTIMAL, STOPPED, INFEASIBLE):
        return optimum(result.status, result.x, result.fun, result.nit)
    # A feasible point decides between unbounded and infeasible.
    feasibility = highs(
        np.zeros_like(program.cost), program.rows, program.bounds, program.equal, program.right, (None, None)
    )
    if feasibility.status == INFEASIBLE:
        return optimum(INFEASIBLE, None, 0.0, result.nit)
    return optimum(result.status, None, 0.0, result.nit)


def highs(cost, rows, bounds, equal, right, within):
    from scipy.optimize import linprog

    return linprog(cost, rows, bounds, equal, right, bounds=within, method="highs-ds")


def optimum(code: int, x: np.ndarray | None, value: float | None, pivots: int) -> LinearOptimum:
    status = {
        OPTIMAL: MethodStatus.SOLVED,
        INFEASIBLE: MethodStatus.INFEASIBLE,
        UNBOUNDED: MethodStatus.UNBOUNDED,
    }.get(code, MethodStatus.NOT_CONVERGED)
    solved = status == MethodStatus.SOLVED
    return LinearOptimum(status, x if solved else None, float(value or 0.0) if solved else 0.0, int(pivots))


RANK_CUT = 1e-11
"""Equations below this share of the largest count as repetitions of others."""
CONSISTENT = 1e-9
"""Largest residual of a repeated equation, relative to its right side."""


class Compact(NamedTuple):
    """Program min cost . z + constant subject to rows z <= bounds, where x = particular + basis z."""

    cost: np.ndarray
    constant: float
    rows: np.ndarray
    bounds: np.ndarray
    particular: np.ndarray
    basis: np.ndarray


def solve_compact_dual(program: LinearProgram) -> LinearOptimum:
    """Solve the compact dual by the dual simplex method; the unknowns are the multipliers of its equations."""
    compact = eliminate(program)
    if compact is None:
        return optimum(INFEASIBLE, None, 0.0, 0)
    if not len(compact.cost):
        return _without_choice(compact)
    result = highs(compact.bounds, None, None, compact.rows.T, -compact.cost, (0, None))
    if result.status == OPTIMAL:
        free = result.eqlin.marginals
        x = compact.particular + compact.basis @ free
        return optimum(OPTIMAL, x, compact.constant - result.fun, result.nit)
    if result.status == STOPPED:
        return optimum(STOPPED, None, 0.0, result.nit)
    # Without an optimum the primal is either infeasible, or unbounded.
    return optimum(UNBOUNDED if _any_point(compact) else INFEASIBLE, None, 0.0, result.nit)


def eliminate(program: LinearProgram) -> Compact | None:
    """Reduce the program to its free unknowns, by row-reduced echelon form; None where its equations contradict each
    other."""
    from scipy.linalg import qr, solve_triangular

    orthogonal, upper, order = qr(program.equal, pivoting=True)
    sizes = np.abs(np.diag(upper))
    rank = int(np.sum(sizes > RANK_CUT * sizes.max(initial=0.0)))
    right = orthogonal.T @ program.right
    if np.linalg.norm(right[rank:]) > CONSISTENT * np.linalg.norm(program.right):
        return None
    dependent, free = order[:rank], order[rank:]
    solved = solve_triangular(upper[:rank, :rank], np.column_stack([upper[:rank, rank:], right[:rank]]))
    basis = np.zeros((len(order), len(free)))
    basis[dependent], basis[free] = -solved[:, :-1], np.eye(len(free))
    particular = np.zeros(len(order))
    particular[dependent] = solved[:, -1]
    return Compact(
        cost=program.cost @ basis,
        constant=float(program.cost @ particular),
        rows=program.rows @ basis,
        bounds=program.bounds - program.rows @ particular,
        particular=particular,
        basis=basis,
    )


def sizes_of(program: LinearProgram) -> tuple[Size, Size]:
    """Return the sizes of the programs that a simplex method gets, plain and compact dual, without bounds of
    unknowns."""
    plain = np.concatenate([program.equal, program.rows])
    compact = eliminate(program)
    dual = np.zeros((0, 0)) if compact is None else compact.rows.T
    return _size(plain), _size(dual)


def _size(matrix: np.ndarray) -> Size:
    rows, columns = matrix.shape
    return Size(rows, columns, int(np.count_nonzero(np.abs(matrix) > np.finfo(float).eps)))


def _any_point(compact: Compact) -> bool:
    """Return whether any z satisfies the rows: no combination of them is a contradiction."""
    rows = compact.rows.T
    return highs(compact.bounds, None, None, rows, np.zeros(len(rows)), (0, None)).status == OPTIMAL


def _without_choice(compact: Compact) -> LinearOptimum:
    """Evaluate a program whose equations determine all unknowns."""
    scale = 1 + np.abs(compact.bounds)
    if np.any(compact.bounds < -CONSISTENT * scale):
        return optimum(INFEASIBLE, None, 0.0, 0)
    return LinearOptimum(MethodStatus.SOLVED, compact.particular, compact.constant, 0)
