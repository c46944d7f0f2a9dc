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
from jaxgrasp.testing.references import Problems

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
    modules = [load(module, needs, "DIFFERENTIATORS") for module, needs in MODULES.items()]
    others = [differentiator for part in modules if not isinstance(part, str) for differentiator in part]
    ours = [_ours("jaxgrasp jacfwd", forward), _ours("jaxgrasp jacrev", reverse)]
    return [*ours, *others], [part for part in modules if isinstance(part, str)]


def gradients(differentiators: list[Differentiator], plan: Plan) -> list[dict]:
    """Time and error of each; the error is the distance to central differences of Clarabel's forces."""
    problem = ordinary(plan.contacts, plan.number)
    active = needs_cones(problem, problem.squeeze)
    ready = {differentiator.name: differentiator.prepare(problem) for differentiator in differentiators}
    spent = interleaved(ready, plan.repeats, plan.budget)
    expected = central_differences(problem)
    exact = ready["jaxgrasp jacfwd"]()
    rows = []
    for differentiator in differentiators:
        jacobians = ready[differentiator.name]()
        rows.append(
            {
                "method": differentiator.name,
                "package": differentiator.package,
                "licence": differentiator.licence,
                "n": plan.contacts,
                "count": plan.number,
                "active": int(active.sum()),
                "microseconds": spent[differentiator.name] / plan.number * 1e6,
                "median_difference_from_finite": float(np.median(relative_distance(jacobians, expected))),
                "max_difference_from_finite": float(relative_distance(jacobians, expected).max()),
                "median_difference_from_jacfwd": float(np.median(relative_distance(jacobians, exact))),
                "max_difference_from_jacfwd": float(relative_distance(jacobians, exact).max()),
            }
        )
    return rows


def relative_distance(jacobians: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the largest difference of each problem's Jacobian, relative to its largest entry."""
    return np.abs(jacobians - expected).max((1, 2, 3)) / np.abs(expected).max((1, 2, 3))


def central_differences(problem: Problems) -> np.ndarray:
    """Return the Jacobian ``(B, n, 3, n)`` by another solver, rough where a cone becomes active within the step."""
    columns = []
    for j in range(problem.squeeze.shape[1]):
        step = STEP * problem.squeeze[:, j]
        ends = []
        for sign in (1, -1):
            squeeze = problem.squeeze.copy()
            squeeze[:, j] += sign * step
            changed = problem._replace(squeeze=squeeze)
            ends.append(np.stack([R.clarabel_optimum(changed, squeeze, i)[0] for i in range(len(step))]))
        columns.append((ends[0] - ends[1]) / (2 * step)[:, None, None])
    return np.stack(columns, -1)
