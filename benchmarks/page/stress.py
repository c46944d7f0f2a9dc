"""Our verdicts on every kind of problem, each judged in extended precision: what claims to be right has to be."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrasp
from benchmarks.laws import any_of, hold, verdict_counts
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P
from jaxgrasp.testing.references import Problems

UNBOUNDED = 1e300
"""Stands for an infinite need, which JSON has no number for."""


class Plan(NamedTuple):
    sizes: tuple[int, ...] = (1, 2, 3, 5, 10, 20)
    number: int = 1_000
    dtypes: tuple[str, ...] = ("float64", "float32")
    kinds: tuple[str, ...] = tuple(P.KINDS)


QUICK = Plan(sizes=(5,), number=32, kinds=("ordinary", "near_collinear", "infeasible"))


@jax.jit
def _solve(grasp: Grasp, wrench: jax.Array, weights: jax.Array) -> jaxgrasp.Solution:
    return jaxgrasp.constrained_optimum(grasp, wrench, weights)


def stress(plan: Plan) -> list[dict]:
    """Return a row for every kind, size, sharing and precision, without sizes that are too small for the kind."""
    rows = []
    for n in plan.sizes:
        for kind in plan.kinds:
            if n < P.LEAST_CONTACTS.get(kind, 1):
                continue
            problem = P.problems(kind, n, plan.number, seed=0)
            rows += [_row(problem, sharing, dtype) for dtype in plan.dtypes for sharing in ("squeeze", "uniform")]
    return rows


def _row(problem: Problems, sharing: str, dtype: str) -> dict:
    problem = problem.cast(np.dtype(dtype).type)
    weights = problem.weights(sharing)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    solution = jax.device_get(_solve(grasp, jnp.asarray(problem.wrench), jnp.asarray(weights)))
    count, contacts = weights.shape
    row = {"kind": problem.kind, "n": contacts, "sharing": sharing, "dtype": dtype, "count": count}
    return row | _claim_counts(problem, weights, solution)


def _claim_counts(problem: Problems, weights: np.ndarray, solution: Any) -> dict:
    verdict = solution.verdict
    held = hold(problem, weights, solution)
    solved, hopeless, judgement = held.solved, held.hopeless, held.judgement
    wrong = any_of(held.broken)
    return {
        "verdicts": verdict_counts(verdict),
        "solved": int(solved.sum()),
        "infeasible": int(hopeless.sum()),
        "not_converged": int((verdict == Verdict.NOT_CONVERGED).sum()),
        "wrong": int(wrong.sum()),
        "granted": int(held.granted.sum()),
        "infeasible_though_made_feasible": int(hopeless.sum()) if problem.feasible is True else 0,
        "solved_though_made_infeasible": int(solved.sum()) if problem.feasible is False else 0,
        "max_gap": _extreme(judgement.gap, solved, np.max),
        "max_backward_error": _extreme(judgement.backward_error, solved, np.max),
        "max_violation": _extreme(judgement.violation, solved, np.max),
        "min_need": _extreme(held.need, hopeless, np.min),
        "wrong_problems": np.flatnonzero(wrong)[:20].tolist(),
    }


def _extreme(values: np.ndarray, where: np.ndarray, choose) -> float | None:
    return float(choose(np.minimum(values[where], UNBOUNDED))) if where.any() else None
