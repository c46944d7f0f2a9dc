"""jaxgrasp's own optimum, and the interface to everything else that runs behind its public functions."""

from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import jax
import numpy as np

import jaxgrasp
from benchmarks.rivals.interface import Answers, Prepared, Rival
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import references as R
from jaxgrasp.testing.references import Problems

Method = Callable[[Grasp, jax.Array, jax.Array], jaxgrasp.Solution]
Cones = Literal["circular", "pyramids", "none"]


def rival(
    name: str,
    package: str,
    method: Method,
    tolerance: float,
    *,
    dtype: str = "float64",
    cones: Cones = "circular",
) -> Rival:
    """Return a rival behind a public function of this package, jitted once and for all."""
    ready = partial(_prepare, solve=jax.jit(method), dtype=dtype, cones=cones)
    return Rival(name, package, "Apache-2.0", ready, tolerance, dtype, cones=cones)


def _prepare(problem: Problems, weights: np.ndarray, solve: Any, dtype: str, cones: Cones) -> Prepared:
    """Put the arrays on the device and compile the function for them; a batch of one has no batch axis."""
    problem = problem.cast(np.dtype(dtype).type)
    arrays = [*(getattr(problem, name) for name in R.ARRAYS), weights.astype(dtype)]
    single = len(weights) == 1
    points, normals, friction, squeeze, wrench, shares = jax.device_put([a[0] if single else a for a in arrays])
    grasp = Grasp(points, normals, friction, squeeze)

    def run() -> jaxgrasp.Solution:
        return jax.block_until_ready(solve(grasp, wrench, shares))

    def read(output: jaxgrasp.Solution) -> Answers:
        solution: Any = jax.device_get(jax.tree.map(lambda x: x[None], output) if single else output)
        claims = [Verdict.OPTIMAL, Verdict.CLOSED_FORM_OPTIMAL]
        # Without cones this is the closed form's honest answer.
        claims += [Verdict.OUTSIDE_CONES] if cones == "none" else []
        hopeless = np.isin(solution.verdict, [Verdict.INFEASIBLE, Verdict.NO_CONTACTS])
        multiplier = solution.multiplier if cones == "circular" else None
        return Answers(solution.forces, multiplier, np.isin(solution.verdict, claims), hopeless)

    run()
    return Prepared(run, read)


def in_both_precisions(name: str, method: Method, cones: Cones) -> list[Rival]:
    """Return one of our own functions as rivals in both precisions."""
    tolerances = {"float64": 1e-8, "float32": 1e-6}
    return [
        rival(f"jaxgrasp {name} {dtype}", "jaxgrasp", method, tolerance, dtype=dtype, cones=cones)
        for dtype, tolerance in tolerances.items()
    ]


RIVALS = in_both_precisions("constrained_optimum", jaxgrasp.constrained_optimum, "circular")
