"""Page of an experiment in one offline file: psychometric functions, JNDs, Weber fractions, staircases."""

import os
from pathlib import Path

import numpy as np

from jaxgrasp.files.replace import replace_file
from jaxgrasp.psychophysics.analysis.cell import Cell
from jaxgrasp.psychophysics.analysis.experiment import Analysis
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.report import experiment_figures as figures
from jaxgrasp.report.bundle import page_html
from jaxgrasp.report.look import NOTHING, counted, number, percentage, table, text
from jaxgrasp.report.sections import figure_html


def write_experiment_page(path: str | os.PathLike, found: Analysis) -> None:
    """Write the page of an experiment, whole or not at all.

    Args:
        path: the HTML file to write.
        found: analysis of the answers.

    Raises:
        ImportError: plotly is not installed.
    """
    page = experiment_html(found)
    replace_file(Path(path), lambda stream: stream.write(page.encode()))


def experiment_html(found: Analysis) -> str:
    """Return the HTML page of an analysed experiment."""
    unit = found.plan.stimulus.unit
    if found.matched:
        parts = [("settings", "Settings", _settings(found, unit))]
    else:
        parts = [("answers", "Answers", _answers(found, unit))]
        parts.append(("references", "References", _references(found)))
    if found.traces:
        parts.append(("staircases", "Staircases", _staircases(found, unit)))
    parts.append(("notes", "What is to be known", _notes(found)))
    body = "\n".join(f'<section id="{name}"><h2>{head}</h2>{content}</section>' for name, head, content in parts)
    lead = f"{counted(len(found.subjects), 'person')}, {found.plan.method}, {found.plan.stimulus.kind} [{unit}]."
    top = f'<header><h1>{text(found.plan.name)}</h1><p class="lead">{text(lead)}</p></header>'
    return page_html(found.plan.name, f"{top}\n{body}", "page.js")


def _answers(found: Analysis, unit: str) -> str:
    settings, model = found.settings, found.settings.model
    assert model is not None
    note = (
        f"All persons' answers together, as if one person's: hit ratios with {percentage(settings.coverage)} "
        f"intervals (Wilson's), the function of "
        f"largest likelihood where the method has one ({text(model.shape)}), and the threshold at a hit ratio "
        f"of {model.criterion:g} with its interval. Intervals that would cover each other stand a little apart."
    )
    figure = figure_html("psychometric", figures.psychometric(found.pooled, model, unit))
    head = ["who", f"reference [{text(unit)}]", "threshold", "interval", "JND", "trials", "cut", "the other way", "fit"]
    cells = (*found.pooled, *found.cells)
    rows = [_row(cell) for cell in cells]
    if any(cell.threshold.finding is not Finding.FOUND for cell in cells):
        head.append("what it means")
        rows = [
            [*row, f'<span class="wide narrow">{text(cell.remark)}</span>']
            for row, cell in zip(rows, cells, strict=True)
        ]
    about = (
        "Cut: trials in which the device cut a torque; the other way: the threshold with these where they are left "
        "out, and without them where they are counted."
    )
    below = f'<p class="note">{about}</p>{_persons(found, unit)}{_detection(found)}'
    return f'<p class="note">{note}</p>{figure}{table(head, rows)}{below}'


def _persons(found: Analysis, unit: str) -> str:
    """Return a psychometric figure of all persons for each reference; empty if levels follow the answers."""
    model = found.settings.model
    if found.plan.procedure.follows_answers or len(found.subjects) < 2 or model is None:
        return ""
    drawn = []
    for k, reference in enumerate(found.plan.session.references):
        own = tuple(cell for cell in found.cells if cell.reference == reference and len(cell.counts.levels))
        if not own:
            continue
        name = f"{reference:g} {unit}" if reference > 0 else "detection"
        figure = figures.psychometric(own, model, unit, of_persons=True)
        drawn.append(f"<h3>{text(name)}</h3>{figure_html(f'persons-{k}', figure)}")
    return f"<h3>Each person</h3>{''.join(drawn)}"


def _row(cell: Cell) -> list[str]:
    one = cell.threshold
    fit = f"p = {number(cell.fit.p_value, 2)}" if cell.fit is not None else ""
    return [
        text(cell.subject),
        f"{cell.reference:g}",
        number(one.value),
        NOTHING if one.finding is Finding.NO_TRIALS else f"{number(one.low)} to {number(one.high)}",
        number(cell.weber.jnd) if cell.weber is not None else "",
        str(int(cell.counts.trials.sum())),
        str(cell.saturated or ""),
        number(cell.with_others.value) if cell.with_others is not None else "",
        fit,
    ]


def _detection(found: Analysis) -> str:
    if not any(cell.sensitivities for cell in found.pooled):
        return ""
    rows = [
        [
            f"{cell.reference:g}",
            f"{level:g}",
            number(round(view.d_prime, 6)),
            f"{number(view.low)} to {number(view.high)}",
            number(round(view.lean, 6), 2),
        ]
        for cell in found.pooled
        for level, view in cell.sensitivities
    ]
    head = ["reference", "level", "d\N{PRIME}", "interval", "criterion c (towards the second)"]
    return f"<details><summary>Signal detection: d\N{PRIME} and bias</summary>{table(head, rows)}</details>"


def _references(found: Analysis) -> str:
    unit = found.plan.stimulus.unit
    drawn = [
        f'<div class="panel3"><h3>{title}</h3>{figure_html(part, figure)}</div>'
        for part, title in (("jnd", "Just noticeable difference"), ("fraction", "Weber fraction"))
        if (figure := figures.by_reference(found, part, unit)) is not None
    ]
    if not drawn:
        return '<p class="note">No reference has a threshold.</p>'
    return f'<div class="three">{"".join(drawn)}</div>{_groups(found)}{_variance(found)}'


def _groups(found: Analysis) -> str:
    rows = [
        [f"{g.reference:g}", number(g.mean), number(g.deviation), number(g.error), f"{g.persons} of {g.of}"]
        for g in found.groups
    ]
    head = ["reference", "mean of persons' thresholds", "deviation", "standard error", "persons with a threshold"]
    return table(head, rows)


def _variance(found: Analysis) -> str:
    comparison = found.comparison
    if comparison is None:
        return ""
    rows = [
        [
            name,
            f"F[{one.between:g}, {one.within:g}] = {number(one.f)}",
            number(one.p_value),
            number(one.corrected_p_value) if np.isfinite(one.corrected_p_value) else "",
            number(one.generalized_eta_squared),
        ]
        for name, one in (("the same persons", comparison.within), ("as if different ones", comparison.between))
    ]
    head = ["analysis of variance", "F", "p", "p corrected for sphericity", "generalized η²"]
    pairs = [
        [
            " less ".join(f"{comparison.references[k]:g}" for k in pair.groups),
            number(pair.difference),
            number(pair.p_value),
            number(pair.effect),
        ]
        for pair in comparison.pairs
    ]
    below = table(["references", "difference", "p (Holm)", "d<sub>z</sub>"], pairs)
    return table(head, rows) + below


def _settings(found: Analysis, unit: str) -> str:
    rows = [
        [
            text(one.subject),
            f"{one.reference:g}",
            str(one.settings),
            f"{number(one.error)} ({number(one.error_low)} to {number(one.error_high)})",
            f"{number(one.deviation)} ({number(one.deviation_low)} to {number(one.deviation_high)})",
            number(one.jnd),
        ]
        for one in found.matched
    ]
    head = ["who", f"reference [{text(unit)}]", "settings", "constant error", "deviation", "JND"]
    return table(head, rows)


def _staircases(found: Analysis, unit: str) -> str:
    rows = [
        [text(one.subject), f"{one.reference:g}", number(one.turning_points), number(one.target), str(len(one.levels))]
        for one in found.traces
    ]
    head = ["who", "reference", "mean of turning points", "at a hit ratio of", "trials"]
    return figure_html("staircases", figures.staircases(found.traces, unit)) + table(head, rows)


def _notes(found: Analysis) -> str:
    settings = found.settings
    least, most = settings.model.lapse if settings.model is not None else (0.0, 0.0)
    word = "left out" if settings.saturated == "exclude" else "counted"
    how = f"Method {settings.method}; lapses {least:g} to {most:g}; saturated trials {word}."
    points = [how, *(f"{note}." for note in found.notes)]
    return "<ul>" + "".join(f"<li>{text(point)}</li>" for point in points) + "</ul>"
