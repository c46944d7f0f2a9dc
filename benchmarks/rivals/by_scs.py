"""SCS, an operator-splitting method for conic programs.

Its update takes new vectors only, and here the matrix changes with the grasp: every problem is set up anew.
"""

from functools import partial

import numpy as np
import scs
from scipy import sparse

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import conic, program
from jaxgrasp.testing.problem_data import Problems


def _prepare(problem: Problems, weights: np.ndarray, tolerance: float) -> Prepared:
    programs = program(problem, weights)
    posed = conic(programs)
    size = posed.pattern.shape[1]
    identity, nothing = sparse.eye(size, format="csc"), np.zeros(size)
    cones = {"z": 6, "l": posed.pulls, "q": [3] * posed.contacts}

    def one(index: int):
        data = {"P": identity, "A": posed.matrix(index), "b": posed.bounds[index], "c": nothing}
        found = scs.SCS(data, cones, eps_abs=tolerance, eps_rel=tolerance, verbose=False).solve()
        return found["x"], found["y"][:6], found["info"]["status_val"]

    def read(found: list):
        y, z, status = (np.array(column) for column in zip(*found, strict=True))
        return programs.answers(y, -z, status == scs.SOLVED, status == scs.INFEASIBLE)

    return Prepared(lambda: [one(index) for index in range(len(posed.values))], read)


def _rival(tolerance: float) -> Rival:
    return Rival(f"SCS {tolerance:.0e}", "scs", "MIT", partial(_prepare, tolerance=tolerance), tolerance, batched=False)


RIVALS = [_rival(1e-4), _rival(1e-9)]
