"""Times of the C++ kernel on this processor, one thread, beside those of the JAX solver; and its claims, judged.

    python -m benchmarks.kernel

Writes kernel.md: microseconds a problem of batches of 1,000, ordinary ones and lifts, compiled by g++ and by Warp (the
extra ``kernel``) and by XLA; single calls; first calls of a fresh process, with nothing kept and with Warp's cache; and
the claims about every kind of ``jaxgrasp.testing.problems``, judged. Rivals take turns in one process.
"""

from benchmarks.one_thread import one_thread

one_thread()

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxgrasp
from benchmarks.kernel_calls import Kernel, arrays_of, has_compiler
from benchmarks.laws import decision_counts
from benchmarks.machine import machine
from benchmarks.page.clock import interleaved
from benchmarks.sampled_grasps import FAMILIES
from jaxgrasp.kernel import use_kernel
from jaxgrasp.testing.problems import KINDS, problems
from jaxgrasp.testing.references import Problems

SIZES, BATCH, REPEATS = (3, 5, 10, 20), 1000, 31
JUDGED = (3, 5)
FIRST_CALLS = """
import json, time
import jax
jax.config.update("jax_enable_x64", True)
import numpy as np
import jaxgrasp
from jaxgrasp.testing.problems import problems
problem = problems("ordinary", 5, 1000, seed=3)
def grasp(size):
    arrays = (problem.points, problem.normals, problem.friction, problem.squeeze)
    return jaxgrasp.Grasp(*(array[:size] for array in arrays))
def jacobian(squeeze):
    one = jax.tree.map(lambda x: x[0], grasp(1))
    moved = lambda s: jaxgrasp.Grasp(one.points, one.normals, one.friction, s)
    return jax.jacrev(lambda s: jaxgrasp.constrained_optimum(moved(s), problem.wrench[0]).forces)(one.squeeze)
def gradient(wrench):
    return jax.grad(lambda w: jaxgrasp.constrained_optimum(grasp(1000), w).forces.sum())(wrench)
calls = {
    "closed form, 1 grasp": lambda: jaxgrasp.closed_form(grasp(1), problem.wrench[:1]).forces,
    "optimum, 1 grasp": lambda: jaxgrasp.constrained_optimum(grasp(1), problem.wrench[:1]).forces,
    "optimum, 1,000 grasps": lambda: jaxgrasp.constrained_optimum(grasp(1000), problem.wrench).forces,
    "optimum, 777 grasps": lambda: jaxgrasp.constrained_optimum(grasp(777), problem.wrench[:777]).forces,
    "jacrev, 1 grasp": lambda: jacobian(problem.squeeze[0]),
    "gradient, 1,000 grasps": lambda: gradient(problem.wrench),
}
seconds = {}
for name, call in calls.items():
    start = time.process_time()
    jax.block_until_ready(call())
    seconds[name] = time.process_time() - start
print(json.dumps(seconds))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of kernel.md")
    folder = parser.parse_args().out
    jax.config.update("jax_enable_x64", True)
    text = "\n".join([*_heading(), *_first_calls(), *_batches(), *_decisions()])
    (folder / "kernel.md").write_text(text + "\n")
    print(text)


def _heading() -> list[str]:
    facts = machine()
    versions = ", ".join(f"{name} {facts['versions'][name]}" for name in ("jax", "numpy"))
    return [
        "# The C++ kernel",
        "",
        f"Made by `python -m benchmarks.kernel`. {facts['processor']}, one thread, float64, {versions}.",
        "",
    ]


def _first_calls() -> list[str]:
    """Return CPU seconds of first calls: by the JAX solver, by the kernel with nothing kept, and with Warp's cache."""
    with tempfile.TemporaryDirectory() as cache:
        runs = [_first_calls_of_process(used, cache) for used in ("0", "1", "1")]
    lines = [
        "## First calls",
        "",
        "CPU seconds, five contacts, one process from top to bottom; imports not counted.",
        "",
    ]
    lines += ["| call | JAX solver | kernel, first on a machine | kernel, later processes |", "|---|---|---|---|"]
    lines += [f"| {name} | " + " | ".join(f"{run[name]:.2f}" for run in runs) + " |" for name in runs[0]]
    return [*lines, ""]


def _first_calls_of_process(used: str, cache: str) -> dict[str, float]:
    environment = os.environ | {"JAXGRASP_KERNEL": used, "WARP_CACHE_PATH": cache, "JAX_ENABLE_COMPILATION_CACHE": "0"}
    result = subprocess.run([sys.executable, "-c", FIRST_CALLS], capture_output=True, text=True, env=environment)
    if result.returncode:
        raise RuntimeError(result.stderr)
    return json.loads(result.stdout)


def _batches() -> list[str]:
    lines = ["## Batches of 1,000 and single calls", ""]
    lines += [
        "Microseconds a problem; the calls of JAX are jitted. Columns of a row took turns: compare them, not pages."
    ]
    lines += [""]
    lines += ["| n | problems | g++ | kernel from JAX | JAX solver | one call: kernel | one call: JAX solver |"]
    lines += ["|---|---|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        compiled = Kernel(Path(folder)) if has_compiler() else None
        for n in SIZES:
            for name, problem in (
                ("ordinary", problems("ordinary", n, BATCH, seed=3)),
                ("lift", FAMILIES["lift"](n, BATCH)),
            ):
                lines.append(f"| {n} | {name} | " + " | ".join(_row(compiled, problem)) + " |")
    return [*lines, ""]


def _row(compiled: Kernel | None, problem: Problems) -> list[str]:
    one = Problems(*(value[:1] if isinstance(value, np.ndarray) else value for value in problem))
    calls: dict[str, Callable[[], Any]] = {}
    for used in (True, False):
        use_kernel(used)
        for size, data in ((BATCH, problem), (1, one)):
            solve = jax.jit(lambda grasp, wrench: jaxgrasp.constrained_optimum(grasp, wrench))
            arguments = jax.device_put((_grasp(data), data.wrench))
            jax.block_until_ready(solve(*arguments))
            calls[f"{used} {size}"] = lambda solve=solve, arguments=arguments: jax.block_until_ready(solve(*arguments))
    if compiled is not None:
        calls["g++"] = partial(compiled.solve, **arrays_of(problem))
    seconds = interleaved(calls, REPEATS, 20.0, burst=0.002)
    batch = {name: spent / (1 if name.endswith(" 1") else BATCH) * 1e6 for name, spent in seconds.items()}
    columns = ("g++", f"True {BATCH}", f"False {BATCH}", "True 1", "False 1")
    return [f"{batch[name]:.3g}" if name in batch else "-" for name in columns]


def _grasp(problem: Problems) -> jaxgrasp.Grasp:
    return jaxgrasp.Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)


def _decisions() -> list[str]:
    """Return what the kernel claims about hard problems, judged in extended precision and beside the JAX solver."""
    columns = ("wrong", "contradict", "verdicts_differ", "undecided", "undecided_by_reference")
    totals = dict.fromkeys(("problems", *columns), 0)
    rows = []
    for kind in KINDS:
        counts = dict.fromkeys(totals, 0)
        for n in JUDGED:
            problem = problems(kind, n, BATCH, seed=0)
            for sharing in ("squeeze", "uniform"):
                weights = problem.weights(sharing)
                kernel, reference = (_answers(used, problem, weights) for used in (True, False))
                decisions = decision_counts(problem, weights, kernel, reference)
                counts = {name: count + decisions.get(name, BATCH) for name, count in counts.items()}
        totals = {name: total + counts[name] for name, total in totals.items()}
        rows.append(f"| {kind} | " + " | ".join(f"{count:,}" for count in counts.values()) + " |")
    sizes = " and ".join(map(str, JUDGED))
    return [
        "## Hard problems",
        "",
        f"{BATCH:,} of each kind at {sizes} contacts, by method A and B. Wrong by the judge of extended precision;",
        "contradicting: an answer where the JAX solver has a proof that there is none, or the reverse.",
        "",
        "| kind | problems | wrong | contradicting | other verdicts | NOT_CONVERGED: kernel | JAX solver |",
        "|---|---|---|---|---|---|---|",
        *rows,
        "| all | " + " | ".join(f"{count:,}" for count in totals.values()) + " |",
    ]


def _answers(used: bool, problem: Problems, weights: np.ndarray) -> jaxgrasp.Solution:
    use_kernel(used)
    return jax.device_get(_solver(used)(_grasp(problem), problem.wrench, weights))


@cache
def _solver(used: bool) -> Callable[..., jaxgrasp.Solution]:
    """Return a program for each solver: programs keep what they were compiled with."""
    return jax.jit(lambda *arguments: jaxgrasp.constrained_optimum(*arguments))


if __name__ == "__main__":
    main()
