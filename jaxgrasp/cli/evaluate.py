"""``jaxgrasp evaluate``: from files of grasps to results, a summary and a report.

Hints on likely errors in the data: millimetres, outward normals, contacts on a line.

Output of an evaluation beside its results: the summary, on screen and in a file, and the report.

``jaxgrasp evaluate --cluster``: many files, each by some process of a cluster.
"""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from itertools import product
from pathlib import Path
from threading import Lock

import numpy as np
from tqdm import tqdm

from jaxgrasp.batch.arrow_columns import arrow_library
from jaxgrasp.batch.cluster_evaluation import ClusterPlan, evaluate_on_cluster, parquet_files, ray_library, read_inputs
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.engine import Engine
from jaxgrasp.batch.evaluation import run, usable
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.remote_file import parse_path
from jaxgrasp.batch.result_table import SMALL_TABLE, first_rows, write_table
from jaxgrasp.batch.shard_evaluator import ShardFolder
from jaxgrasp.batch.shards import ResultFolder, held_folder
from jaxgrasp.batch.sources import (
    MILLIMETRES,
    TURN_ROUND,
    Adjustments,
    GraspSource,
    looks_like_millimetres,
    open_source,
)
from jaxgrasp.batch.stream import StreamPlan, StreamResult, evaluate_stream
from jaxgrasp.batch.summary import Summary, to_json
from jaxgrasp.batch.summary_text import summary_text
from jaxgrasp.cli.arguments import Evaluate
from jaxgrasp.cli.grasp_files import data_path
from jaxgrasp.cli.machine import provenance, set_up_jax, versions
from jaxgrasp.cli.terminal import announce, show
from jaxgrasp.files.replace import replace_file
from jaxgrasp.model.solution import Verdict, methods_named
from jaxgrasp.quality.measures import measures_named
from jaxgrasp.quality.task_demands import TaskDemands, load_demands

SAMPLE = 256


def hints(source: GraspSource, plan: StreamPlan, summary: Summary) -> list[str]:
    """Return sentences on likely errors in the data; usually the list is empty."""
    sentences: list[str] = []
    sample = next(source.chunks(SAMPLE))
    sample, _ = usable(plan.adjustments.apply(sample), skip_bad=True)
    if not len(sample):
        return sentences
    if looks_like_millimetres(sample):
        sentences.append(f"{MILLIMETRES}.")
    if warning := summary.outward.warning(f"{TURN_ROUND}."):
        sentences.append(warning)
    if not summary.outward.is_most and _share_that_holds(summary) < 0.5 and _holds_turned_round(sample, plan):
        sentences.append(
            "most grasps fail, but hold with their normals turned round: if yours point out of the object, "
            "add --normals outward."
        )
    if summary.ranked is not None and (count := int(summary.ranked.counts[Reason.LINE])):
        sentences.append(
            f"{count:,} of {summary.problems:,} cannot hold because all contacts lie on one line, as those of a "
            "parallel jaw do: hard fingers resist no torque about the line between them, however hard they squeeze. "
            "If yours press along that line and are wide or soft, say so: --torsion 0.005 (metres) gives every contact "
            "torsional friction."
        )
    return sentences


def _share_that_holds(summary: Summary) -> float:
    holds = [m.count(Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL) for m in summary.methods.values()]
    return max(holds) / max(1, summary.problems)


def _holds_turned_round(sample: ContactSets, plan: StreamPlan) -> bool:
    turned = replace(sample, normals=-sample.normals).astype(np.dtype(plan.dtype))
    engine = Engine(methods_named(("B-optimum",)), devices=1)
    verdicts = run(engine, turned)["B-optimum"].verdict
    return bool((verdicts <= Verdict.OPTIMAL).mean() > 0.5)


def say_outcome(
    source: GraspSource, plan: StreamPlan, outcome: StreamResult, arguments: Evaluate, name: str, out: Path
) -> list[str]:
    """Show and write the summary; returns hints, out of some of the grasps of ``source``, for whoever asked."""
    doubts = hints(source, plan, outcome.summary)
    for hint in doubts:
        show(f"warning: {hint}")
    show(summary_text(outcome.summary, outcome.times, outcome.seconds, arguments.details))
    if not arguments.details:
        show("details: add --details for the statistics of each method; summary.json and the report have them too")
    # A resumed evaluation that was finished already has nothing new to say, and no times.
    if outcome.times.problems or not (out / "summary.json").exists():
        _write_summary(out / "summary.json", outcome, arguments, name, doubts)
    return doubts


def _write_summary(path: Path, outcome: StreamResult, arguments: Evaluate, name: str, doubts: list[str]) -> None:
    content = {
        "summary": to_json(outcome.summary),
        "times": asdict(outcome.times),
        "seconds": outcome.seconds,
        "details": _details(arguments, name),
        "hints": doubts,
    }
    replace_file(path, lambda stream: stream.write(json.dumps(content).encode()))


def write_page(
    first_rows: Callable[[int], dict[str, np.ndarray]],
    outcome: StreamResult,
    arguments: Evaluate,
    name: str,
    out: Path,
    doubts: list[str],
) -> None:
    """Say where the results are, and write the report where it is asked for; ``first_rows`` gives so many rows."""
    show(f"results: {out}")
    if not arguments.report:
        return
    from jaxgrasp.report.page import write_report
    from jaxgrasp.report.worst_cases import MOST_ROWS

    rows, path, details = first_rows(MOST_ROWS), out / "report.html", _details(arguments, name)
    try:
        write_report(path, outcome.summary, outcome.times, title=name, details=details, rows=rows, hints=doubts)
    except ImportError as error:
        show(f"no report: {error}")
    else:
        show(f"report:  {path}")


def _details(arguments: Evaluate, name: str) -> dict[str, str]:
    return {
        "input": name,
        "normals": arguments.normals + (", made length 1" if arguments.normalize else ""),
        "methods": ", ".join(arguments.methods),
        "precision": arguments.dtype,
        **provenance(),
    }


def evaluate_files(arguments: Evaluate, plan: StreamPlan, out: Path) -> None:
    """Evaluate the files that the arguments name, and show and write what is said of them all."""
    cluster = ClusterPlan(
        arguments.cluster or ClusterPlan.where, arguments.workers, arguments.gpus, arguments.skip_damaged
    )
    inputs = read_inputs(parquet_files([parse_path(file) for file in arguments.file]), cluster.skip_damaged, announce)
    files, total = [task.file for task in inputs.tasks], sum(inputs.grasps.values())
    with held_folder(out, announce):
        folder = ShardFolder(out, plan.options, versions(), files, arguments.resume, arguments.overwrite)
        with tqdm(total=total, unit=" grasps", disable=None, leave=False) as bar:
            announce(f"{len(files):,} files with {total:,} grasps, on a cluster ({cluster.where}) ...")
            outcome = evaluate_on_cluster(inputs, plan, cluster, folder, bar.update, announce)
        with open_source(
            next(task.path for task in inputs.tasks if folder.entry(task.file)), plan.adjustments
        ) as source:
            doubts = say_outcome(source, plan, outcome, arguments, _title(arguments), out)
        if outcome.resumed:
            show(f"{outcome.resumed:,} of the grasps were done before")
        write_page(folder.first_rows, outcome, arguments, _title(arguments), out, doubts)


def _title(arguments: Evaluate) -> str:
    names = [parse_path(file).name for file in arguments.file]
    return names[0] if len(names) == 1 else f"{names[0]} ... {names[-1]}"


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
