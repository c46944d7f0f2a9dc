"""Batches as sampling makes them, many of whose grasps cannot hold: their cost beside ordinary batches and Clarabel.

    python -m benchmarks.mixed --out benchmarks/results

Writes mixed.json and mixed.md.
"""

from benchmarks.one_thread import one_thread

one_thread()

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrasp
from benchmarks.page import mixed_tables
from benchmarks.page.clock import interleaved
from benchmarks.rivals.by_clarabel import RIVALS
from benchmarks.sampled_grasps import FAMILIES, sampled
from benchmarks.sections import run_sections
from jaxgrasp import Grasp, Solution, Verdict
from jaxgrasp.testing.problems import problems
from jaxgrasp.testing.references import Problems

NAME = "mixed"
LOOSE = 1e-8
"""What Clarabel is asked for."""


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    sizes: tuple[int, ...] = (3, 5, 10, 20)
    batch: int = 4000
    """Of the sweep."""
    batches: tuple[int, ...] = (1_000, 100_000)
    """Of the families."""
    judged: int = 200
    """Problems that Clarabel gets."""
    repeats: int = 9
    shares: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)


def _call(problem: Problems):
    arguments = jax.tree.map(jnp.asarray, (Grasp(*problem[1:5]), problem.wrench))
    program = jax.jit(jaxgrasp.constrained_optimum)
    return lambda: jax.block_until_ready(program(*arguments))


def _rows(problem: Problems, rows: np.ndarray) -> Problems:
    return problem._replace(**{name: getattr(problem, name)[rows] for name in Problems._fields[1:6]})


def families(plan: Plan) -> list[dict]:
    """Measure each family beside the ordinary batch and Clarabel, and compare verdicts."""
    rows = []
    for n in plan.sizes:
        for batch in plan.batches:
            ordinary = _call(problems("ordinary", n, batch, seed=5))
            rows += [_beside(draw(n, batch), ordinary, plan) for draw in FAMILIES.values()]
    return rows


def _beside(problem: Problems, ordinary, plan: Plan) -> dict:
    batch, n = problem.points.shape[:2]
    few = _rows(problem, np.arange(plan.judged))
    clarabel = {
        name: rival.prepare(few, few.weights("squeeze"))
        for rival in RIVALS
        if rival.tolerance == LOOSE
        for name in [rival.name.split()[1]]
    }
    ours = _call(problem)
    solution: Solution = jax.device_get(ours())
    theirs = clarabel["anew"].read(clarabel["anew"].run())
    calls = {"ours": ours, "ordinary": ordinary} | {name: prepared.run for name, prepared in clarabel.items()}
    spent = interleaved(calls, plan.repeats, 10.0)
    verdict = solution.verdict[: plan.judged]
    solved, infeasible = verdict <= Verdict.OPTIMAL, verdict == Verdict.INFEASIBLE
    return {
        "n": n,
        "batch": batch,
        "load": problem.kind,
        "infeasible": float(np.mean(solution.verdict == Verdict.INFEASIBLE)),
        "undecided": int(np.sum(solution.verdict == Verdict.NOT_CONVERGED)),
        "differ": int(np.sum((theirs.solved & infeasible) | (theirs.infeasible & solved))),
        "microseconds": {
            name: 1e6 * seconds / (batch if name in ("ours", "ordinary") else plan.judged)
            for name, seconds in spent.items()
        },
    }


def sweep(plan: Plan) -> list[dict]:
    """Measure lifts of which a given share is infeasible, beside the ordinary batch."""
    rows = []
    for n in plan.sizes:
        pool = sampled(n, plan.batch, lift=True)
        verdict = np.asarray(_call(pool)().verdict)
        kinds = np.flatnonzero(verdict <= Verdict.OPTIMAL), np.flatnonzero(verdict == Verdict.INFEASIBLE)
        if not all(map(len, kinds)):
            continue
        calls = {"ordinary": _call(problems("ordinary", n, plan.batch, seed=5))}
        for share in plan.shares:
            bad = round(share * plan.batch)
            chosen = np.concatenate([np.resize(kinds[0], plan.batch - bad), np.resize(kinds[1], bad)])
            calls[share] = _call(_rows(pool, np.random.default_rng(n).permutation(chosen)))
        spent = interleaved(calls, plan.repeats, 10.0)
        rows += [
            {
                "n": n,
                "share": share,
                "ratio": spent[share] / spent["ordinary"],
                "microseconds": 1e6 * spent[share] / plan.batch,
            }
            for share in plan.shares
        ]
    return rows


SECTIONS = {"families": families, "sweep": sweep}
QUICK = Plan(sizes=(3,), batch=200, batches=(100,), judged=20, repeats=2, shares=(0.0, 1.0))


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    run_sections(__doc__, NAME, SECTIONS, (Plan(), QUICK), mixed_tables.page)


if __name__ == "__main__":
    main()
