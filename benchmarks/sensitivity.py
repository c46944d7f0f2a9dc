"""Sensitivity along the paper's task: time and error of derivatives, starts from the instant before, and a sweep.

    python -m benchmarks.sensitivity --out benchmarks/results

Writes sensitivity.json and sensitivity.md. The derivatives' rival are central differences, batched into one compiled
call; their error is judged by central differences of sixth order. Optima one after the other, as in a loop that
renders forces, start from the closed form or from the last multiplier. The sweep draws placements, friction and
contributions about those of the paper's task: how often is method B worse than A? The designs raise the task's worst
margin, by method B and by what friction there is in reserve.
"""

from benchmarks.one_thread import one_thread

one_thread()

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxgrasp
from benchmarks.machine import machine
from benchmarks.page import sensitivity_tables
from benchmarks.page.clock import interleaved
from jaxgrasp import Verdict
from jaxgrasp.grip import HeldCylinder, Task, carrying
from jaxgrasp.sensitivity import Output, cylinder_task, friction_reserve, raise_worst, sensitivity_trajectory
from jaxgrasp.sensitivity.naming import with_values

NAME = "sensitivity"
BY = ("contributions", "friction", "depths")
METHODS = ("A", "B", "A-optimum", "B-optimum")
SECONDS = 4.0
STEP = 1e-6
"""Of the rival's central differences, relative to the parameter."""
SIXTH_ORDER = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
REFERENCE_STEPS = (1e-3, 2e-4, 4e-5)
"""Of the differences of sixth order; of the three the closest counts, since a kink may lie within the longer."""


class Plan(NamedTuple):
    times: int = 1000
    repeats: int = 9
    settings: int = 1000
    instants: int = 80
    steps: tuple[float, ...] = (1e-3, 1e-2)
    """Between consecutive optima [s]."""
    designed: int = 40
    """Instants that a design looks at."""


QUICK = Plan(times=20, repeats=3, settings=10, instants=8, steps=(0.1,), designed=8)


def derivatives(method: str, plan: Plan) -> dict:
    """Measure the milliseconds of the trajectory and of central differences, and the error of both."""
    task, output = cylinder_task(), Output("slip_angle", method)
    # Off the instants at which a finger comes to its cone, where a derivative has two sides.
    times = np.linspace(0.0013, SECONDS - 0.0017, plan.times)
    sensitivity = sensitivity_trajectory(task, times, output, BY)
    curves = along(task, times, output, sensitivity.matrix.parameters)
    parameters = sensitivity.matrix.values
    by_differences = jax.jit(lambda x: (curves(x), central(curves, x, STEP * jnp.abs(x), {1: 0.5})))
    calls = {
        "ours": lambda: jax.block_until_ready(sensitivity_trajectory(task, times, output, BY).matrix.derivatives),
        "central": lambda: jax.block_until_ready(by_differences(parameters)),
        "curves": lambda: jax.block_until_ready(curves(parameters)),
    }
    spent = interleaved(calls, plan.repeats, 20.0)
    references = [central(curves, parameters, h * jnp.abs(parameters), SIXTH_ORDER) for h in REFERENCE_STEPS]
    loaded = np.isfinite(sensitivity.matrix.nominal)
    return {
        "method": method,
        "times": plan.times,
        "parameters": len(sensitivity.matrix.parameters),
        "milliseconds": {name: 1e3 * seconds for name, seconds in spent.items()},
        "error": error(sensitivity.matrix.derivatives, references, loaded),
        "central_error": error(by_differences(parameters)[1], references, loaded),
    }


def along(task: Task, times: np.ndarray, output: Output, entries: Any) -> Callable[[jax.Array], jax.Array]:
    """Return the slip angles ``(T, n)`` as a function of the parameters' values."""

    @jax.jit
    def curves(values: jax.Array) -> jax.Array:
        changed_task = Task(with_values(task.parameters, entries, values), task.at)
        return output(*jax.vmap(changed_task)(jnp.asarray(times)))["slip_angle"]

    return curves


def central(curves: Callable, center: jax.Array, steps: jax.Array, weights: dict[int, float]) -> jax.Array:
    """Compute central differences ``(T, n, P)``, all parameters in one batch."""
    batched_curves = jax.vmap(curves)
    sides = [
        c * (batched_curves(center + m * jnp.diag(steps)) - batched_curves(center - m * jnp.diag(steps)))
        for m, c in weights.items()
    ]
    return jnp.moveaxis(sum(sides[1:], sides[0]) / steps[:, None, None], 0, -1)


def error(derivatives: jax.Array, references: list[jax.Array], loaded: np.ndarray) -> dict[str, float]:
    """Return the largest error and the 99.9 % quantile: distance from the closest reference over 1 + |derivative|."""
    scale = 1 + np.abs(np.asarray(references[-1]))
    errors = np.stack([np.abs(np.asarray(derivatives - reference)) / scale for reference in references])
    # A finger that lets go within a step has no slip angle there, and that difference no value.
    errors = np.where(np.isnan(errors), np.inf, errors).min(0)
    errors = errors[loaded]
    return {"largest": float(errors.max()), "of_all_but_a_thousandth": float(np.quantile(errors, 0.999))}


def consecutive(step: float, plan: Plan) -> dict:
    """Measure microseconds and Newton steps of an optimum with active cones, from either start and in one batch."""
    grasp, wrench = jax.vmap(cylinder_task())(jnp.arange(0.0013, SECONDS, step))

    def after(last: jax.Array, problem: Any) -> tuple[jax.Array, jaxgrasp.Solution]:
        solution = jaxgrasp.constrained_optimum(*problem, start=last)
        return solution.multiplier, solution

    calls = {
        "from_the_closed_form": jax.jit(
            lambda: jax.lax.map(lambda p: jaxgrasp.constrained_optimum(*p), (grasp, wrench))
        ),
        "from_the_last": jax.jit(lambda: jax.lax.scan(after, jnp.zeros(6), (grasp, wrench))[1]),
        "in_one_batch": jax.jit(lambda: jaxgrasp.constrained_optimum(grasp, wrench)),
    }
    solutions = {name: jax.device_get(call()) for name, call in calls.items()}
    spent = interleaved({name: lambda c=c: jax.block_until_ready(c()) for name, c in calls.items()}, plan.repeats, 20.0)
    active = solutions["in_one_batch"].verdict == Verdict.OPTIMAL
    forces = solutions["in_one_batch"].forces
    return {
        "step": step,
        "optima": len(active),
        "active": float(active.mean()),
        "microseconds": {name: 1e6 * seconds / len(active) for name, seconds in spent.items()},
        "newton_steps": {name: float(solution.steps[active].mean()) for name, solution in solutions.items()},
        "apart": float(np.abs(solutions["from_the_last"].forces - forces).max() / np.abs(forces).max()),
    }


def designs(plan: Plan) -> list[dict]:
    """Compare the task's worst margin before and after its design, at ten times as many instants as the design used."""
    task, by_b = cylinder_task(), Output("friction_margin", "B")
    held = task.parameters.held
    contact_bounds = {
        "azimuths": (held.azimuths - 0.6, held.azimuths + 0.6),
        "heights": (held.heights - 0.008, held.heights + 0.008),
    }
    shares = {"contributions": (0.05, 4.0)}
    design_times, check_times = (
        (np.arange(count) + 0.5) * SECONDS / count for count in (plan.designed, 10 * plan.designed)
    )
    rows = []
    for margin, name, within in (
        (by_b, "friction margin by B", shares),
        (by_b, "friction margin by B", contact_bounds),
        (by_b, "friction margin by B", {**contact_bounds, **shares}),
        (friction_reserve, "reserve of friction", contact_bounds),
    ):
        start_s = time.perf_counter()
        design = raise_worst(task, design_times, margin, within, totals=[name for name in shares if name in within])
        spent = time.perf_counter() - start_s
        worst = jax.jit(lambda task, margin=margin: jnp.min(jax.tree.leaves(margin(*jax.vmap(task)(check_times)))[0]))
        rows.append(
            {
                "margin": name,
                "moved": list(within),
                "before": float(worst(task)),
                "after": float(worst(design.task)),
                "seconds": spent,
                "moves": design.moves,
            }
        )
    return rows


def drawn(count: int, seed: int = 0) -> HeldCylinder:
    """Draw ``count`` held cylinders about the paper's, with a leading axis."""
    rng = np.random.default_rng(seed)
    held = cylinder_task().parameters.held
    fingers = rng.uniform(0.5, 1.5, (count, 4))
    fingers[:, 0] *= rng.uniform(0.02, 1, count)
    thumb = fingers.sum(1, keepdims=True) * rng.uniform(0.8, 1.2, (count, 1))
    values = {
        "azimuths": held.azimuths + rng.normal(scale=0.2, size=(count, 5)),
        "heights": held.heights + rng.normal(scale=0.005, size=(count, 5)),
        "friction": np.repeat(rng.uniform(0.3, 0.9, (count, 1)), 5, 1),
        "contributions": np.concatenate([thumb, fingers], 1),
        "depths": np.repeat(rng.uniform(1.5e-3, 5e-3, (count, 1)), 5, 1),
    }
    repeated = jax.tree.map(lambda x: np.broadcast_to(x, (count, *np.shape(x))), held)
    return HeldCylinder(**{**vars(repeated), **values})


def sweep(plan: Plan) -> dict:
    """Compute the slip angles by A, by B and by B's optimum over a cycle of each drawn task."""
    paper = cylinder_task().parameters
    times = (jnp.arange(plan.instants) + 0.5) * SECONDS / plan.instants
    all_instants = jax.vmap(lambda held: jax.vmap(carrying(held, paper.path, paper.gravity))(times))
    grasp, wrench = all_instants(drawn(plan.settings))
    slips, solutions = {}, {}
    for method, solve, sharing in (
        ("A", jaxgrasp.closed_form, "uniform"),
        ("B", jaxgrasp.closed_form, "squeeze"),
        ("B-optimum", jaxgrasp.constrained_optimum, "squeeze"),
    ):
        solutions[method] = jax.device_get(solve(grasp, wrench, sharing))
        slips[method] = np.degrees(jaxgrasp.slip_angle(grasp, solutions[method].forces))
    closed, optimum = solutions["B"], solutions["B-optimum"]
    held = np.asarray(optimum.verdict) <= Verdict.OPTIMAL
    push = np.linalg.norm(closed.forces, axis=-1).max(-1)
    distances = np.linalg.norm(optimum.forces - closed.forces, axis=-1).max(-1) / push
    active = np.asarray(optimum.verdict) == Verdict.OPTIMAL
    price = (optimum.objective - closed.objective)[active] / optimum.objective[active]
    index = {method: angles[..., 1] for method, angles in slips.items()}
    worst = {method: angles.max((1, 2)) for method, angles in slips.items()}
    return {
        "settings": plan.settings,
        "instants": plan.instants,
        "worst_of_the_index": worse(index["B"].max(1), index["A"].max(1)),
        "worst_of_all": worse(worst["B"], worst["A"]),
        "index_at_an_instant": worse(index["B"].ravel(), index["A"].ravel()),
        "largest_at_an_instant": worse(slips["B"].max(-1).ravel(), slips["A"].max(-1).ravel()),
        "settings_in_which_it_pulls": {
            m: float((angles > 90).mean()) for m, angles in worst.items() if m != "B-optimum"
        },
        "instants_outside_the_cones": {
            m: float(np.mean(solutions[m].verdict == Verdict.OUTSIDE_CONES)) for m in ("A", "B")
        },
        "instants_that_forces_exist_for": float(held.mean()),
        "instants_with_active_cones": float(active.mean()),
        "distance_where_active": {q: float(np.quantile(distances[active], float(q))) for q in ("0.5", "0.9", "1.0")},
        "price_where_active": {q: float(np.quantile(price, float(q))) for q in ("0.5", "0.9", "1.0")},
    }


def worse(b: np.ndarray, a: np.ndarray) -> dict[str, float]:
    """Return how often B's slip angle is larger than A's, and by how much then [degrees]."""
    more = (b - a)[b > a + 1e-9]
    if not more.size:
        return {"share": 0.0, "median": 0.0, "largest": 0.0}
    return {"share": len(more) / len(a), "median": float(np.median(more)), "largest": float(more.max())}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the two files")
    parser.add_argument("--quick", action="store_true", help="a few of everything: a test, not a measurement")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    plan = QUICK if options.quick else Plan()
    report = {
        "machine": machine(),
        "plan": plan._asdict(),
        "derivatives": [derivatives(method, plan) for method in METHODS],
        "consecutive": [consecutive(step, plan) for step in plan.steps],
        "designs": designs(plan),
        "sweep": sweep(plan),
    }
    (options.out / f"{NAME}.json").write_text(json.dumps(report, indent=1) + "\n")
    (options.out / f"{NAME}.md").write_text(sensitivity_tables.page(report))


if __name__ == "__main__":
    main()
