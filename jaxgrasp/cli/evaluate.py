"""``jaxgrasp evaluate``: from a file of grasps to results, a summary and a report."""

import json
import math
from dataclasses import asdict
from itertools import product
from pathlib import Path

from tqdm import tqdm

from jaxgrasp.batch.arrow import arrow_library
from jaxgrasp.batch.hints import hints
from jaxgrasp.batch.result_table import SMALL_TABLE, first_rows, write_table
from jaxgrasp.batch.shards import ResultFolder, held_folder
from jaxgrasp.batch.sources import Adjustments
from jaxgrasp.batch.stream import StreamPlan, StreamResult, evaluate_stream
from jaxgrasp.batch.summary_json import to_json
from jaxgrasp.batch.summary_text import summary_text
from jaxgrasp.cli.data import data_path, opened
from jaxgrasp.cli.evaluate_arguments import Evaluate
from jaxgrasp.cli.machine import provenance, set_up_jax
from jaxgrasp.cli.terminal import announce, show
from jaxgrasp.files.replace import replace_file
from jaxgrasp.quality.measures import measures_named


def evaluate_command(arguments: Evaluate) -> int:
    """Evaluate once, or once for each swept value of friction and squeeze."""
    if arguments.chunk < 1:
        raise ValueError(f"chunk is {arguments.chunk}: expected a number of grasps, 1 or more")
    for name in ("friction", "squeeze"):
        _check_values(name, getattr(arguments, name))
    if arguments.torsion is not None:
        _check_values("torsion", (arguments.torsion,))
    measures_named(_asked(arguments))
    if arguments.table == "parquet":
        arrow_library()
    set_up_jax(arguments.dtype)
    sweeping = len(arguments.friction) > 1 or len(arguments.squeeze) > 1
    for friction, squeeze in product(arguments.friction or (None,), arguments.squeeze or (None,)):
        adjustments = Adjustments(arguments.normals == "outward", friction, squeeze, arguments.torsion)
        folder = arguments.out
        if sweeping:
            label = "-".join(f"{name}-{value!r}" for name, value in adjustments.fill.items())
            folder = folder / label
            show(f"\n== {label} ==")
        _evaluate_one(arguments, adjustments, folder)
    return 0


def _asked(arguments: Evaluate) -> tuple[str, ...]:
    return tuple(name for part in arguments.quality.split(",") if (name := part.strip()))


def _check_values(name: str, values: tuple[float, ...]) -> None:
    for index, value in enumerate(values):
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name}[{index}] is {value}: expected a finite number, zero or more")
        if value in values[:index]:
            raise ValueError(f"{name}[{index}] is {value}, for the second time: expected different values")


def _evaluate_one(arguments: Evaluate, adjustments: Adjustments, out: Path) -> None:
    quality = _asked(arguments)
    plan = StreamPlan(
        arguments.methods,
        arguments.chunk,
        arguments.dtype,
        arguments.skip_bad,
        adjustments,
        quality,
        arguments.least_friction,
    )
    path = data_path(arguments)
    with held_folder(out, announce), opened(arguments, adjustments) as source:
        identity = plan.identity(path.name, source)
        folder = ResultFolder(out, identity, arguments.resume, arguments.overwrite)
        with tqdm(total=len(source), unit=" grasps", initial=folder.done, disable=None, leave=False) as bar:
            outcome = evaluate_stream(source, plan, folder, bar.update, announce)
        show(summary_text(outcome.summary, outcome.times, outcome.seconds))
        doubts = hints(source, plan, outcome.summary)
        for hint in doubts:
            show(f"hint: {hint}")
        # A resumed evaluation that was finished already has nothing new to say, and no times.
        if outcome.times.problems or not (out / "summary.json").exists():
            _write_summary(out / "summary.json", outcome, arguments, doubts)
        _write_table(folder, outcome.summary.problems, arguments.table)
        show(f"results: {out}")
        if arguments.report:
            _write_report(out / "report.html", path, outcome, arguments, folder, doubts)


def _write_summary(path: Path, outcome: StreamResult, arguments: Evaluate, doubts: list[str]) -> None:
    content = {
        "summary": to_json(outcome.summary),
        "times": asdict(outcome.times),
        "seconds": outcome.seconds,
        "details": _details(arguments),
        "hints": doubts,
    }
    replace_file(path, lambda stream: stream.write(json.dumps(content).encode()))


def _write_table(folder: ResultFolder, rows: int, kind: str) -> None:
    if kind == "none":
        return
    if kind == "auto" and rows > SMALL_TABLE:
        show(f"no table of {rows:,} rows: --table csv or --table parquet writes it")
        return
    path = folder.folder / f"results.{'csv' if kind == 'auto' else kind}"
    write_table(path, folder.shards())
    show(f"table:   {path}")


def _write_report(
    path: Path, data: Path, outcome: StreamResult, arguments: Evaluate, folder: ResultFolder, doubts: list[str]
) -> None:
    from jaxgrasp.report.grasp_table import MOST_ROWS
    from jaxgrasp.report.page import write_report

    rows = first_rows(folder.shards(), MOST_ROWS)
    details = _details(arguments)
    try:
        write_report(path, outcome.summary, outcome.times, title=data.name, details=details, rows=rows, hints=doubts)
    except ImportError as error:
        show(f"no report: {error}")
    else:
        show(f"report:  {path}")


def _details(arguments: Evaluate) -> dict[str, str]:
    return {
        "input": data_path(arguments).name,
        "normals": arguments.normals,
        "methods": ", ".join(arguments.methods),
        "precision": arguments.dtype,
        **provenance(),
    }
