"""What a cluster costs beside one process: ``jaxgrasp evaluate --cluster`` on one machine against plain ``evaluate``.

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
from benchmarks.machine import machine
from jaxgrasp.testing.problems import problems

SHARD = 62_500
"""Grasps in a file, at most."""
DISTINCT = 16
"""Files that differ; what is more is the same again, under other names."""
CONTACTS = 5
MARK = "JAXGRASP_BENCHMARK_CLUSTER"
TICKS = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")
EVERY = 0.1
"""Seconds between two looks at the processes."""


class Seen(NamedTuple):
    cpu: float
    """Seconds."""
    resident: float
    """Most at any look [MiB]."""
    is_worker: bool


class Watch:
    """Looks at the processes that a run begins, by a mark in their environment."""

    def __init__(self, out: Path) -> None:
        self.mark, self.first_file = uuid.uuid4().hex, None
        self._out, self._seen, self._begun = out, {}, time.perf_counter()
        self._mine: dict[str, bool] = {}
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._look)

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *_) -> None:
        self._done.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._done.wait(EVERY):
            for folder in Path("/proc").glob("[0-9]*"):
                try:
                    self._count(folder)
                except OSError:
                    continue
            if self.first_file is None and any(self._out.glob("[!.]*.parquet")):
                self.first_file = time.perf_counter() - self._begun

    def _count(self, folder: Path) -> None:
        if folder.name not in self._mine:
            self._mine[folder.name] = f"{MARK}={self.mark}\0".encode() in (folder / "environ").read_bytes()
        if not self._mine[folder.name]:
            return
        fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
        resident = int((folder / "statm").read_text().split()[1]) * PAGE / (1 << 20)
        before = self._seen.get(folder.name, Seen(0, 0, False))
        # A worker takes its name once it is at work.
        worker = before.is_worker or b"ray::MapWorker" in (folder / "cmdline").read_bytes()
        cpu = (int(fields[11]) + int(fields[12])) / TICKS
        self._seen[folder.name] = Seen(max(cpu, before.cpu), max(resident, before.resident), worker)

    @property
    def cpu(self) -> float:
        return sum(one.cpu for one in self._seen.values())

    def resident(self, workers: bool) -> float:
        return max((one.resident for one in self._seen.values() if one.is_worker or not workers), default=0)


def write_files(folder: Path, count: int) -> list[Path]:
    """Files with so many grasps in all."""
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
    """All of them as one file."""
    from pyarrow import parquet

    with parquet.ParquetWriter(path, parquet.read_schema(files[0])) as writer:
        for file in files:
            writer.write_table(parquet.read_table(file))
    return path


def run(arguments: list[str], out: Path) -> dict:
    command = [sys.executable, "-m", "jaxgrasp.cli.main", "evaluate", *arguments, "--out", str(out), "--no-report"]
    begun = time.perf_counter()
    with Watch(out) as watch:
        environment = os.environ | {MARK: watch.mark}
        done = subprocess.run([*command, "--overwrite"], capture_output=True, text=True, env=environment)
        if done.returncode:
            raise RuntimeError(done.stderr)
        wall = time.perf_counter() - begun
    summary = json.loads((out / "summary.json").read_text())
    return {
        "wall_seconds": wall,
        "working_seconds": summary["seconds"],
        "cpu_seconds": watch.cpu,
        "first_file_seconds": watch.first_file,
        "worker_mib": watch.resident(workers=True),
        "largest_mib": watch.resident(workers=False),
        "verdicts": {name: method["verdicts"] for name, method in summary["summary"]["methods"].items()},
    }


def measure(count: int) -> dict:
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        files = write_files(root / "in", count)
        whole = joined(files, root / "whole.parquet")
        found = {"grasps": count, "files": len(files), "input_bytes": sum(file.stat().st_size for file in files)}
        found["plain"] = run([str(whole), "--table", "none"], root / "plain")
        for workers in (1, 2):
            out = root / f"by-{workers}"
            options = ["--cluster", "local", "--workers", str(workers)]
            found[f"workers_{workers}"] = run([str(root / "in"), *options], out)
            found["output_bytes"] = sum(file.stat().st_size for file in out.glob("*.parquet"))
            for file in out.glob("*.parquet"):
                file.unlink()
        said = [found[name].pop("verdicts") for name in ("plain", "workers_1", "workers_2")]
        assert said[0] == said[1] == said[2], "the same grasps have other verdicts"
        found["verdicts"] = said[0]
        return found


def page(report: dict) -> str:
    lines = [
        "# What a cluster costs",
        "",
        "`python -m benchmarks.cluster --out benchmarks/results`. Grasps of five contacts, Parquet in and out, both",
        f"closed forms and both optima, on {report['machine']['cores']} cores of {report['machine']['processor']}.",
        "Others may have been at work on the machine: CPU seconds are what to compare, of all processes of a run,",
        "Ray's own and starting among them.",
        "",
        "| grasps | files | run | CPU s | wall s | CPU µs a grasp | first file s | worker MiB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        for name, what in (("plain", "plain"), ("workers_1", "1 worker"), ("workers_2", "2 workers")):
            one = row[name]
            first = "-" if one["first_file_seconds"] is None else f"{one['first_file_seconds']:.1f}"
            memory = one["largest_mib"] if name == "plain" else one["worker_mib"]
            each = 1e6 * one["cpu_seconds"] / row["grasps"]
            lines.append(
                f"| {row['grasps']:,} | {row['files']} | {what} | {one['cpu_seconds']:.1f} | {one['wall_seconds']:.1f} "
                f"| {each:.1f} | {first} | {memory:.0f} |"
            )
    largest = report["rows"][-1]
    lines += [
        "",
        f"Input {largest['input_bytes'] / largest['grasps']:.0f} bytes a grasp, "
        f"results {largest['output_bytes'] / largest['grasps']:.0f}.",
        "",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"), help="folder of the two files")
    parser.add_argument("--largest", type=int, default=1_000_000, help="10,000,000 takes a quarter of an hour alone")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    counts = [count for count in (10_000, 100_000, 1_000_000, 10_000_000) if count <= arguments.largest]
    with tempfile.TemporaryDirectory() as scratch:
        write_files(Path(scratch) / "in", 2 * 1_000)
        run([str(Path(scratch) / "in"), "--cluster", "local"], Path(scratch) / "out")
        run([str(joined([*(Path(scratch) / "in").iterdir()], Path(scratch) / "w.parquet"))], Path(scratch) / "plain")
    report = {"machine": machine(), "rows": []}
    for count in counts:
        report["rows"].append(measure(count))
        (arguments.out / "cluster.json").write_text(json.dumps(report, indent=1) + "\n")
        (arguments.out / "cluster.md").write_text(page(report))
        print(page(report).splitlines()[-7:], flush=True)


if __name__ == "__main__":
    main()
