"""The cases of the report: one scene at a time with its forces, the highest prices, and a table of every grasp.

The grasps that the report draws, each once, however many tables name it. The page's own script sorts and filters the
table of every grasp.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from jaxgrasp.batch.chunk_statistics import case_title
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary
from jaxgrasp.report.bundle import embedded
from jaxgrasp.report.grasp_in_3d import Case, answers, scale_text, scene
from jaxgrasp.report.look import (
    METHOD_COLOURS,
    NOTHING,
    counted,
    degrees,
    format_count,
    number,
    percentage,
    swatch,
    table,
    text,
)

LONGEST_TITLE = 36
"""Characters of a grasp's name that a button shows."""
WORTH_DROPPING = 8
"""Characters of a start that all names share, from which on it is dropped."""
SEPARATORS = "/\\_-:,. "
ELLIPSIS = "\N{HORIZONTAL ELLIPSIS}"


@dataclass
class DrawnCases:
    """Cases in the order in which they are drawn; tables refer to them by buttons."""

    several: bool
    """True if grasps have several wrenches, so that each wrench must be named."""
    cases: list[dict] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)
    """Heading under which each case is listed."""
    _indices: dict[tuple[int, int], int] = field(default_factory=dict)

    def add(self, case: dict, group: str) -> int:
        """Add a case to a group and return its index; a case that is already drawn keeps its group and index."""
        key = (case["grasp"], case["wrench_number"])
        if key not in self._indices:
            self._indices[key] = len(self.cases)
            self.cases.append(case)
            self.groups.append(group)
        return self._indices[key]

    def index_of(self, grasp: int, wrench: int) -> int | None:
        return self._indices.get((grasp, wrench))

    def title(self, case: dict) -> str:
        return case_title(case, self.several)

    def pick(self, case: dict) -> str:
        """Return a button with the grasp's name, shortened, that shows it."""
        return self.pick_of(self._indices[case["grasp"], case["wrench_number"]], self.title(case))

    def pick_of(self, index: int, title: str) -> str:
        """Return a button that shows the case of this index; its title is short, and complete in the tooltip."""
        return pick(index, title, short_title(title, self.shared_start))

    @cached_property
    def shared_start(self) -> str:
        """Start that all titles share, as in an imported set; cached, so read it after the last `add`."""
        return shared_start([self.title(case) for case in self.cases])

    @staticmethod
    def of(summary: Summary) -> "DrawnCases":
        """Collect the cases to draw: failing grasps, both ends of each ranking, the highest prices of friction."""
        drawn = DrawnCases(summary.problems != summary.grasps)
        if summary.ranked is not None:
            for case in summary.ranked.examples.get(Reason.HARDER.name, []):
                drawn.add(case, Reason.HARDER.title)
            for reason, _ in summary.ranked.failing:
                for case in summary.ranked.examples.get(reason.name, []):
                    drawn.add(case, f"does not hold: {reason.title}")
            for name, ranking in summary.ranked.rankings.items():
                for end, cases in ranking.ends():
                    for case in cases:
                        drawn.add(case, f"{end} by {name}")
        for case in summary.worst:
            drawn.add(case, "highest price of friction")
        return drawn


def pick(index: int, title: str, shown: str | None = None) -> str:
    """Return a button that shows the case of this index; ``shown`` is a shorter title for the button."""
    if shown is None or shown == title:
        return f'<button type="button" class="pick" data-case="{index}">{text(title)}</button>'
    return f'<button type="button" class="pick" data-case="{index}" title="{text(title)}">{text(shown)}</button>'


def shared_start(titles: Sequence[str]) -> str:
    """Return the start that all titles share, up to the last separator of words; empty if it is short."""
    if len(set(titles)) < 2:
        return ""
    # The first and the last in order differ as early as any two do.
    pairs = zip(min(titles), max(titles), strict=False)
    start = min(titles)[: next((k for k, (first, last) in enumerate(pairs) if first != last), None)]
    start = start[: max((start.rfind(separator) for separator in SEPARATORS), default=-1) + 1]
    return start if len(start) >= WORTH_DROPPING else ""


def short_title(title: str, start: str = "") -> str:
    """Return a title without the start that all share, and without its middle where it is long: its end tells it."""
    short = ELLIPSIS + title[len(start) :] if start and title.startswith(start) else title
    if len(short) <= LONGEST_TITLE:
        return short
    head = LONGEST_TITLE // 3
    return short[:head] + ELLIPSIS + short[len(short) - (LONGEST_TITLE - head - 1) :]


def cases_html(drawn: DrawnCases, around: Sequence[dict] = ()) -> str:
    """Return the section that shows a grasp at a time; ``around`` are traces of each scene's surroundings."""
    if not drawn.cases:
        return "<p class='note'>Nothing to show.</p>"
    cases = [Case(case) for case in drawn.cases]
    choices = "".join(
        f'<optgroup label="{text(group)}">'
        + "".join(
            f'<option value="{i}">{text(short_title(drawn.title(drawn.cases[i]), drawn.shared_start))}</option>'
            for i in members
        )
        + "</optgroup>"
        for group, members in _by_group(drawn).items()
    )
    panels = "".join(_panel(i, case, drawn) for i, case in enumerate(cases))
    warm, cool = (
        "".join(swatch(METHOD_COLOURS[name + end]) for name in dict.fromkeys(case.name for case in cases))
        for end in ("", "-optimum")
    )
    intro = (
        f"Arrows are what the hand exerts on the object, by the closed form {warm} and by its optimum {cool}. Each "
        "cone holds the forces that friction allows: an arrow outside its cone slips, one that points away from it "
        "pulls."
    )
    return f"""<p class="note">{intro}</p>
<div class="chooser"><button type="button" id="before" aria-label="previous case">&lsaquo;</button>
<select id="case" aria-label="case">{choices}</select>
<button type="button" id="after" aria-label="next case">&rsaquo;</button>
<span class="note">Drag to turn, scroll to zoom, hover for numbers, click the legend to hide.</span></div>
<div class="case"><div id="scene" class="figure"></div><div>{panels}</div></div>
{embedded("scenes", [scene(case, around) for case in cases])}"""


def _by_group(drawn: DrawnCases) -> dict[str, list[int]]:
    groups: dict[str, list[int]] = {}
    for index, group in enumerate(drawn.groups):
        groups.setdefault(group, []).append(index)
    return groups


def worst_html(summary: Summary, drawn: DrawnCases) -> str:
    """Return the section with the table of the highest prices of friction."""
    if not summary.worst:
        return (
            "<p class='note'>Nothing to show: no closed form was compared with its optimum, or each one that was "
            "compared is the optimum.</p>"
        )
    intro = (
        f"The {counted(len(summary.worst), 'problem')} of the highest price of friction, by closed form "
        f"{summary.worst[0]['method']}. A price near 100% often means a wrench near the limit of what friction can "
        "hold, where the optimum has to squeeze hard."
    )
    return f'<p class="note">{intro}</p>{_overview(summary.worst, drawn)}'


def _overview(cases: list[dict], drawn: DrawnCases) -> str:
    names = [name for name in dict.fromkeys(name for case in cases for name in case["labels"]) if name != "name"]
    values = {name: [case["labels"].get(name, "") for case in cases] for name in names}
    # A text that all rows share says nothing about any of them: it stands once, below the table.
    common = {name: texts[0] for name, texts in values.items() if len(set(texts)) == 1}
    labels = [name for name in names if name not in common]
    head = [
        "grasp",
        "number",
        *(f'<span class="label">{text(name)}</span>' for name in labels),
    ]
    head += ["contacts", "price of friction", "smallest friction margin", "largest cone violation"]
    rows = []
    for case in cases:
        row = [drawn.pick(case), str(case["grasp"])]
        row += [_label(case["labels"].get(name, "")) for name in labels]
        row += [
            str(len(case["points"])),
            percentage(case["price"]),
            NOTHING if case["margin"] is None else degrees(case["margin"]),
            NOTHING if case["violation"] is None else f"{number(case['violation'])} N",
        ]
        rows.append(row)
    shared = "".join(f"All have the {text(name)} {text(value)}. " for name, value in common.items() if value)
    return table(head, rows, "overview") + (
        f"<p class='note'>{shared}Grasps are numbered from 0, in the order of the input. Margin: friction angle less "
        "slip angle, of the closed form's worst contact. Violation: its tangential force beyond friction's limit.</p>"
    )


def _label(value: str) -> str:
    """Return a label without its middle where it is long, and complete in the tooltip."""
    short = short_title(value)
    whole = f' title="{text(value)}"' if short != value else ""
    return f'<span class="label"{whole}>{text(short)}</span>'


def _panel(index: int, case: Case, drawn: DrawnCases) -> str:
    """Return the panel beside a case's scene: wrench, scale, largest forces, and a table of its contacts."""
    force, torque = case.wrench[:3], case.wrench[3:]
    facts = [
        f"<b>Wrench</b> force ({_vector(force)}) N, torque ({_vector(torque)}) N·m about the origin.",
        f"<b>Arrows</b> {scale_text(case)}",
        "<b>Largest force</b> "
        + (", ".join(f"{title} {_largest(forces)} N" for title, forces in answers(case)) or "none, by no answer")
        + ".",
    ]
    closed, optimum = case.angles(case.closed), case.angles(case.optimum)
    limit = np.arctan(case.friction)
    rows = [
        [
            str(i + 1),
            degrees(limit[i]),
            number(case.squeeze[i]),
            number(float(np.linalg.norm(case.closed[i]))),
            _slip(closed[i], limit[i]),
            number(float(np.linalg.norm(case.optimum[i]))),
            _slip(optimum[i], limit[i]),
        ]
        for i in range(len(case.points))
    ]
    warm, cool = swatch(METHOD_COLOURS[case.name]), swatch(METHOD_COLOURS[case.name + "-optimum"])
    head = [
        "contact",
        "friction angle",
        "squeeze [N]",
        *(f'<span class="name">{s}{t}</span>' for s in (warm, cool) for t in ("|f| [N]", "slip")),
    ]
    hidden = " hidden" if index else ""
    lines = "".join(f"<p>{fact}</p>" for fact in facts)
    title = f"<h3>{text(drawn.title(drawn.cases[index]))}: {text(drawn.groups[index])}</h3>"
    return f'<div class="panel" data-case="{index}"{hidden}>{title}{lines}{table(head, rows, "contacts")}</div>'


def _slip(slip: float, limit: float) -> str:
    if np.isnan(slip):
        return "no load"
    # An optimum's contact on the surface of its cone has the friction angle itself, to rounding.
    over = slip > limit + 1e-6
    return f'<span class="over">{degrees(slip)}</span>' if over else degrees(slip)


def _vector(vector: np.ndarray) -> str:
    return ", ".join(number(float(v)) for v in vector)


def _largest(forces: np.ndarray) -> str:
    return number(float(np.linalg.norm(forces, axis=1).max()))


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
