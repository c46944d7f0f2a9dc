"""Cost of margins of thousands of grasps: the least squeeze and friction, and the margin along a wrench.

    python -m benchmarks.margins --out benchmarks/results

Writes margins.json and margins.md. Times are seconds of the processor, since the machine may be shared.
"""

from benchmarks.one_thread import one_thread

one_thread()

import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from benchmarks.page.tables import by_size, made_by
from benchmarks.sections import run_sections
from jaxgrasp import Grasp, Limits, least_friction, least_squeeze, wrench_margin
from jaxgrasp.testing.problems import problems

NAME = "margins"
GRAVITY = np.array([0, 0, -1.0, 0, 0, 0])
LIMIT = 10.0
"""Of each normal force, in units of its squeezing force."""


def _limited_margin(grasp: Grasp, wrench: Array) -> Array:
    return wrench_margin(grasp, wrench, wrench, limits=Limits(normal_max=LIMIT * grasp.squeeze))


QUESTIONS: dict[str, Callable[[Grasp, Array], Array]] = {
    "`least_squeeze`": least_squeeze,
    "`least_friction`": least_friction,
    "`wrench_margin` downwards": lambda grasp, wrench: wrench_margin(grasp, wrench, GRAVITY),
    "`wrench_margin` along the load, `normal_max` given": _limited_margin,
}


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    sizes: tuple[int, ...] = (3, 5, 10)
    batch: int = 1000
    repeats: int = 5


def times(plan: Plan) -> list[dict]:
    """Measure the microseconds of the processor for each grasp of a batch, after compiling, the questions in turns."""
    rows = []
    for n in plan.sizes:
        drawn = problems("ordinary", n, plan.batch, seed=5)
        grasp = jax.tree.map(jax.numpy.asarray, Grasp(drawn.points, drawn.normals, drawn.friction, drawn.squeeze))
        wrench = jax.numpy.asarray(drawn.wrench)
        first = {name: _timed(ask, grasp, wrench) for name, ask in QUESTIONS.items()}
        rounds = [{name: _timed(ask, grasp, wrench)[0] for name, ask in QUESTIONS.items()} for _ in range(plan.repeats)]
        rows += [
            {
                "n": n,
                "question": name,
                "microseconds": 1e6 * np.median([round_times[name] for round_times in rounds]) / plan.batch,
                "first": compiling,
                "finite": float(np.isfinite(answer).mean()),
            }
            for name, (compiling, answer) in first.items()
        ]
    return rows


def _timed(question: Callable[[Grasp, Array], Array], grasp: Grasp, wrench: Array) -> tuple[float, Array]:
    """Return the seconds of the processor, and the answer."""
    start = time.process_time()
    answer = jax.block_until_ready(question(grasp, wrench))
    return time.process_time() - start, answer


def page(report: dict) -> str:
    plan = report["plan"]
    about = (
        f"Microseconds of the processor for each grasp of a batch of {plan['batch']:,} ordinary ones, after compiling; "
        "in brackets seconds of the first call, which compiles, and how many answers are finite. Where normal forces "
        f"are limited, then to {LIMIT:.0f} times their squeezing force."
    )
    cells = by_size(report["times"], "question", _cell, "")
    return "\n\n".join(["# Margins", f"{made_by(NAME, report['machine'], ('jax',))}; float64.", about, cells]) + "\n"


def _cell(row: dict) -> str:
    return f"{row['microseconds']:,.0f} ({row['first']:.0f} s; {row['finite']:.0%})"


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    quick = Plan(sizes=(3,), batch=10, repeats=1)
    run_sections(__doc__, NAME, {"times": times}, (Plan(), quick), page)


if __name__ == "__main__":
    main()
