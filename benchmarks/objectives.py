"""Forces by other objectives: what each costs, how close its bound is, and whether an independent solver agrees.

    python -m benchmarks.objectives --out benchmarks/results

Writes objectives.json and objectives.md.
"""

from benchmarks.one_thread import one_thread

one_thread()

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxgrasp
from benchmarks.page import objective_tables
from benchmarks.page.clock import interleaved
from benchmarks.sections import run_sections
from jaxgrasp import OBJECTIVES, Verdict
from jaxgrasp.testing import limited_reference
from jaxgrasp.testing.limited_problems import LimitedProblems, limited_problems

NAME = "objectives"
KINDS = ("ordinary", "near_collinear", "coincident_some", "low_friction", "some_zero_squeeze", "far_frame", "combined")
REFERENCES: dict[str, Callable] = {
    "least_maximal_force": limited_reference.least_maximal_force,
    "least_torque": limited_reference.least_torque,
}
"""Clarabel's, of the objectives that are one cone program."""
NEAR = 1e-9
"""Clarabel's tolerance: at a smaller one it gives up on most."""


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    sizes: tuple[int, ...] = (3, 5)
    joints: int = 6
    batch: int = 128
    repeats: int = 5
    judged: int = 100
    in_turn: int = 16
    """Problems that Clarabel solves for its time."""


def _limited_problems(kind: str, n: int, count: int, plan: Plan) -> LimitedProblems:
    return limited_problems(kind, n, count, 3, soft=True, bounded=True, joints=plan.joints)


def _best(limited: LimitedProblems, objective: Any) -> Callable:
    grasp, wrench, limits = jax.tree.map(jax.numpy.asarray, (limited.grasp, limited.problem.wrench, limited.limits))
    return lambda: jax.block_until_ready(jaxgrasp.best_forces(grasp, wrench, objective, limits=limits))


def times(plan: Plan) -> list[dict]:
    """Measure the seconds a problem of a batch, and of Clarabel's one by one, in turns."""
    rows = []
    for n in plan.sizes:
        limited = _limited_problems("ordinary", n, plan.batch, plan)
        weights = np.ones((plan.batch, n))
        for objective in OBJECTIVES:
            calls = {"ours": _best(limited, objective)}
            if objective in REFERENCES:
                cases = [limited.case(i, weights) for i in range(plan.in_turn)]
                calls["clarabel"] = lambda solve=REFERENCES[objective], cases=cases: [solve(c, NEAR) for c in cases]
            spent = interleaved(calls, plan.repeats, 20.0)
            seconds = {name: spent[name] / (plan.batch if name == "ours" else plan.in_turn) for name in spent}
            rows.append({"n": n, "objective": objective, "seconds": seconds})
    return rows


def right(plan: Plan) -> list[dict]:
    """Compare every kind: problems that ended optimal, the gap of the bounds, and the distance of Clarabel's values."""
    rows = []
    for kind in KINDS:
        limited = _limited_problems(kind, 4, plan.judged, plan)
        rows += [
            {"kind": kind, "objective": objective} | _decision_counts(limited, objective) for objective in OBJECTIVES
        ]
    return rows


def _decision_counts(limited: LimitedProblems, objective: Any) -> dict:
    solution = jax.device_get(_best(limited, objective)())
    optimal = solution.verdict == Verdict.OPTIMAL
    size = np.maximum(solution.value, _nothing(limited, objective))
    near = np.abs(solution.value - solution.bound) / size
    row = {
        "optimal": int(optimal.sum()),
        "not converged": int((solution.verdict == Verdict.NOT_CONVERGED).sum()),
        "infeasible": int((solution.verdict == Verdict.INFEASIBLE).sum()),
        "median_gap": float(np.median(near[optimal])),
        "worst_gap": float(near[optimal].max()),
    }
    if objective not in REFERENCES:
        return row
    weights, off = np.ones_like(limited.problem.squeeze), []
    for i in np.flatnonzero(optimal):
        theirs = REFERENCES[objective](limited.case(i, weights), NEAR)
        if theirs.status == "Solved":
            off.append((solution.value[i] - theirs.objective) / size[i])
    return row | {"compared": len(off), "above": float(max(off)), "below": float(-min(off))}


def _nothing(limited: LimitedProblems, objective: str) -> np.ndarray:
    """Return the value up to which an objective counts as zero, in problems that need no effort."""
    unit = np.linalg.norm(limited.problem.wrench[:, :3], axis=-1)
    if objective == "largest_margin":
        unit = np.ones_like(unit)
    if objective == "least_torque" and limited.torque_map is not None:
        unit = unit * np.abs(limited.torque_map).max((1, 2, 3))
    return 1e-6 * unit


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    quick = Plan(sizes=(4,), batch=8, repeats=1, judged=8, in_turn=2)
    run_sections(__doc__, NAME, {"times": times, "right": right}, (Plan(), quick), objective_tables.page)


if __name__ == "__main__":
    main()
