"""Report of an evaluation in one HTML file that opens offline, whatever the size of the data.

Section on the quality of grasps: the number that hold, the failure reasons, the best and the worst by name.
"""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxgrasp.batch.chunk_statistics import MARGIN, Ranked, ranking_title, without_rounding
from jaxgrasp.batch.engine import Times
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary
from jaxgrasp.batch.summary_text import WHAT_A_AND_B_ARE, times_harder
from jaxgrasp.files.replace import replace_file
from jaxgrasp.report import sections
from jaxgrasp.report.bundle import page_html
from jaxgrasp.report.look import counted, degrees, format_count, method_title, number, share, table, text
from jaxgrasp.report.sections import comparing_tiles, holding_tiles, tiles_html
from jaxgrasp.report.worst_cases import DrawnCases, cases_html, grasp_table_html, worst_html

MEANINGS = {
    MARGIN: "friction angle less slip angle of the closed form's worst contact; below zero it slips",
    "least friction": "the factor on its friction that is just enough, if it exerts the normal forces that it means to "
    "exert, all together; above 1 it has to press harder than that",
}


def which_hold_html(summary: Summary, drawn: DrawnCases, hints: Sequence[str] = ()) -> str:
    """Return the HTML section; ``hints`` name possible faults in the data."""
    ranked = summary.ranked
    if ranked is None or not summary.problems:
        return "<p class='note'>Nothing was evaluated.</p>"
    unit = "problem" if drawn.several else "grasp"
    lead = (
        f"<p><b>{format_count(ranked.holds)} of {counted(summary.problems, unit)} hold</b> "
        f"({share(ranked.holds, summary.problems)}), as {text(method_title(ranked.judge))} says. "
        f"{_harder(ranked, drawn)}A button shows its grasp below.</p>"
    )
    doubts = "".join(f'<p class="note"><b>Hint:</b> {text(hint)}</p>' for hint in hints)
    return lead + doubts + _failing(ranked, summary, drawn) + _rankings(ranked, drawn)


def _harder(ranked: Ranked, drawn: DrawnCases) -> str:
    """Return the sentence about problems that hold if the hand squeezes harder; nothing where there are none."""
    if not ranked.harder:
        return ""
    cases = ranked.examples.get(Reason.HARDER.name, [])
    named = ", ".join(
        f"{drawn.pick(case)} {times_harder(case.get('squeeze_factor', math.nan))} times" for case in cases
    )
    return f"<b>{format_count(ranked.harder)} more if the hand squeezes harder</b> than it means to: {named}. "


def _failing(ranked: Ranked, summary: Summary, drawn: DrawnCases) -> str:
    if not ranked.failing:
        return ""
    rows = [
        [
            text(reason.title),
            f"{format_count(count)} ({share(count, summary.problems)})",
            " ".join(drawn.pick(case) for case in ranked.examples.get(reason.name, [])),
            f'<span class="wide">{text(reason.advice)}</span>',
        ]
        for reason, count in ranked.failing
    ]
    head = ["what keeps them from holding", "", "for example", "<span class='wide'>what it means</span>"]
    return table(head, rows, "reasons")


def _rankings(ranked: Ranked, drawn: DrawnCases) -> str:
    parts = []
    for name, ranking in ranked.rankings.items():
        ends = [cases for _, cases in ranking.ends()]
        if not any(ends):
            continue
        n_rows = max(map(len, ends))
        rows = []
        for k in range(n_rows):
            row = [str(k + 1)]
            for end in ends:
                row += [drawn.pick(end[k]), ranked_value(name, end[k]["value"])] if k < len(end) else ["", ""]
            rows.append(row)
        meaning = f'<p class="note">{text(MEANINGS[name])}</p>' if name in MEANINGS else ""
        body = table(["", "best", "", "worst", ""], rows, "ranking")
        parts.append(f'<div class="panel3"><h3>By {text(ranking_title(name))}</h3>{meaning}{body}</div>')
    return f'<div class="three rankings">{"".join(parts)}</div>'


def ranked_value(name: str, value: float) -> str:
    return degrees(value) if name == MARGIN else number(without_rounding(value))


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
