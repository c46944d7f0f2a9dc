"""ECOS, an interior-point method for second-order cones with linear objectives.

Its Python interface takes every problem anew.
"""

import ecos
import numpy as np
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import Conic, conic, epigraph, program
from jaxgrasp.testing.problem_data import Problems

TOLERANCE = 1e-8
OPTIMAL, PRIMAL_INFEASIBLE = 0, 1


def _posed(posed: Conic, index: int) -> tuple:
    cost, rows, cones = epigraph(posed.contacts, posed.pulls)
    matrix = posed.matrix(index)
    wide = sparse.hstack([matrix, sparse.csc_matrix((matrix.shape[0], 1))], format="csc")
    below = sparse.vstack([wide[6:], rows], format="csc")
    bound = np.concatenate([posed.bounds[index, 6:], np.zeros(rows.shape[0])])
    return cost, below, bound, cones, sparse.csc_matrix(wide[:6]), posed.bounds[index, :6]


def _prepare(problem: Problems, weights: np.ndarray) -> Prepared:
    programs = program(problem, weights)
    conics = conic(programs)
    posed = [_posed(conics, index) for index in range(len(conics.values))]

    def one(arguments: tuple):
        return ecos.solve(*arguments, verbose=False, abstol=TOLERANCE, reltol=TOLERANCE, feastol=TOLERANCE)

    def read(found: list):
        y = np.array([f["x"] for f in found])
        status = np.array([f["info"]["exitFlag"] for f in found])
        multiplier = -np.array([f["y"] for f in found]) * y[:, -1:]
        return programs.answers(y[:, :-1], multiplier, status == OPTIMAL, status == PRIMAL_INFEASIBLE)

    return Prepared(lambda: [one(arguments) for arguments in posed], read)


RIVALS = [Rival(f"ECOS {TOLERANCE:.0e}", "ecos", "GPL-3.0", _prepare, TOLERANCE, batched=False)]
