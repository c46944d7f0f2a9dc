"""Report of an evaluation in one HTML file that opens offline, whatever the size of the data."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxgrasp.batch.engine import Times
from jaxgrasp.batch.summary import Summary
from jaxgrasp.batch.summary_text import WHAT_A_AND_B_ARE
from jaxgrasp.files.replace import replace_file
from jaxgrasp.report import sections
from jaxgrasp.report.bundle import page_html
from jaxgrasp.report.cases import DrawnCases
from jaxgrasp.report.grasp_table import grasp_table_html
from jaxgrasp.report.headline import comparing_tiles, holding_tiles, tiles_html
from jaxgrasp.report.look import counted, text
from jaxgrasp.report.which_hold import which_hold_html
from jaxgrasp.report.worst_cases import cases_html, worst_html


def write_report(
    path: str | os.PathLike,
    summary: Summary,
    times: Times,
    *,
    title: str,
    details: dict[str, str],
    rows: Mapping[str, np.ndarray] | None = None,
    hints: Sequence[str] = (),
) -> None:
    """Write the report of an evaluation, whole or not at all.

    Args:
        path: the HTML file to write.
        summary: what was found.
        times: what it took.
        title: the page's heading.
        details: names and texts that say where the numbers come from: input, versions, date, command.
        rows: every grasp, or the first ones, by columns as ``Evaluation.table()`` has them.
        hints: what may be wrong with the data, in sentences.

    Raises:
        ImportError: plotly is not installed.
    """
    page = report_html(summary, times, title=title, details=details, rows=rows, hints=hints)
    replace_file(Path(path), lambda stream: stream.write(page.encode()))


def report_html(
    summary: Summary,
    times: Times,
    *,
    title: str,
    details: dict[str, str],
    rows: Mapping[str, np.ndarray] | None = None,
    hints: Sequence[str] = (),
) -> str:
    """Return the HTML page: first the grasps that hold and the best, then closed forms against their optima."""
    drawn = DrawnCases.of(summary)
    comparison = tiles_html(comparing_tiles(summary)) + f'<p class="note">{WHAT_A_AND_B_ARE}</p>'
    parts = (
        ("good", "Which grasps hold, and which are the best", which_hold_html(summary, drawn, hints)),
        ("cases", "One grasp at a time", cases_html(drawn)),
        ("all", "All grasps", grasp_table_html(rows, summary.problems, drawn)),
        ("quality", "Quality", sections.qualities_html(summary)),
        ("comparison", "Closed forms and their optima", comparison),
        ("verdicts", "Verdicts", sections.verdicts_html(summary)),
        ("distributions", "How far the closed forms are from their optima", sections.distributions_html(summary)),
        ("angles", "Slip angle against friction angle", sections.angles_html(summary)),
        ("worst", "Where the closed form is furthest from its optimum", worst_html(summary, drawn)),
        ("times", "Time and accuracy", sections.times_html(summary, times)),
        ("details", "Details", sections.details_html(details)),
    )
    body = "\n".join(f'<section id="{name}"><h2>{heading}</h2>{content}</section>' for name, heading, content in parts)
    top = f'<header><h1>{text(title)}</h1><p class="lead">{_lead(summary)}</p></header>'
    return page_html(title, f"{top}\n{tiles_html(holding_tiles(summary))}\n{body}", "table.js", "page.js")


def _lead(summary: Summary) -> str:
    """Return a sentence with the numbers of evaluated grasps, contacts and problems."""
    used_sizes = np.flatnonzero(summary.sizes)
    contacts_each = ""
    if len(used_sizes):
        contacts_each = (
            f", {used_sizes[0]} each" if len(used_sizes) == 1 else f", {used_sizes[0]} to {used_sizes[-1]} each"
        )
    sentence = f"{counted(summary.grasps, 'grasp')} with {counted(summary.contacts, 'contact')}{contacts_each}"
    if summary.problems != summary.grasps:
        sentence += f"; {counted(summary.problems, 'problem')}, one for each grasp and wrench"
    if summary.set_aside:
        sentence += f"; {counted(summary.set_aside, 'grasp')} set aside for faults in the data"
    return sentence + "."
