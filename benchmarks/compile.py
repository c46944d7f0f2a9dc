"""Time before a first answer: CPU seconds of compiling, before and after; and the effect on answers.

    python -m benchmarks.compile --out benchmarks/results

Writes compile.json and compile.md. ``programs`` measures each public call in this version and in the one before, which
is checked out from the repository's history; ``verdicts`` solves every kind of hard problem under four sets of compile
options; ``kernels`` times batches with the solver's steps as single kernels, and as the plain functions that they are
where XLA is not known; ``suite`` runs the quick tests with nothing compiled, one after the other.
"""

from benchmarks.one_thread import one_thread

one_thread()

import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import jax

import jaxgrasp
from benchmarks.earlier import checked_out
from benchmarks.page import compile_tables
from benchmarks.page.clock import interleaved
from benchmarks.sections import run_sections
from jaxgrasp.kernel import use_kernel
from jaxgrasp.numerics import fused_cpu_kernel
from jaxgrasp.testing import problems as P

NAME = "compile"
FOLDER = Path(__file__).parent
BEFORE = "be510ef"
OPTIONS = {
    "as users compile": "",
    "as plain calls compile": "--xla_backend_optimization_level=2",
    "LLVM at level 0": "--xla_backend_optimization_level=0",
    "LLVM at level 1": "--xla_backend_optimization_level=1",
}


class Plan(NamedTuple):
    """Sizes and repetitions of the measurements."""

    batches: tuple[int, ...] = (1, 1000)
    calls: tuple[str, ...] = ()
    """Those measured; all if empty."""
    repeats: int = 1
    """Times that both versions are measured, in turns; of several the least counts, since neighbours only add."""
    problems: int = 1000
    """Of each kind, size and sharing."""
    sizes: tuple[int, ...] = (3, 5, 10, 20)
    """Contacts of the problems that are timed."""
    timed: int = 3000
    turns: int = 41
    tests: tuple[str, ...] = ("tests",)


def programs(plan: Plan) -> list[dict]:
    with checked_out(BEFORE) as before:
        runs = [
            {"version": version, **row}
            for batch in plan.batches
            for _ in range(plan.repeats)
            for version, folder in (("before", before), ("after", FOLDER.parent))
            for row in _lines([str(batch), *plan.calls], (FOLDER / "compiled_calls.py").read_text(), folder)
        ]
    return _least(runs)


def _least(runs: list[dict]) -> list[dict]:
    fastest: dict[tuple, dict] = {}
    for run in runs:
        key = (run["call"], run["batch"], run["version"])
        old = fastest.setdefault(key, run)
        fastest[key] = run | {name: min(old[name], run[name]) for name in ("inside", "alone")}
    return list(fastest.values())


def _lines(arguments: list[str], code: str, folder: Path, flags: str = "") -> list[dict]:
    """Run code in a process that imports from ``folder`` first; return the JSON lines that it prints."""
    process = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        env={**os.environ, "JAXGRASP_KERNEL": "0", "XLA_FLAGS": flags, "PYTHONPATH": str(folder)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return [json.loads(line) for line in process.stdout.splitlines()]


def verdicts(plan: Plan) -> dict[str, dict]:
    code = (FOLDER / "compiled_verdicts.py").read_text()
    return {name: _lines([str(plan.problems)], code, FOLDER.parent, flags)[0] for name, flags in OPTIONS.items()}


def kernels(plan: Plan) -> list[dict]:
    """Measure the microseconds a problem of one jitted batch, with single kernels and without."""
    jax.config.update("jax_enable_x64", True)
    use_kernel(False)
    rows = []
    for n in plan.sizes:
        drawn = P.problems("ordinary", n, plan.timed, seed=0)
        grasp = jaxgrasp.Grasp(drawn.points, drawn.normals, drawn.friction, drawn.squeeze)
        arguments = jax.device_put((grasp, drawn.wrench))
        for call in (jaxgrasp.closed_form, jaxgrasp.constrained_optimum):
            rivals = {
                name: _compiled(call, arguments, is_known) for name, is_known in (("single", True), ("plain", False))
            }
            seconds = interleaved(rivals, plan.turns, budget=10.0)
            times = {name: spent / plan.timed * 1e6 for name, spent in seconds.items()}
            rows.append({"call": call.__name__, "n": n, "problems": plan.timed, **times})
    return rows


def _compiled(call: Callable, arguments: tuple, is_known: bool) -> Callable[[], None]:
    """Compile the call as on a version of XLA that is known, or is not."""
    with patch.object(fused_cpu_kernel, "is_known_xla", lambda: is_known):
        jax.clear_caches()
        compiled = jax.jit(call).lower(*arguments).compile()
    return lambda: jax.block_until_ready(compiled(*arguments))


def suite(plan: Plan) -> dict:
    """Measure the CPU seconds of the quick tests, by folder."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "times.json"
        environment = {**os.environ, "XDG_CACHE_HOME": scratch, "JAXGRASP_TEST_TIMES": str(path)}
        for name in ("JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS"):  # the tests' own are measured
            environment.pop(name, None)
        pytest = [sys.executable, "-m", "pytest", "-p", "benchmarks.suite_times", "-p", "no:cacheprovider"]
        subprocess.run(
            [*pytest, *plan.tests], cwd=FOLDER.parent, env=environment, check=True, stdout=subprocess.DEVNULL
        )
        seconds: Counter = Counter()
        for test, spent in json.loads(path.read_text()).items():
            seconds[Path(test.split("::")[0]).parts[1]] += spent
    return dict(seconds)


SECTIONS = {"programs": programs, "verdicts": verdicts, "kernels": kernels, "suite": suite}
QUICK = Plan(
    batches=(1,),
    calls=("closed_form",),
    problems=4,
    sizes=(3,),
    timed=40,
    turns=3,
    tests=("tests/numerics",),
)


def main() -> None:
    run_sections(__doc__, NAME, SECTIONS, (Plan(), QUICK), compile_tables.page)


if __name__ == "__main__":
    main()
