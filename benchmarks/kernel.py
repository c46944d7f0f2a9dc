"""Microseconds a problem of the C++ kernel on this processor, one thread, and its share of undecided problems.

    python -m benchmarks.kernel

Needs g++. Prints a Markdown table: ordinary problems and lifts at several sizes in batches of 1,000, then NOT_CONVERGED
by kind of ``jaxgrasp.testing.problems``.
"""

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.kernel_calls import Kernel, arrays_of
from benchmarks.sampled_grasps import FAMILIES
from jaxgrasp import Verdict
from jaxgrasp.testing.problem_data import Problems
from jaxgrasp.testing.problems import KINDS, problems

SIZES, BATCH, REPEATS = (3, 5, 10, 20), 1000, 31


def microseconds(kernel: Kernel, problem: Problems) -> float:
    """Return the median time a problem [us] over ``REPEATS`` calls."""
    arrays, seconds = arrays_of(problem), []
    for _ in range(REPEATS):
        start = time.perf_counter()
        kernel.solve(**arrays)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds)) / len(problem.wrench) * 1e6


def share(kernel: Kernel, problem: Problems, verdict: Verdict) -> float:
    """Return the share of the problems with a verdict."""
    return float(np.mean(kernel.solve(**arrays_of(problem)).verdict == verdict))


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        kernel = Kernel(Path(folder))
        print(f"compiled by g++ in {time.perf_counter() - start:.0f} s\n")
        print("| n | ordinary [us] | lift [us] | lifts infeasible | lifts NOT_CONVERGED |\n|---|---|---|---|---|")
        for n in SIZES:
            ordinary, lift = problems("ordinary", n, BATCH, seed=3), FAMILIES["lift"](n, BATCH)
            times = f"{microseconds(kernel, ordinary):.2f} | {microseconds(kernel, lift):.2f}"
            shares = [share(kernel, lift, verdict) for verdict in (Verdict.INFEASIBLE, Verdict.NOT_CONVERGED)]
            print(f"| {n} | {times} | {shares[0]:.1%} | {shares[1]:.2%} |")
        print("\n| kind, n = 5 | NOT_CONVERGED |\n|---|---|")
        for kind in KINDS:
            print(f"| {kind} | {share(kernel, problems(kind, 5, BATCH, seed=3), Verdict.NOT_CONVERGED):.2%} |")


if __name__ == "__main__":
    main()
