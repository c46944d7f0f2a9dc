"""QOCO, an interior-point method for second-order cones, updated in place. It does not detect infeasibility."""

import numpy as np
import qoco
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import conic, program
from jaxgrasp.testing.problem_data import Problems

TOLERANCE = 1e-8


def _prepare(problem: Problems, weights: np.ndarray) -> Prepared:
    programs = program(problem, weights)
    posed = conic(programs)
    size, contacts = posed.pattern.shape[1], posed.contacts
    top = posed.pattern.indices < 6
    first = posed.matrix(0)
    balance, cones = sparse.csc_matrix(first[:6]), sparse.csc_matrix(first[6:])
    equal, bound = posed.bounds[:, :6], posed.bounds[:, 6:]
    solver = qoco.QOCO()
    solver.setup(
        size, bound.shape[1], 6, sparse.eye(size, format="csc"), np.zeros(size), balance, equal[0], cones, bound[0],
        posed.pulls, contacts, np.full(contacts, 3), abstol=TOLERANCE, reltol=TOLERANCE, verbose=0,
    )  # fmt: skip

    def one(index: int):
        solver.update_matrix_data(A=posed.values[index, top], G=posed.values[index, ~top])
        solver.update_vector_data(b=equal[index], h=bound[index])
        found = solver.solve()
        return np.array(found.x), np.array(found.y), found.status

    def read(found: list):
        y, multiplier, status = (list(column) for column in zip(*found, strict=True))
        solved = np.array([s == "QOCO_SOLVED" for s in status])
        return programs.answers(np.array(y), -np.array(multiplier), solved, np.zeros_like(solved))

    return Prepared(lambda: [one(index) for index in range(len(posed.values))], read)


RIVALS = [Rival(f"QOCO updated {TOLERANCE:.0e}", "qoco", "BSD-3-Clause", _prepare, TOLERANCE, batched=False)]
