"""Measure the installed version of JAX: what its compiler accepts, how long first calls compile, how fast batches run.

    python -m benchmarks.jax_version

Adds the installed version to jax_versions.json and jax_versions.md, which hold one table for all versions measured so
far. Run it in an environment with the new version, with only the base dependencies, to decide whether the bound
``UNMEASURED_FROM`` in jaxgrasp/numerics/compiled_code.py can move.
"""

from benchmarks.one_thread import one_thread

one_thread()

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import jax
import jax.numpy as jnp

import jaxgrasp
from benchmarks.machine import machine
from benchmarks.page.clock import interleaved
from jaxgrasp.numerics import compiled_code, fused_cpu_kernel
from jaxgrasp.testing import problems as P

SIZES = (3, 5, 10, 20)
PROBLEMS = 3000
TURNS = 41
CALLS = (jaxgrasp.closed_form, jaxgrasp.constrained_optimum)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the two files")
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES), help="numbers of contacts")
    parser.add_argument("--repeats", type=int, default=2, help="compilations of each program; the least time counts")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    accepted = {name: _is_accepted(name, value) for name, value in compiled_code.COMPILED_FOR_FIRST_CALL.items()}
    rows = [row for n in options.sizes for call in CALLS for row in measure(call, n, options.repeats)]
    path = options.out / "jax_versions.json"
    report = json.loads(path.read_text()) if path.exists() else {}
    report[jax.__version__] = {"machine": machine(), "options": accepted, "rows": rows}
    path.write_text(json.dumps(report, indent=1) + "\n")
    (options.out / "jax_versions.md").write_text(page(report))
    print(page({jax.__version__: report[jax.__version__]}))


def _is_accepted(name: str, value: int) -> bool:
    """Return whether this version's compiler knows an option."""
    try:
        jax.jit(lambda x: x + 1, compiler_options={name: value}).lower(jnp.zeros(1)).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def measure(call: Callable, n: int, repeats: int) -> list[dict]:
    """Measure a call on ordinary problems of ``n`` contacts: jitted, with marks and without, and plain.

    Returns:
        Rows with CPU seconds of the first call and microseconds a problem.
    """
    drawn = P.problems("ordinary", n, PROBLEMS, seed=0)
    grasp = jaxgrasp.Grasp(drawn.points, drawn.normals, drawn.friction, drawn.squeeze)
    arguments = jax.device_put((grasp, drawn.wrench))
    variants = {"jitted": (True, True), "jitted, unmarked": (True, False), "plain call": (False, True)}
    first = dict.fromkeys(variants, float("inf"))
    programs: dict[str, Callable[[], Any]] = {}
    for _ in range(repeats):
        for variant, (is_jitted, is_marked) in variants.items():
            seconds, programs[variant] = _first_call(call, arguments, is_jitted, is_marked)
            first[variant] = min(first[variant], seconds)
    spent = interleaved(programs, TURNS, budget=5.0, statistic=min)
    return [
        {
            "call": call.__name__,
            "n": n,
            "way": variant,
            "first": first[variant],
            "time": spent[variant] / PROBLEMS * 1e6,
        }
        for variant in variants
    ]


def _first_call(call: Callable, arguments: tuple, is_jitted: bool, is_marked: bool) -> tuple[float, Callable[[], Any]]:
    """Compile and run once; return the CPU seconds that it took [s], and the program."""
    jax.clear_caches()
    start = time.process_time()
    if is_jitted:
        merges = is_marked and jax.__version_info__ >= compiled_code.LOOPS_MERGED_FROM
        with (
            patch.object(fused_cpu_kernel, "is_known_xla", lambda: is_marked),
            patch.object(fused_cpu_kernel, "merges_loops", lambda: merges),
        ):
            program = jax.jit(call).lower(*arguments).compile()
    else:
        program = call
    jax.block_until_ready(program(*arguments))
    return time.process_time() - start, lambda: jax.block_until_ready(program(*arguments))


def page(report: dict) -> str:
    """Return the table of all versions, in Markdown."""
    any_machine = next(iter(report.values()))["machine"]
    lines = [
        "# Versions of JAX",
        "",
        f"Made by `python -m benchmarks.jax_version`, once with each version. {any_machine['processor']}, one thread. "
        f"Batches of {PROBLEMS:,} ordinary problems in float64. *First* is CPU seconds of tracing, compiling and "
        f"running once, nothing cached; *time* is microseconds a problem, the least of {TURNS} turns, since versions "
        "cannot take turns. *Jitted* is `jax.jit(call)` in a user's "
        "program, which gets the compiler's default options; *unmarked* is the same without single kernels; *plain "
        "call* is the call outside of any program.",
        "",
        "| call | n | JAX | jitted: first | time | unmarked: first | time | plain call: first | time |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    keys = {(row["call"], row["n"]) for entry in report.values() for row in entry["rows"]}
    for name, n in sorted(keys):
        for version, entry in report.items():
            rows = [row for row in entry["rows"] if (row["call"], row["n"]) == (name, n)]
            cells = " | ".join(f"{row['first']:.1f} | {row['time']:.2f}" for row in rows)
            if rows:
                lines.append(f"| {name} | {n} | {version} | {cells} |")
    lines += ["", "Options of plain calls that each version's compiler accepts:", ""]
    for version, entry in report.items():
        accepted = ", ".join(f"`{name}`" + ("" if is_known else " (no)") for name, is_known in entry["options"].items())
        lines.append(f"- {version}: {accepted}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
