"""cvxpylayers in JAX: reverse derivatives through a convex program, one pull-back for each component of the forces.

The layer calls diffcp. How good the derivatives are hangs on how tightly the program is solved.
"""

from collections.abc import Callable
from functools import partial

import cvxpy
import jax
import numpy as np
from cvxpylayers.jax import CvxpyLayer

from benchmarks.rivals.interface import Differentiator
from benchmarks.rivals.squeezed import Squeezed, squeezed
from jaxgrasp.testing.references import Problems


def _layer(contacts: int) -> CvxpyLayer:
    y = cvxpy.Variable(3 * contacts)
    friction, edges = cvxpy.Parameter(contacts), cvxpy.Parameter(contacts)
    balance, residual_wrench = cvxpy.Parameter((6, 3 * contacts)), cvxpy.Parameter(6)
    cones = [cvxpy.SOC(friction[i] * y[3 * i] + edges[i], y[3 * i + 1 : 3 * i + 3]) for i in range(contacts)]
    program = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(y) / 2), [balance @ y == residual_wrench, *cones])
    return CvxpyLayer(program, parameters=[friction, balance, residual_wrench, edges], variables=[y])


def _prepare(problem: Problems, settings: dict) -> Callable[[], np.ndarray]:
    squeezed_programs, layer = squeezed(problem), _layer(problem.squeeze.shape[1])

    def run() -> np.ndarray:
        return np.stack([_jacobian(squeezed_programs, layer, index, settings) for index in range(len(problem.squeeze))])

    run()
    return run


def _jacobian(squeezed_programs: Squeezed, layer: CvxpyLayer, index: int, settings: dict) -> np.ndarray:
    friction = jax.numpy.asarray(squeezed_programs.programs.friction[index])

    def solve(*data: jax.Array) -> tuple[jax.Array, ...]:
        return layer(friction, *data, solver_args=dict(settings))

    (y,), pull = jax.vjp(solve, *squeezed_programs.data(index))
    slopes = [np.asarray(slope) for slope in squeezed_programs.slopes(index)]

    def row(component: np.ndarray) -> np.ndarray:
        by_data = pull((jax.numpy.asarray(component),))
        parts = [np.tensordot(np.asarray(d), s, d.ndim) for d, s in zip(by_data, slopes, strict=True)]
        return np.sum(parts, 0)

    by_squeeze = np.stack([row(component) for component in np.eye(y.size)])
    return squeezed_programs.finish(index, np.asarray(y), by_squeeze)


SETTINGS: dict[str, dict] = {
    "as it comes": {},
    "SCS 1e-10, dense": {"solve_method": "SCS", "eps": 1e-10, "mode": "dense"},
}
DIFFERENTIATORS = [
    Differentiator(f"cvxpylayers, {name}", "cvxpylayers", "Apache-2.0", partial(_prepare, settings=settings))
    for name, settings in SETTINGS.items()
]
