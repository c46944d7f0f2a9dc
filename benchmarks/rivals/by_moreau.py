"""Moreau, an interior-point method for batches of conic programs of one sparsity, through its NumPy interface."""

import moreau
import numpy as np
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import Conic, conic, program
from jaxgrasp.testing.references import Problems

TOLERANCE = 1e-8


def _solver(conics: Conic) -> tuple[moreau.CompiledSolver, np.ndarray]:
    """Return the solver of this sparsity, and the order of its values: by row, where ours go by column."""
    rows, columns = conics.pattern.shape
    numbers = np.arange(conics.pattern.nnz)
    by_row = sparse.csc_matrix((numbers, conics.pattern.indices, conics.pattern.indptr), (rows, columns)).tocsr()
    cones = moreau.Cones(num_zero_cones=6, num_nonneg_cones=conics.pulls, so_cone_dims=[3] * conics.contacts)
    inner = moreau.IPMSettings(tol_gap_abs=TOLERANCE, tol_gap_rel=TOLERANCE, tol_feas=TOLERANCE)
    settings = moreau.Settings(solver="ipm", device="cpu", batch_size=len(conics.values), ipm_settings=inner)
    diagonal = np.arange(columns + 1)
    solver = moreau.CompiledSolver(
        columns, rows, diagonal, diagonal[:-1], by_row.indptr, by_row.indices, cones=cones, settings=settings
    )
    return solver, by_row.data


def _prepare(problem: Problems, weights: np.ndarray) -> Prepared:
    programs = program(problem, weights)
    conics = conic(programs)
    solver, order = _solver(conics)
    size = conics.pattern.shape[1]
    shape = (len(conics.values), size)
    identities, nothing = np.ones(shape), np.zeros(shape)
    values = np.ascontiguousarray(conics.values[:, order])

    def run():
        solver.setup(identities, values)
        solution = solver.solve(nothing, conics.bounds)
        return solution.x, solution.z, solver.info.status

    def read(output: tuple):
        y, z, status = output
        solved = [s == moreau.SolverStatus.Solved for s in status]
        hopeless = [s == moreau.SolverStatus.PrimalInfeasible for s in status]
        return programs.answers(y, -np.asarray(z)[:, :6], solved, hopeless)

    return Prepared(run, read)


RIVALS = [Rival(f"Moreau {TOLERANCE:.0e}", "moreau", "Apache-2.0", _prepare, TOLERANCE)]
