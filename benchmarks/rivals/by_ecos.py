"""ECOS, an interior-point method for second-order cones with linear objectives.

Its Python interface takes every problem anew.
"""

import ecos
import numpy as np
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import Conic, conic, epigraph, program
from jaxgrasp.testing.references import Problems

TOLERANCE = 1e-8
OPTIMAL, PRIMAL_INFEASIBLE = 0, 1


def _arguments(conics: Conic, index: int) -> tuple:
    cost, rows, cones = epigraph(conics.contacts, conics.pulls)
    matrix = conics.matrix(index)
    wide = sparse.hstack([matrix, sparse.csc_matrix((matrix.shape[0], 1))], format="csc")
    below = sparse.vstack([wide[6:], rows], format="csc")
    bound = np.concatenate([conics.bounds[index, 6:], np.zeros(rows.shape[0])])
    return cost, below, bound, cones, sparse.csc_matrix(wide[:6]), conics.bounds[index, :6]


def _prepare(problem: Problems, weights: np.ndarray) -> Prepared:
    programs = program(problem, weights)
    conics = conic(programs)
    calls = [_arguments(conics, index) for index in range(len(conics.values))]

    def solve_one(arguments: tuple):
        return ecos.solve(*arguments, verbose=False, abstol=TOLERANCE, reltol=TOLERANCE, feastol=TOLERANCE)

    def read(outputs: list):
        y = np.array([f["x"] for f in outputs])
        status = np.array([f["info"]["exitFlag"] for f in outputs])
        multiplier = -np.array([f["y"] for f in outputs]) * y[:, -1:]
        return programs.answers(y[:, :-1], multiplier, status == OPTIMAL, status == PRIMAL_INFEASIBLE)

    return Prepared(lambda: [solve_one(arguments) for arguments in calls], read)


RIVALS = [Rival(f"ECOS {TOLERANCE:.0e}", "ecos", "GPL-3.0", _prepare, TOLERANCE, batched=False)]
