"""Section on the quality of grasps: the number that hold, the failure reasons, the best and the worst by name."""

import math
from collections.abc import Sequence

from jaxgrasp.batch.rankings import MARGIN, Ranked, ranking_title, without_rounding
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.batch.summary import Summary
from jaxgrasp.batch.summary_text import times_harder
from jaxgrasp.report.cases import DrawnCases
from jaxgrasp.report.look import counted, degrees, format_count, method_title, number, share, table, text

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
