"""The force-distribution methods that the paper names against its closed forms and optima, on the same problems.

    python -m benchmarks.literature --out benchmarks/results

Ordinary problems of 3, 5 and 10 contacts, and the paper's rotating cylinder instant by instant. Writes literature.json,
literature.md and literature.png.
"""

from benchmarks.one_thread import one_thread

one_thread()

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from benchmarks.machine import machine
from benchmarks.page import literature_plot, literature_tables
from benchmarks.page.clock import interleaved
from jaxgrasp import Grasp, Limits, Verdict, closed_form, constrained_optimum, friction_margin
from jaxgrasp.literature import LITERATURE_METHODS, MethodStatus, kuhn_tucker
from jaxgrasp.literature.linear import LinearProgram, sizes_of, solve_compact_dual, solve_plain
from jaxgrasp.literature.method_input import read_input
from jaxgrasp.literature.orin_oh import load_program
from jaxgrasp.literature.scaled_problems import host_problem, scale
from jaxgrasp.sensitivity import cylinder_task
from jaxgrasp.testing import references as R
from jaxgrasp.testing.problems import problems
from jaxgrasp.testing.references import Problems

NAME = "literature"
SEED, SIZES, SIDES = 0, (3, 5, 10), 8
BOUND = 3.0
"""Largest normal force allowed, in units of the largest that the optimum by method A needs."""
OUTSIDE = 1e-6
"""Relative distance from its cone at which a force counts as outside, and relative size at which it counts at all."""
SECONDS, STEP = 4.0, 0.02
"""Of the cylinder's task: one turn there and back, and an instant."""


class Answers(NamedTuple):
    """Forces of a batch, whether there are any, and what the method itself says."""

    forces: np.ndarray
    has_forces: np.ndarray
    words: list[str]


class Case(NamedTuple):
    """A batch of problems, and the bound of its normal forces."""

    name: str
    problem: Problems
    limits: Limits
    in_order: bool
    """Whether the problems are instants of one task."""


def grasp_of(problem: Problems) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)


def bounded(name: str, problem: Problems, in_order: bool) -> Case:
    forces = np.asarray(constrained_optimum(grasp_of(problem), problem.wrench, "uniform").forces)
    pressed = np.sum(forces * problem.normals, -1).max(-1, keepdims=True)
    pressed = np.full_like(pressed, pressed.max()) if in_order else pressed
    return Case(name, problem, Limits(normal_max=np.broadcast_to(BOUND * pressed, problem.friction.shape)), in_order)


def ordinary(n: int, count: int) -> Case:
    return bounded(f"ordinary, n = {n}", problems("ordinary", n, count, SEED), False)


def cylinder(step: float) -> Case:
    grasp, wrench = jax.vmap(cylinder_task())(np.arange(0, SECONDS, step))
    arrays = (grasp.points, grasp.normals, grasp.friction, grasp.squeeze, wrench)
    return bounded("rotating cylinder, n = 5", Problems("cylinder", *map(np.asarray, arrays), feasible=True), True)


def calls(case: Case) -> dict[str, Callable]:
    """Return every method as a call without arguments, by its title."""
    grasp, wrench = grasp_of(case.problem), case.problem.wrench
    ours = {
        "method A, closed form": partial(closed_form, grasp, wrench, "uniform"),
        "method B, closed form": partial(closed_form, grasp, wrench, "squeeze"),
        "method A, optimum": partial(constrained_optimum, grasp, wrench, "uniform"),
        "method B, optimum": partial(constrained_optimum, grasp, wrench, "squeeze"),
    }
    theirs = {}
    for method in LITERATURE_METHODS.values():
        options = {"sides": SIDES} if method.friction == "pyramids" else {}
        theirs[method.title] = partial(method, grasp, wrench, case.limits, **options)
    name = LITERATURE_METHODS["kuhn_tucker"].title
    theirs[f"{name}, F_3"] = theirs.pop(name)
    theirs[f"{name}, F_2"] = partial(kuhn_tucker, grasp, wrench, sharing="uniform", sides=SIDES)
    return {title: partial(_finished, call) for title, call in (ours | theirs).items()}


def _finished(call: Callable):
    return jax.block_until_ready(call())


def read_answers(output) -> Answers:
    forces = np.asarray(output.forces)
    if hasattr(output, "verdict"):
        verdicts = [Verdict(int(v)) for v in output.verdict]
        has_forces = np.array([v.solved or v == Verdict.OUTSIDE_CONES for v in verdicts])
        return Answers(forces, has_forces, [v.name for v in verdicts])
    statuses = [MethodStatus(int(s)) for s in output.status]
    has_forces = np.array([s in (MethodStatus.SOLVED, MethodStatus.OUTSIDE_CONES) for s in statuses])
    return Answers(forces, has_forces, [s.name for s in statuses])


def rate_answers(case: Case, answers: Answers, least: dict[str, np.ndarray]) -> dict:
    """Rate a method's forces, over the problems for which it has any."""
    problem, has_forces = case.problem, answers.has_forces
    centred = R.centred(problem, np.ones_like(problem.squeeze))
    size = R.norm(answers.forces)
    largest = np.maximum(size.max(-1), problem.squeeze.max(-1))
    off = R.norm(answers.forces - R.project(np.asarray(answers.forces, R.Wide), centred.normals, centred.friction)).max(
        -1
    )
    violation = off / largest
    # A force of a few roundings points anywhere.
    pressing = np.where((size > OUTSIDE * largest[:, None])[..., None], answers.forces, 0)
    margins = np.degrees(np.min(friction_margin(grasp_of(problem), pressing), -1))
    loaded = has_forces & np.isfinite(margins)
    excess = {
        sharing: (objective(problem, answers.forces, sharing) - best) / scale_of(problem, best, sharing)
        for sharing, best in least.items()
    }
    counts = {word: answers.words.count(word) for word in dict.fromkeys(answers.words)}
    return {
        "statuses": counts,
        "given": int(has_forces.sum()),
        "outside_cones": int((has_forces & (violation > OUTSIDE)).sum()),
        "largest_violation": _largest(violation[has_forces]),
        "largest_residual": _largest(R.backward_error(centred, answers.forces)[has_forces]),
        "excess_f2_median": _median(excess["uniform"][has_forces]),
        "excess_f3_median": _median(excess["squeeze"][has_forces]),
        "margin_degrees_median": _median(margins[loaded]),
        "margin_degrees_least": _largest(-margins[loaded], -1.0),
        "normal_force_median": _median(np.sum(answers.forces * problem.normals, (1, 2))[has_forces]),
        **(smoothness(answers) if case.in_order else {}),
    }


def objective(problem: Problems, forces: np.ndarray, sharing: str) -> np.ndarray:
    distances = np.sum((forces - problem.squeeze[..., None] * problem.normals) ** 2, -1)
    return np.sum(distances / (2 * problem.weights(sharing)), -1)


def scale_of(problem: Problems, best: np.ndarray, sharing: str) -> np.ndarray:
    """Return the larger of the optimum's cost and the cost of no force at all."""
    return np.maximum(best, np.sum(problem.squeeze**2 / (2 * problem.weights(sharing)), -1))


def smoothness(answers: Answers) -> dict:
    """Measure jumps of a contact's force between instants, and second differences [N], where all ends are known."""
    first, both_known = np.diff(answers.forces, axis=0), answers.has_forces[1:] & answers.has_forces[:-1]
    second = np.diff(first, axis=0)[both_known[1:] & both_known[:-1]]
    return {
        "largest_jump": _largest(np.linalg.norm(first[both_known], axis=-1)),
        "second_difference_rms": float(np.sqrt(np.mean(second**2) * 3)) if second.size else None,
    }


def _largest(values: np.ndarray, sign: float = 1.0) -> float | None:
    return sign * float(np.max(values)) if values.size else None


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if values.size else None


def measure(case: Case, repeats: int) -> list[dict]:
    """Return one row a method: its time in a batch, and the quality of its forces."""
    ready, count = calls(case), len(case.problem.wrench)
    spent = interleaved(ready, repeats, 10.0)
    answers = {title: read_answers(call()) for title, call in ready.items()}
    least = {
        sharing: objective(case.problem, answers[f"method {letter}, optimum"].forces, sharing)
        for letter, sharing in (("A", "uniform"), ("B", "squeeze"))
    }
    return [
        {"case": case.name, "method": title, "microseconds": spent[title] / count * 1e6}
        | rate_answers(case, answer, least)
        for title, answer in answers.items()
    ]


def compact_rows(count: int, repeats: int) -> list[dict]:
    """Measure the savings of Cheng and Orin's form: sizes, and the time of a compiled program."""
    rows = []
    for n in SIZES:
        problem = problems("ordinary", n, count, SEED)
        method_input = read_input(grasp_of(problem), problem.wrench)
        scaled, loads = scale(method_input)
        host_problems = [host_problem(method_input, scaled, float(loads[i]), i) for i in range(count)]
        programs = [load_program(problem, 1.0, 1.0, SIDES, "inscribed") for problem in host_problems]
        solvers = {"plain": solve_plain, "compact dual": solve_compact_dual}
        loops = {form: partial(_solve_all, solve, programs) for form, solve in solvers.items()}
        spent = interleaved(loops, repeats, 10.0)
        for (form, solve), size in zip(solvers.items(), sizes_of(programs[0]), strict=True):
            pivots = float(np.mean([solve(program).pivots for program in programs]))
            microseconds = spent[form] / count * 1e6
            rows.append({"n": n, "form": form, **size._asdict(), "pivots": pivots, "microseconds": microseconds})
    return rows


def _solve_all(solve: Callable, programs: list[LinearProgram]) -> list:
    return [solve(program) for program in programs]


def overhead(repeats: int) -> float:
    """Measure the microseconds that SciPy's interface to HiGHS takes for a program with one unknown."""
    unit = np.ones(1)
    trivial = LinearProgram(unit, np.zeros((0, 1)), np.zeros(0), -np.eye(1), unit)
    return interleaved({"trivial": lambda: solve_plain(trivial)}, 20 * repeats, 5.0)["trivial"] * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the three files")
    parser.add_argument("--count", type=int, default=100, help="ordinary problems of each size")
    parser.add_argument("--step", type=float, default=STEP, help="of the cylinder's task [s]")
    parser.add_argument("--repeats", type=int, default=3, help="turns of each method")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    cases = [*(ordinary(n, options.count) for n in SIZES), cylinder(options.step)]
    report = {
        "machine": machine(),
        "setting": {"count": options.count, "seed": SEED, "sides": SIDES, "bound": BOUND, "step": options.step},
        "overhead_microseconds": overhead(options.repeats),
        "rows": [row for case in cases for row in measure(case, options.repeats)],
        "compact": compact_rows(min(options.count, 50), options.repeats),
    }
    (options.out / f"{NAME}.json").write_text(json.dumps(report, indent=1) + "\n")
    (options.out / f"{NAME}.md").write_text(literature_tables.page(report))
    literature_plot.draw(report["rows"], options.out / f"{NAME}.png")


if __name__ == "__main__":
    main()
