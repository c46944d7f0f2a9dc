"""``jaxgrasp evaluate``: from files of grasps to results, a summary and a report."""

import math
from functools import partial
from itertools import product
from pathlib import Path
from threading import Lock

from tqdm import tqdm

from jaxgrasp.batch.arrow import arrow_library
from jaxgrasp.batch.manifest import held_folder
from jaxgrasp.batch.ray_cluster import ray_library
from jaxgrasp.batch.remote_file import parse_path
from jaxgrasp.batch.result_table import SMALL_TABLE, first_rows, write_table
from jaxgrasp.batch.shards import ResultFolder
from jaxgrasp.batch.sources import Adjustments, open_source
from jaxgrasp.batch.stream import StreamPlan, evaluate_stream
from jaxgrasp.cli.data import data_path
from jaxgrasp.cli.evaluate_arguments import Evaluate
from jaxgrasp.cli.evaluate_files import evaluate_files
from jaxgrasp.cli.evaluate_outcome import say_outcome, write_page
from jaxgrasp.cli.machine import set_up_jax
from jaxgrasp.cli.terminal import announce, show
from jaxgrasp.quality.measures import measures_named
from jaxgrasp.quality.task_demands import TaskDemands, load_demands


def evaluate_command(arguments: Evaluate) -> int:
    """Evaluate once, or once for each swept value of friction and squeeze."""
    if arguments.chunk < 1:
        raise ValueError(f"chunk is {arguments.chunk}: expected a number of grasps, 1 or more")
    for name in ("friction", "squeeze"):
        _check_values(name, getattr(arguments, name))
    if arguments.torsion is not None:
        _check_values("torsion", (arguments.torsion,))
    task = None if arguments.task is None else load_demands(arguments.task)
    measures_named(_quality_names(arguments), task)
    _check_places(arguments)
    if arguments.table == "parquet":
        arrow_library()
    set_up_jax(arguments.dtype)
    sweeping = len(arguments.friction) > 1 or len(arguments.squeeze) > 1
    for friction, squeeze in product(arguments.friction or (None,), arguments.squeeze or (None,)):
        adjustments = Adjustments(
            arguments.normals == "outward", friction, squeeze, arguments.torsion, arguments.normalize
        )
        folder = arguments.out
        if sweeping:
            label = "-".join(f"{name}-{value!r}" for name, value in adjustments.fill.items())
            folder = folder / label
            show(f"\n== {label} ==")
        _evaluate_one(arguments, adjustments, task, folder)
    return 0


def _check_places(arguments: Evaluate) -> None:
    """Raise ValueError for arguments that suit neither one file nor a cluster, ImportError without Ray or Arrow."""
    if arguments.cluster is None:
        if len(arguments.file) > 1:
            raise ValueError(f"{len(arguments.file):,} files are given: expected one, or --cluster local")
        for name, default in (("workers", None), ("gpus", 0), ("skip_damaged", False)):
            if getattr(arguments, name) != default:
                raise ValueError(f"--{name.replace('_', '-')} is given without --cluster: expected both, or neither")
        return
    if not arguments.file:
        raise ValueError("--cluster is given without files: expected Parquet files, or folders of them")
    if arguments.table not in ("auto", "parquet"):
        raise ValueError(f"table is {arguments.table!r}: expected auto or parquet with --cluster, which writes Parquet")
    if arguments.workers is not None and arguments.workers < 1:
        raise ValueError(f"workers is {arguments.workers}: expected a number of processes, 1 or more")
    if not (math.isfinite(arguments.gpus) and arguments.gpus >= 0):
        raise ValueError(f"gpus is {arguments.gpus}: expected a number, zero or more")
    ray_library()
    arrow_library()


def _quality_names(arguments: Evaluate) -> tuple[str, ...]:
    return tuple(name for part in arguments.quality.split(",") if (name := part.strip()))


def _check_values(name: str, values: tuple[float, ...]) -> None:
    for index, value in enumerate(values):
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name}[{index}] is {value}: expected a finite number, zero or more")
        if value in values[:index]:
            raise ValueError(f"{name}[{index}] is {value}, for the second time: expected different values")


def _evaluate_one(arguments: Evaluate, adjustments: Adjustments, task: TaskDemands | None, out: Path) -> None:
    quality = _quality_names(arguments)
    plan = StreamPlan(
        arguments.methods,
        arguments.chunk,
        arguments.dtype,
        arguments.skip_bad,
        adjustments,
        quality,
        arguments.least_friction,
        task,
    )
    if arguments.cluster is not None:
        evaluate_files(arguments, plan, out)
        return
    path = data_path(next(map(parse_path, arguments.file), None))
    with held_folder(out, announce), open_source(path, adjustments) as source:
        identity = plan.identity(path.name, source)
        folder = ResultFolder(out, identity, arguments.resume, arguments.overwrite)
        with tqdm(total=len(source), unit=" grasps", initial=folder.done, disable=None, leave=False) as bar:
            meter = Meter(bar)
            outcome = evaluate_stream(source, plan, folder, meter.finished, announce, meter.measured)
        doubts = say_outcome(source, plan, outcome, arguments, path.name, out)
        _write_table(folder, outcome.summary.problems, arguments.table)
        write_page(partial(first_rows, folder.shards()), outcome, arguments, path.name, out, doubts)


class Meter:
    """Progress bar of grasps that also advances while a chunk is being evaluated."""

    def __init__(self, bar: tqdm) -> None:
        self._bar, self._finished, self._measured = bar, bar.n, bar.n
        self._lock = Lock()

    def finished(self, grasps: int) -> None:
        with self._lock:
            self._finished += grasps
            self._show()

    def measured(self, grasps: int) -> None:
        with self._lock:
            self._measured += grasps
            self._show()

    def _show(self) -> None:
        # Grasps that are set aside are finished, and never measured.
        self._bar.update(max(self._finished, self._measured) - self._bar.n)


def _write_table(folder: ResultFolder, rows: int, format_: str) -> None:
    if format_ == "none":
        return
    if format_ == "auto" and rows > SMALL_TABLE:
        show(f"no table of {rows:,} rows: --table csv or --table parquet writes it")
        return
    path = folder.folder / f"results.{'csv' if format_ == 'auto' else format_}"
    write_table(path, folder.shards())
    show(f"table:   {path}")
