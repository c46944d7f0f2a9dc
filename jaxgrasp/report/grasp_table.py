"""Every grasp in a table that a reader sorts and filters; the page's own script does both."""

import math
import re
from collections.abc import Mapping

import numpy as np

from jaxgrasp.report.look import NOTHING, counted, format_count, number, percentage, text
from jaxgrasp.report.worst_cases import DrawnCases, short_title

MOST_ROWS = 2_000
"""A page with more is slow to open; the table beside the results has all."""
HEADINGS = {
    "margin_deg": "margin [°]",
    "price": "price",
    "least_friction": "least friction",
    "squeeze_factor": "squeeze factor",
}


def grasp_table_html(rows: Mapping[str, np.ndarray] | None, problems: int, drawn: DrawnCases) -> str:
    """Return the HTML section of the table, from the columns of ``batch.result_table``."""
    if rows is None or not len(rows["grasp"]):
        return "<p class='note'>No table was made.</p>"
    count = min(len(rows["grasp"]), MOST_ROWS)
    shown = [name for name in rows if _is_shown(name)]
    head = "".join(map(_heading_html, shown))
    lines = [_line(rows, shown, k, drawn) for k in range(count)]
    selection_note = (
        f"The first {format_count(count)} of {format_count(problems)} rows; "
        "results.csv, which --table csv writes, has all. "
        if count < problems
        else ""
    )
    note = (
        f"{selection_note}Click a heading to sort, and again to reverse. Margin: friction angle less slip angle at the "
        "worst contact; below zero it slips. Price: the share of the optimum's objective that the closed form omits."
    )
    return f"""<p class="note">{note}</p>
<div class="chooser"><input type="search" id="filter" placeholder="filter by any text" aria-label="filter">
<select id="filter-holds" aria-label="which"><option value="">all</option><option value="yes">those that hold</option>
<option value="harder">those that hold if they squeeze harder</option>
<option value="no">those that do not</option><option value="unknown">those of which it is not known</option></select>
<span class="note" id="filtered">{counted(count, "row")}</span></div>
<div class="scroll tall"><table id="grasps"><thead><tr>{head}</tr></thead>
<tbody>{"".join(lines)}</tbody></table></div>"""


def _is_shown(name: str) -> bool:
    method, _, column = name.rpartition(".")
    if method in ("A", "B"):
        return column in ("margin_deg", "price")
    return not method.endswith("-optimum")


def _heading(name: str) -> str:
    method, _, column = name.rpartition(".")
    if method in ("A", "B"):
        return f"{method}: {HEADINGS[column]}"
    return HEADINGS.get(name, name)


def _heading_html(name: str) -> str:
    """Return the cell of a heading; lines may break behind points, so that it is no wider than the column's numbers."""
    words = re.sub("([._])", r"\1<wbr>", text(_heading(name)))
    title_class = ' class="title"' if name == "name" else ""
    return f'<th{title_class}><button type="button" class="sort">{words}</button></th>'


def _line(rows: Mapping[str, np.ndarray], shown: list[str], k: int, drawn: DrawnCases) -> str:
    wrench = int(rows["wrench"][k]) if "wrench" in rows else 0
    index = drawn.index_of(int(rows["grasp"][k]), wrench)
    cells = []
    for name in shown:
        value = rows[name][k].item()
        if isinstance(value, str):
            cells.append(_text_cell(value, index if name == "name" else None, drawn, name == "name"))
        elif isinstance(value, float) and math.isnan(value):
            cells.append(f"<td>{NOTHING}</td>")
        else:
            formatted = percentage(value) if name.endswith(".price") else number(value)
            cells.append(f'<td data-value="{value}">{formatted}</td>')
    # The filter looks for whole names, of which the cells may show a part.
    name = text(str(rows["name"][k])) if "name" in rows else ""
    return f'<tr data-holds="{rows["holds"][k]}" data-name="{name}">{"".join(cells)}</tr>'


def _text_cell(value: str, index: int | None, drawn: DrawnCases, is_name: bool) -> str:
    classes = "text title" if is_name else "text"
    if index is not None:
        return f'<td class="{classes}">{drawn.pick_of(index, value)}</td>'
    short = short_title(value, drawn.shared_start) if is_name else value
    whole_name = f' title="{text(value)}"' if short != value else ""
    return f'<td class="{classes}"{whole_name}>{text(short)}</td>'
