"""Moreau, an interior-point method for batches of conic programs of one sparsity, through its NumPy interface."""

import moreau
import numpy as np
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import Conic, conic, program
from jaxgrasp.testing.problem_data import Problems

TOLERANCE = 1e-8


def _solver(posed: Conic) -> tuple[moreau.CompiledSolver, np.ndarray]:
    """The solver of this sparsity, and the order of its values: by row, where ours go by column."""
    rows, columns = posed.pattern.shape
    numbers = np.arange(posed.pattern.nnz)
    by_row = sparse.csc_matrix((numbers, posed.pattern.indices, posed.pattern.indptr), (rows, columns)).tocsr()
    cones = moreau.Cones(num_zero_cones=6, num_nonneg_cones=posed.pulls, so_cone_dims=[3] * posed.contacts)
    inner = moreau.IPMSettings(tol_gap_abs=TOLERANCE, tol_gap_rel=TOLERANCE, tol_feas=TOLERANCE)
    settings = moreau.Settings(solver="ipm", device="cpu", batch_size=len(posed.values), ipm_settings=inner)
    each = np.arange(columns + 1)
    solver = moreau.CompiledSolver(
        columns, rows, each, each[:-1], by_row.indptr, by_row.indices, cones=cones, settings=settings
    )
    return solver, by_row.data


def _prepare(problem: Problems, weights: np.ndarray) -> Prepared:
    programs = program(problem, weights)
    posed = conic(programs)
    solver, order = _solver(posed)
    size = posed.pattern.shape[1]
    shape = (len(posed.values), size)
    identities, nothing = np.ones(shape), np.zeros(shape)
    values = np.ascontiguousarray(posed.values[:, order])

    def run():
        solver.setup(identities, values)
        found = solver.solve(nothing, posed.bounds)
        return found.x, found.z, solver.info.status

    def read(found: tuple):
        y, z, status = found
        solved = [s == moreau.SolverStatus.Solved for s in status]
        hopeless = [s == moreau.SolverStatus.PrimalInfeasible for s in status]
        return programs.answers(y, -np.asarray(z)[:, :6], solved, hopeless)

    return Prepared(run, read)


RIVALS = [Rival(f"Moreau {TOLERANCE:.0e}", "moreau", "Apache-2.0", _prepare, TOLERANCE)]
