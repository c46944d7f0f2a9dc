"""The Jacobian of method B's constrained forces by the squeezing forces, by our derivatives and by others."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from benchmarks.page.clock import interleaved
from benchmarks.page.extras import forward, on_device, reverse
from benchmarks.page.times import needs_cones, ordinary
from benchmarks.rivals.interface import Differentiator
from benchmarks.rivals.registry import load
from jaxgrasp.testing import references as R
from jaxgrasp.testing.problem_data import Problems

MODULES = {"by_diffcp": ("diffcp",), "by_cvxpylayers": ("cvxpy", "cvxpylayers")}
"""Files of differentiators, and the imports that each needs."""
STEP = 1e-4
"""Relative step of the central differences: their own error is about its square."""


class Plan(NamedTuple):
    contacts: int = 5
    number: int = 20
    repeats: int = 5
    budget: float = 10.0


QUICK = Plan(number=4, repeats=3, budget=1.0)


def _ours(name: str, differentiate: Callable) -> Differentiator:
    def prepare(problem: Problems) -> Callable[[], np.ndarray]:
        grasp, wrench = on_device(problem)
        return lambda: np.asarray(jax.block_until_ready(differentiate(grasp, wrench)))

    return Differentiator(name, "jaxgrasp", "Apache-2.0", prepare)


def available() -> tuple[list[Differentiator], list[str]]:
    found = [load(module, needs, "DIFFERENTIATORS") for module, needs in MODULES.items()]
    others = [one for part in found if not isinstance(part, str) for one in part]
    own = [_ours("jaxgrasp jacfwd", forward), _ours("jaxgrasp jacrev", reverse)]
    return [*own, *others], [part for part in found if isinstance(part, str)]


def gradients(differentiators: list[Differentiator], plan: Plan) -> list[dict]:
    """Time and error of each; the error is the distance to central differences of Clarabel's forces."""
    problem = ordinary(plan.contacts, plan.number)
    active = needs_cones(problem, problem.squeeze)
    ready = {one.name: one.prepare(problem) for one in differentiators}
    spent = interleaved(ready, plan.repeats, plan.budget)
    expected = central_differences(problem)
    exact = ready["jaxgrasp jacfwd"]()
    rows = []
    for one in differentiators:
        found = ready[one.name]()
        rows.append(
            {
                "method": one.name,
                "package": one.package,
                "licence": one.licence,
                "n": plan.contacts,
                "count": plan.number,
                "active": int(active.sum()),
                "microseconds": spent[one.name] / plan.number * 1e6,
                "median_difference_from_finite": float(np.median(apart(found, expected))),
                "max_difference_from_finite": float(apart(found, expected).max()),
                "median_difference_from_jacfwd": float(np.median(apart(found, exact))),
                "max_difference_from_jacfwd": float(apart(found, exact).max()),
            }
        )
    return rows


def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Largest difference of each problem's Jacobian, relative to its largest entry."""
    return np.abs(one - other).max((1, 2, 3)) / np.abs(other).max((1, 2, 3))


def central_differences(problem: Problems) -> np.ndarray:
    """The Jacobian ``(B, n, 3, n)`` by an independent solver; rough where a cone becomes active within the step."""
    columns = []
    for j in range(problem.squeeze.shape[1]):
        step = STEP * problem.squeeze[:, j]
        ends = []
        for sign in (1, -1):
            squeeze = problem.squeeze.copy()
            squeeze[:, j] += sign * step
            moved = problem._replace(squeeze=squeeze)
            ends.append(np.stack([R.clarabel_optimum(moved, squeeze, i)[0] for i in range(len(step))]))
        columns.append((ends[0] - ends[1]) / (2 * step)[:, None, None])
    return np.stack(columns, -1)
