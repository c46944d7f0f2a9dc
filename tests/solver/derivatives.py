"""Problems whose derivatives are computed in several ways, the derivatives by the rule in JAX, and their comparison."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import derivative
from jaxgrasp.solver.in_kernel import MOVED, MOVING
from jaxgrasp.testing.problems import problems
from tests.kernel.conftest import problem_of

N, COUNT = 4, 100


def drawn_problem(kind: str, n: int, is_soft: bool, is_bounded: bool, dtype=np.float64) -> ProblemBatch:
    """Draw problems, some contacts of which are absent where there are soft fingers."""
    rng, problem = np.random.default_rng(7), problems(kind, n, COUNT, seed=41)
    names, shape = ("points", "normals", "friction", "squeeze", "wrench"), problem.friction.shape
    arrays = {name: getattr(problem, name) for name in names}
    if is_soft:
        arrays["torsion"] = rng.uniform(0, 0.02, shape) * (rng.uniform(size=shape) < 0.8)
        arrays["present"] = (rng.uniform(size=shape) < 0.9).astype(float)
    if is_bounded:
        arrays["normal_min"] = rng.uniform(0.01, 0.5, shape) * problem.squeeze
        most = arrays["normal_min"] + rng.uniform(0.5, 6, shape) * problem.squeeze.mean(-1, keepdims=True)
        arrays["normal_max"] = np.where(rng.uniform(size=shape) < 0.3, np.inf, most)
    return jax.tree.map(jnp.asarray, problem_of({name: np.asarray(x, dtype) for name, x in arrays.items()}))


def pulled_back(problem: ProblemBatch, solution, cotangents: list, constrained: bool, tangent_of=derivative.tangent):
    """Return the derivatives by the transpose of ``tangent_of``, by default the rule in JAX, and where any exist."""
    zeros = jax.tree.map(jnp.zeros_like, problem)
    fields = {name: getattr(zeros, name) for name in MOVING if getattr(problem, name) is not None}

    def tangent(moved):
        parts = tangent_of(problem, replace(zeros, **moved), solution, constrained)
        return [getattr(parts, name) for name in MOVED if getattr(solution, name) is not None], ~parts.undefined

    _, pull, has_derivatives = jax.vjp(tangent, fields, has_aux=True)
    return pull(cotangents)[0], has_derivatives


CASES = [
    ("ordinary", 9, False, False, True),
    ("ordinary", N, True, True, True),
    ("ordinary", N, True, True, False),
    ("ordinary", N, False, True, True),
    ("some_zero_squeeze", N, False, False, True),
    ("coincident_all", N, False, False, True),
    ("zero_friction", N, False, False, True),
    ("infeasible", N, False, False, True),
]
"""Kind of problem, number of contacts, whether fingers are soft, forces bounded, and cones imposed."""


def assert_derivatives_agree(by_field: dict, expected: dict, dtype) -> None:
    """Assert that derivatives by each field agree, relative to the largest of each problem."""
    assert by_field.keys() == expected.keys()
    for name, value in by_field.items():
        other = np.asarray(expected[name])
        axes = tuple(range(1, other.ndim))
        largest = np.abs(other).max(axes)
        scale = np.maximum(largest, 1e-9 * largest.max())
        error = np.abs(value - other).max(axes)
        if dtype == np.float64:
            assert np.all(error <= 1e-9 * scale), name
        else:
            assert np.mean(error <= 1e-2 * scale) >= 0.95, name
