"""The compact dual of a linear program: equations eliminated, and the dual of what is left (see ``cheng_orin.py``)."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.literature.linear import (
    INFEASIBLE,
    OPTIMAL,
    STOPPED,
    UNBOUNDED,
    LinearOptimum,
    LinearProgram,
    Size,
    highs,
    optimum,
)
from jaxgrasp.literature.method_answer import MethodStatus

RANK_CUT = 1e-11
"""Equations below this share of the largest count as repetitions of the others."""
CONSISTENT = 1e-9
"""What a repeated equation may leave, relative to its right side."""


class Compact(NamedTuple):
    """Minimise cost . z + constant subject to rows z <= bounds, where x = particular + basis z."""

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
    found = highs(compact.bounds, None, None, compact.rows.T, -compact.cost, (0, None))
    if found.status == OPTIMAL:
        free = found.eqlin.marginals
        x = compact.particular + compact.basis @ free
        return optimum(OPTIMAL, x, compact.constant - found.fun, found.nit)
    if found.status == STOPPED:
        return optimum(STOPPED, None, 0.0, found.nit)
    # Without an optimum either there is no point, or the measure falls without end.
    return optimum(UNBOUNDED if _any_point(compact) else INFEASIBLE, None, 0.0, found.nit)


def eliminate(program: LinearProgram) -> Compact | None:
    """The program in its free unknowns, by row-reduced echelon form; None where its equations contradict each other."""
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
    """What a simplex method is given: by the plain program, and by its compact dual; bounds of unknowns aside."""
    plain = np.concatenate([program.equal, program.rows])
    compact = eliminate(program)
    dual = np.zeros((0, 0)) if compact is None else compact.rows.T
    return _size(plain), _size(dual)


def _size(matrix: np.ndarray) -> Size:
    rows, columns = matrix.shape
    return Size(rows, columns, int(np.count_nonzero(np.abs(matrix) > np.finfo(float).eps)))


def _any_point(compact: Compact) -> bool:
    """Whether any z meets the rows: no combination of them is a contradiction."""
    rows = compact.rows.T
    return highs(compact.bounds, None, None, rows, np.zeros(len(rows)), (0, None)).status == OPTIMAL


def _without_choice(compact: Compact) -> LinearOptimum:
    """The equations alone decide."""
    scale = 1 + np.abs(compact.bounds)
    if np.any(compact.bounds < -CONSISTENT * scale):
        return optimum(INFEASIBLE, None, 0.0, 0)
    return LinearOptimum(MethodStatus.SOLVED, compact.particular, compact.constant, 0)
