"""QOCO, an interior-point method for second-order cones, updated in place. It does not detect infeasibility."""

import numpy as np
import qoco
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import conic, program
from jaxgrasp.testing.references import Problems

TOLERANCE = 1e-8


def _prepare(problem: Problems, weights: np.ndarray) -> Prepared:
    programs = program(problem, weights)
    conics = conic(programs)
    size, contacts = conics.pattern.shape[1], conics.contacts
    top = conics.pattern.indices < 6
    first = conics.matrix(0)
    balance, cones = sparse.csc_matrix(first[:6]), sparse.csc_matrix(first[6:])
    equal, bound = conics.bounds[:, :6], conics.bounds[:, 6:]
    solver = qoco.QOCO()
    solver.setup(
        size, bound.shape[1], 6, sparse.eye(size, format="csc"), np.zeros(size), balance, equal[0], cones, bound[0],
        conics.pulls, contacts, np.full(contacts, 3), abstol=TOLERANCE, reltol=TOLERANCE, verbose=0,
    )  # fmt: skip

    def solve_one(index: int):
        solver.update_matrix_data(A=conics.values[index, top], G=conics.values[index, ~top])
        solver.update_vector_data(b=equal[index], h=bound[index])
        solution = solver.solve()
        return np.array(solution.x), np.array(solution.y), solution.status

    def read(outputs: list):
        y, multiplier, status = (list(column) for column in zip(*outputs, strict=True))
        solved = np.array([s == "QOCO_SOLVED" for s in status])
        return programs.answers(np.array(y), -np.array(multiplier), solved, np.zeros_like(solved))

    return Prepared(lambda: [solve_one(index) for index in range(len(conics.values))], read)


RIVALS = [Rival(f"QOCO updated {TOLERANCE:.0e}", "qoco", "BSD-3-Clause", _prepare, TOLERANCE, batched=False)]
