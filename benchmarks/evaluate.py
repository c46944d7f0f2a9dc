"""Throughput of ``jaxgrasp evaluate``: both closed forms and both optima, reading and writing included.

    python -m benchmarks.evaluate --out benchmarks/results/evaluate.json

Each run is a process of its own, as a user starts it; the first of each size fills the compilation cache
and is not counted. Compiling (loading compiled code, then) is reported apart.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import sampled_grasps
from benchmarks.machine import machine
from jaxgrasp.testing.problems import problems
from jaxgrasp.testing.references import Problems

RUN = r"""
import re, sys
from pathlib import Path
from jaxgrasp.cli.main import main
code = main(["evaluate", sys.argv[1], "--out", sys.argv[2], "--no-report"])
# Of this process alone: what rusage tells begins with the peak of the process that started it.
print("peak", re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1])
sys.exit(code)
"""


FAMILIES: dict[str, Callable[[int, int], Problems]] = {
    "ordinary": lambda n, count: problems("ordinary", n, count, seed=0),
    "sampled, any load": sampled_grasps.FAMILIES["any"],
    "sampled, a lift": sampled_grasps.FAMILIES["lift"],
}


def write_grasps(path: Path, drawn: Problems) -> None:
    columns = {name: getattr(drawn, name) for name in ("points", "normals", "friction", "squeeze", "wrench")}
    np.savez(path, version=1, **columns)


def run_once(file: Path, out: Path) -> dict:
    output = subprocess.run([sys.executable, "-c", RUN, file, out], check=True, capture_output=True, text=True).stdout
    summary = json.loads((out / "summary.json").read_text())
    peak = int(output.rsplit("peak ", 1)[1]) / 1024
    working = summary["seconds"] - summary["times"]["compiling"]
    return {"seconds": working, "compiling": summary["times"]["compiling"], "peak_mib": peak, "summary": summary}


def measure(family: str, count: int, n: int, repeats: int) -> dict:
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "grasps.npz"
        write_grasps(file, FAMILIES[family](n, count))
        runs = [run_once(file, Path(scratch) / "out") for _ in range(repeats + 1)]
    counted = runs[1:]
    seconds = statistics.median(run["seconds"] for run in counted)
    methods = counted[0]["summary"]["summary"]["methods"]
    return {
        "family": family,
        "grasps": count,
        "contacts": n,
        "seconds": seconds,
        "grasps_per_second": count / seconds,
        "first_run_compiling_seconds": runs[0]["compiling"],
        "peak_mib": max(run["peak_mib"] for run in counted),
        "verdicts": {name: method["verdicts"] for name, method in methods.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--largest", type=int, default=1_000_000)
    arguments = parser.parse_args()
    families = [("ordinary", 1_000_000), *((family, 100_000) for family in FAMILIES)]
    rows = [measure(family, count, 5, arguments.repeats) for family, count in families if count <= arguments.largest]
    arguments.out.write_text(json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
