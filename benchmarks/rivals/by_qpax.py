"""qpax, an interior-point method for quadratic programs in JAX, on inscribed pyramids.

It holds slacks and multipliers above the square root of the machine epsilon, so tolerances under 1e-7 are out of its
reach in float64.
"""

import jax
import jax.numpy as jnp
import numpy as np
import qpax

from benchmarks.rivals.interface import Prepared, Rival
from benchmarks.rivals.program import facets, program
from jaxgrasp.testing.references import Problems

SIDES, TOLERANCE = 8, 1e-6


@jax.jit
@jax.vmap
def _solve(balance: jax.Array, residual_wrench: jax.Array, rows: jax.Array, limits: jax.Array) -> tuple:
    size = rows.shape[1]
    y, _, _, _, converged, _ = qpax.solve_qp(
        jnp.eye(size), jnp.zeros(size), balance, residual_wrench, rows, limits, solver_tol=TOLERANCE
    )
    return y, converged


def _prepare(problem: Problems, weights: np.ndarray) -> Prepared:
    programs = program(problem, weights)
    arrays = jax.device_put((programs.balance, programs.residual_wrench, *facets(programs, SIDES)))

    def read(output: tuple):
        y, converged = jax.device_get(output)
        return programs.answers(y, None, converged == 1, np.zeros(len(y), bool))

    return Prepared(lambda: jax.block_until_ready(_solve(*arrays)), read)


RIVALS = [
    Rival(f"qpax pyramid of {SIDES} {TOLERANCE:.0e}", "qpax", "Apache-2.0", _prepare, TOLERANCE, cones="pyramids")
]
