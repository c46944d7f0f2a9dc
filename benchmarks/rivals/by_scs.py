"""SCS, an operator-splitting method for conic programs.

Its update takes new vectors only, and here the matrix changes with the grasp: every problem is set up anew.
"""

from functools import partial

import numpy as np
import scs
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import conic, program
from jaxgrasp.testing.references import Problems


def _prepare(problem: Problems, weights: np.ndarray, tolerance: float) -> Prepared:
    programs = program(problem, weights)
    conics = conic(programs)
    size = conics.pattern.shape[1]
    identity, nothing = sparse.eye(size, format="csc"), np.zeros(size)
    cones = {"z": 6, "l": conics.pulls, "q": [3] * conics.contacts}

    def solve_one(index: int):
        data = {"P": identity, "A": conics.matrix(index), "b": conics.bounds[index], "c": nothing}
        solution = scs.SCS(data, cones, eps_abs=tolerance, eps_rel=tolerance, verbose=False).solve()
        return solution["x"], solution["y"][:6], solution["info"]["status_val"]

    def read(outputs: list):
        y, z, status = (np.array(column) for column in zip(*outputs, strict=True))
        return programs.answers(y, -z, status == scs.SOLVED, status == scs.INFEASIBLE)

    return Prepared(lambda: [solve_one(index) for index in range(len(conics.values))], read)


def _rival(tolerance: float) -> Rival:
    return Rival(f"SCS {tolerance:.0e}", "scs", "MIT", partial(_prepare, tolerance=tolerance), tolerance, batched=False)


RIVALS = [_rival(1e-4), _rival(1e-9)]
