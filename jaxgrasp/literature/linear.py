"""Linear programs, by SciPy's HiGHS: as they stand, or as Cheng and Orin's compact dual."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.literature.method_answer import MethodStatus

OPTIMAL, STOPPED, INFEASIBLE, UNBOUNDED = 0, 1, 2, 3
"""SciPy's codes; a further one says that HiGHS met numerical difficulties, or could not tell the last two apart."""


class LinearProgram(NamedTuple):
    """Minimise cost . x subject to equal x = right and rows x <= bounds, x of any sign."""

    cost: np.ndarray
    equal: np.ndarray
    right: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray


class LinearOptimum(NamedTuple):
    """What was found; ``x`` is None unless SOLVED."""

    status: MethodStatus
    x: np.ndarray | None
    value: float
    pivots: int


class Size(NamedTuple):
    """How large a program is that a simplex method is given."""

    rows: int
    columns: int
    nonzeros: int


def solve_plain(program: LinearProgram) -> LinearOptimum:
    """Solve the program as it stands, by the dual simplex method."""
    found = highs(program.cost, program.rows, program.bounds, program.equal, program.right, (None, None))
    if found.status in (OPTIMAL, STOPPED, INFEASIBLE):
        return optimum(found.status, found.x, found.fun, found.nit)
    # Whether there is any point at all decides what is unbounded.
    bare = highs(np.zeros_like(program.cost), program.rows, program.bounds, program.equal, program.right, (None, None))
    if bare.status == INFEASIBLE:
        return optimum(INFEASIBLE, None, 0.0, found.nit)
    return optimum(found.status, None, 0.0, found.nit)


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
