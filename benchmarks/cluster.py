"""Cost of a cluster beside one process: ``jaxgrasp evaluate --cluster`` on one machine against plain ``evaluate``.

    python -m benchmarks.cluster --out benchmarks/results

Both read Parquet files of the same grasps and write their results, with both closed forms and both optima, each run as
a process of its own as a user starts it. CPU seconds and memory are those of all its processes, Ray's own among them,
as the system counts them; one run before, which fills the cache of compiled code, is not counted.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from pathlib import Path
from typing import NamedTuple

import jax

import jaxgrasp
from benchmarks.machine import machine, processor_seconds
from jaxgrasp.testing.problems import problems

SHARD = 62_500
"""Grasps in a file, at most."""
DISTINCT = 16
"""Files that differ; what is more is the same again, under other names."""
CONTACTS = 5
COMMAND, WORKER, RAY = "command", "workers", "Ray"
"""Whose processes: those of neither the command nor the workers are Ray's own."""
MARK = "JAXGRASP_BENCHMARK_CLUSTER"
PAGE = os.sysconf("SC_PAGE_SIZE")
LOOK_PERIOD_S = 0.1
"""Seconds between two looks at the processes."""


class ProcessUsage(NamedTuple):
    cpu: float
    """Seconds."""
    resident: float
    """Most at any look [MiB]."""
    role: str


class Watch:
    """Looks at the processes that a run begins, by a mark in their environment."""

    def __init__(self, out: Path) -> None:
        self.mark, self.first_file = uuid.uuid4().hex, None
        self._out, self._usage, self._start_s = out, {}, time.perf_counter()
        self._mine: dict[str, bool] = {}
        self._stop_event = threading.Event()
        self._thread = threading.Thread(target=self._look)

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *_) -> None:
        self._stop_event.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._stop_event.wait(LOOK_PERIOD_S):
            for folder in Path("/proc").glob("[0-9]*"):
                try:
                    self._count(folder)
                except OSError:
                    continue
            if self.first_file is None and any(self._out.glob("[!.]*.parquet")):
                self.first_file = time.perf_counter() - self._start_s

    def _count(self, folder: Path) -> None:
        if folder.name not in self._mine:
            self._mine[folder.name] = f"{MARK}={self.mark}\0".encode() in (folder / "environ").read_bytes()
        if not self._mine[folder.name]:
            return
        resident = int((folder / "statm").read_text().split()[1]) * PAGE / (1 << 20)
        before = self._usage.get(folder.name, ProcessUsage(0, 0, RAY))
        cpu = processor_seconds(folder.name)
        role = before.role if before.role != RAY else role_of((folder / "cmdline").read_bytes())
        self._usage[folder.name] = ProcessUsage(max(cpu, before.cpu), max(resident, before.resident), role)

    def cpu(self) -> dict[str, float]:
        """Return the CPU seconds by role."""
        seconds = dict.fromkeys((COMMAND, WORKER, RAY), 0.0)
        for process in self._usage.values():
            seconds[process.role] += process.cpu
        return seconds

    def resident(self, *roles: str) -> float:
        return max((process.resident for process in self._usage.values() if process.role in roles), default=0)


def role_of(command: bytes) -> str:
    """Return the role of a process by its command line; a worker takes its name once it is at work."""
    if b"ray::MapWorker" in command:
        return WORKER
    return COMMAND if b"jaxgrasp.cli.main" in command else RAY


def write_files(folder: Path, count: int) -> list[Path]:
    """Write files with ``count`` grasps in all."""
    shard = min(SHARD, count // 2)
    folder.mkdir()
    files = [folder / f"part-{number:04d}.parquet" for number in range(count // shard)]
    for number, file in enumerate(files):
        if number >= DISTINCT:
            os.link(files[number % DISTINCT], file)
            continue
        drawn = problems("ordinary", CONTACTS, shard, seed=number)
        grasp = jaxgrasp.Grasp(drawn.points, drawn.normals, drawn.friction, drawn.squeeze)
        jaxgrasp.save_grasps(file, grasp, drawn.wrench)
    return files


def joined(files: list[Path], path: Path) -> Path:
    """Join all files into one."""
    from pyarrow import parquet

    with parquet.ParquetWriter(path, parquet.read_schema(files[0])) as writer:
        for file in files:
            writer.write_table(parquet.read_table(file))
    return path


def run(arguments: list[str], out: Path) -> dict:
    command = [sys.executable, "-m", "jaxgrasp.cli.main", "evaluate", *arguments, "--out", str(out), "--no-report"]
    start_s = time.perf_counter()
    with Watch(out) as watch:
        environment = os.environ | {MARK: watch.mark}
        process = subprocess.run([*command, "--overwrite"], capture_output=True, text=True, env=environment)
        if process.returncode:
            raise RuntimeError(process.stderr)
        wall = time.perf_counter() - start_s
    summary = json.loads((out / "summary.json").read_text())
    return {
        "wall_seconds": wall,
        "working_seconds": summary["seconds"],
        "cpu_seconds": sum(watch.cpu().values()),
        "cpu_seconds_of": watch.cpu(),
        "first_file_seconds": watch.first_file,
        "worker_mib": watch.resident(WORKER),
        "largest_mib": watch.resident(COMMAND, WORKER, RAY),
        "verdicts": {name: method["verdicts"] for name, method in summary["summary"]["methods"].items()},
    }


def measure(count: int) -> dict:
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        files = write_files(root / "in", count)
        joined_file = joined(files, root / "whole.parquet")
        row = {"grasps": count, "files": len(files), "input_bytes": sum(file.stat().st_size for file in files)}
        row["plain"] = run([str(joined_file), "--table", "none"], root / "plain")
        for workers in (1, 2):
            out = root / f"by-{workers}"
            options = ["--cluster", "local", "--workers", str(workers)]
            row[f"workers_{workers}"] = run([str(root / "in"), *options], out)
            row["output_bytes"] = sum(file.stat().st_size for file in out.glob("*.parquet"))
            for file in out.glob("*.parquet"):
                file.unlink()
        verdicts = [row[name].pop("verdicts") for name in ("plain", "workers_1", "workers_2")]
        assert verdicts[0] == verdicts[1] == verdicts[2], "the same grasps have other verdicts"
        row["verdicts"] = verdicts[0]
        return row


RUNS = {"plain": "plain", "workers_1": "1 worker", "workers_2": "2 workers"}


def page(report: dict) -> str:
    lines = [
        "# What a cluster costs",
        "",
        "`python -m benchmarks.cluster --out benchmarks/results`. Grasps of five contacts, Parquet in and out, both",
        f"closed forms and both optima, on {report['machine']['cores']} cores of {report['machine']['processor']}.",
        "Others were at work on the machine: CPU seconds are what to compare, of all processes of a run, as they",
        "start too; wall time, and what Ray spends while it waits, hang on how busy it was. Beside plain is",
        "how much more CPU time all of a run takes than plain `evaluate` does.",
        "",
        "| grasps | files | run | CPU s | command, workers, Ray | beside plain | wall s | first file s | worker MiB |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        for name, title in RUNS.items():
            run_row = row[name]
            parts = ", ".join(f"{seconds:.0f}" for seconds in run_row["cpu_seconds_of"].values())
            more = "-" if name == "plain" else f"{run_row['cpu_seconds'] / row['plain']['cpu_seconds'] - 1:+.0%}"
            first = "-" if run_row["first_file_seconds"] is None else f"{run_row['first_file_seconds']:.0f}"
            memory = run_row["largest_mib"] if name == "plain" else run_row["worker_mib"]
            lines.append(
                f"| {row['grasps']:,} | {row['files']} | {title} | {run_row['cpu_seconds']:.1f} | {parts} | {more} "
                f"| {run_row['wall_seconds']:.0f} | {first} | {memory:.0f} |"
            )
    return "\n".join([*lines, "", *_each_more(report["rows"]), ""])


def _each_more(rows: list[dict]) -> list[str]:
    """Return lines with the cost of a grasp without starting: the slope over the two largest counts."""
    lines = []
    if len(rows) > 1:
        small, large = rows[-2:]
        count = large["grasps"] - small["grasps"]
        slopes = {name: 1e6 * (large[name]["cpu_seconds"] - small[name]["cpu_seconds"]) / count for name in RUNS}
        shown = ", ".join(f"{slopes[name]:.1f} µs by {title}" for name, title in RUNS.items())
        lines.append(
            f"From {small['grasps']:,} to {large['grasps']:,} grasps each one more takes, of CPU time, {shown}."
        )
    largest = rows[-1]
    lines.append(
        f"Input {largest['input_bytes'] / largest['grasps']:.0f} bytes a grasp, "
        f"results {largest['output_bytes'] / largest['grasps']:.0f}."
    )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the two files")
    parser.add_argument("--grasps", type=int, nargs="+", default=[10_000, 100_000, 1_000_000, 10_000_000])
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as scratch:
        write_files(Path(scratch) / "in", 2 * 1_000)
        run([str(Path(scratch) / "in"), "--cluster", "local"], Path(scratch) / "out")
        run([str(joined([*(Path(scratch) / "in").iterdir()], Path(scratch) / "w.parquet"))], Path(scratch) / "plain")
    path = arguments.out / "cluster.json"
    earlier = json.loads(path.read_text())["rows"] if path.exists() else []
    rows = {row["grasps"]: row for row in earlier}
    for count in arguments.grasps:
        rows[count] = measure(count)
        report = {"machine": machine(), "rows": [rows[key] for key in sorted(rows)]}
        path.write_text(json.dumps(report, indent=1) + "\n")
        (arguments.out / "cluster.md").write_text(page(report))


if __name__ == "__main__":
    main()
