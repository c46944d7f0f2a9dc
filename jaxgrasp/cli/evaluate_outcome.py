"""Output of an evaluation beside its results: the summary, on screen and in a file, and the report."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from jaxgrasp.batch.hints import hints
from jaxgrasp.batch.sources import GraspSource
from jaxgrasp.batch.stream import StreamPlan, StreamResult
from jaxgrasp.batch.summary_json import to_json
from jaxgrasp.batch.summary_text import summary_text
from jaxgrasp.cli.evaluate_arguments import Evaluate
from jaxgrasp.cli.machine import provenance
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import replace_file


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
    from jaxgrasp.report.grasp_table import MOST_ROWS
    from jaxgrasp.report.page import write_report

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
