"""Clarabel, an interior-point method for conic programs: kept and updated in place, or set up anew each time."""

from functools import partial
from typing import Any

import clarabel
import numpy as np
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import Conic, conic, program
from jaxgrasp.testing.references import Problems


def _settings(tolerance: float) -> Any:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # Presolve would change the sparsity, which forbids updates.
    settings.presolve_enable = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    return settings


def _solver(problem: Conic, index: int, settings: Any) -> Any:
    size = problem.pattern.shape[1]
    kinds = [clarabel.ZeroConeT(6)]
    kinds += [clarabel.NonnegativeConeT(problem.pulls)] if problem.pulls else []
    kinds += [clarabel.SecondOrderConeT(3)] * problem.contacts
    identity = sparse.eye(size, format="csc")
    return clarabel.DefaultSolver(
        identity, np.zeros(size), problem.matrix(index), problem.bounds[index], kinds, settings
    )


def _prepare(problem: Problems, weights: np.ndarray, tolerance: float, anew: bool) -> Prepared:
    programs = program(problem, weights)
    conics, settings = conic(programs), _settings(tolerance)
    shared_solver = _solver(conics, 0, settings)

    def solve_one(index: int):
        solver = shared_solver
        if anew:
            solver = _solver(conics, index, settings)
        else:
            solver.update(A=conics.values[index], b=conics.bounds[index])
        solution = solver.solve()
        return solution.x, solution.z[:6], solution.status

    def read(outputs: list):
        y, z, status = (list(column) for column in zip(*outputs, strict=True))
        solved = [s == clarabel.SolverStatus.Solved for s in status]
        hopeless = [s == clarabel.SolverStatus.PrimalInfeasible for s in status]
        return programs.answers(np.array(y), -np.array(z), solved, hopeless)

    return Prepared(lambda: [solve_one(index) for index in range(len(conics.values))], read)


def _rival(tolerance: float, anew: bool) -> Rival:
    how = "anew" if anew else "updated"
    prepare = partial(_prepare, tolerance=tolerance, anew=anew)
    return Rival(f"Clarabel {how} {tolerance:.0e}", "clarabel", "Apache-2.0", prepare, tolerance, batched=False)


RIVALS = [_rival(1e-8, anew=False), _rival(1e-12, anew=False), _rival(1e-8, anew=True)]
