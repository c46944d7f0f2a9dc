"""What margins of thousands of grasps cost: the least friction, beside the least squeeze.

    python -m benchmarks.least_friction --out benchmarks/results

Writes least_friction.json and least_friction.md. Times are seconds of the processor, since the machine may be shared.
"""

from benchmarks.one_thread import one_thread

one_thread()

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

import jaxgrasp
from benchmarks.page.tables import by_size, made_by
from benchmarks.sections import run_sections
from jaxgrasp import Grasp
from jaxgrasp.testing.problems import problems

NAME = "least_friction"
QUESTIONS: dict[str, Callable[..., Any]] = {
    "least_squeeze": jaxgrasp.least_squeeze,
    "least_friction": jaxgrasp.least_friction,
}


class Plan(NamedTuple):
    """How much of everything."""

    sizes: tuple[int, ...] = (3, 5, 10)
    batch: int = 1000
    repeats: int = 5


def times(plan: Plan) -> list[dict]:
    """Microseconds of the processor for each grasp of a batch, after compiling, the questions in turns."""
    rows = []
    for n in plan.sizes:
        made = problems("ordinary", n, plan.batch, seed=5)
        grasp = jax.tree.map(jax.numpy.asarray, Grasp(made.points, made.normals, made.friction, made.squeeze))
        calls = {
            name: lambda question=question, grasp=grasp, wrench=made.wrench: jax.block_until_ready(
                question(grasp, wrench)
            )
            for name, question in QUESTIONS.items()
        }
        first = {name: _spent(call) for name, call in calls.items()}
        spent = {name: np.median([_spent(call) for _ in range(plan.repeats)]) for name, call in calls.items()}
        rows += [
            {"n": n, "question": f"`{name}`", "microseconds": 1e6 * spent[name] / plan.batch, "first": first[name]}
            for name in calls
        ]
    return rows


def _spent(call: Callable[[], Any]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start


def page(report: dict) -> str:
    plan = report["plan"]
    about = (
        f"Microseconds of the processor for each grasp of a batch of {plan['batch']:,} ordinary ones, after compiling; "
        "in brackets seconds of the first call, which compiles."
    )
    cells = by_size(report["times"], "question", lambda row: f"{row['microseconds']:,.0f} ({row['first']:.0f})", "")
    return (
        "\n\n".join(["# The least friction", f"{made_by(NAME, report['machine'], ('jax',))}; float64.", about, cells])
        + "\n"
    )


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    quick = Plan(sizes=(3,), batch=10, repeats=1)
    run_sections(__doc__, NAME, {"times": times}, (Plan(), quick), page)


if __name__ == "__main__":
    main()
