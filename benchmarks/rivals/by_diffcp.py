"""diffcp: forward derivatives through a conic program's solution, by an exact dense factorisation.

That takes linear objectives only, and here contacts that all have friction. How good the derivatives are hangs on how
tightly the program is solved.
"""

from collections.abc import Callable
from functools import partial

import diffcp
import numpy as np
from scipy import sparse

from benchmarks.rivals.interface import Differentiator
from benchmarks.rivals.program import Conic, conic, epigraph
from benchmarks.rivals.squeezed import Squeezed, squeezed
from jaxgrasp.testing.references import Problems


def _prepare(problem: Problems, settings: dict) -> Callable[[], np.ndarray]:
    squeezed_programs = squeezed(problem)
    conics = conic(squeezed_programs.programs)

    def run() -> np.ndarray:
        return np.stack(
            [_jacobian(squeezed_programs, conics, index, settings) for index in range(len(problem.squeeze))]
        )

    run()
    return run


def _jacobian(squeezed_programs: Squeezed, conics: Conic, index: int, settings: dict) -> np.ndarray:
    cost, rows, cones = epigraph(conics.contacts, conics.pulls)
    wide = sparse.vstack([_widened(conics.matrix(index)), rows], format="csc")
    bound = np.concatenate([conics.bounds[index], np.zeros(rows.shape[0])])
    solution, _, _, derivative, _ = diffcp.solve_and_derivative(
        wide, bound, cost, {"z": 6, **cones}, mode="dense", **settings
    )
    size = 3 * conics.contacts
    slopes = squeezed_programs.slopes(index)
    by_squeeze = np.stack(
        [derivative(*_data_change(slopes, j, wide.shape, cost))[0][:size] for j in range(conics.contacts)], -1
    )
    return squeezed_programs.finish(index, solution[:size], by_squeeze)


def _data_change(slopes, direction: int, shape: tuple[int, int], cost: np.ndarray) -> tuple:
    """Return the change of A, b and c as one squeezing force grows."""
    balance, residual_wrench, edges = (np.asarray(slope)[..., direction] for slope in slopes)
    matrix = sparse.lil_matrix(shape)
    matrix[:6, : balance.shape[1]] = balance
    bound = np.zeros(shape[0])
    bound[:6] = residual_wrench
    bound[6 : 6 + 3 * len(edges) : 3] = edges
    return matrix.tocsc(), bound, np.zeros_like(cost)


def _widened(matrix: sparse.csc_matrix) -> sparse.csc_matrix:
    return sparse.hstack([matrix, sparse.csc_matrix((matrix.shape[0], 1))], format="csc")


SETTINGS: dict[str, dict] = {
    "Clarabel as it comes": {"solve_method": "CLARABEL"},
    "SCS 1e-10": {"solve_method": "SCS", "eps": 1e-10},
}
DIFFERENTIATORS = [
    Differentiator(f"diffcp dense, {name}", "diffcp", "Apache-2.0", partial(_prepare, settings=settings))
    for name, settings in SETTINGS.items()
]
