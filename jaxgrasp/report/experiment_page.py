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


def write_experiment_page(path: str | os.PathLike, analysis: Analysis) -> None:
    """Write the page of an experiment, whole or not at all.

    Args:
        path: the HTML file to write.
        analysis: of the answers.

    Raises:
        ImportError: plotly is not installed.
    """
    page = experiment_html(analysis)
    replace_file(Path(path), lambda stream: stream.write(page.encode()))


def experiment_html(analysis: Analysis) -> str:
    """Return the HTML page of an analysed experiment."""
    unit = analysis.plan.stimulus.unit
    if analysis.matched:
        parts = [("settings", "Settings", _settings(analysis, unit))]
    else:
        parts = [("answers", "Answers", _answers(analysis, unit))]
        parts.append(("references", "References", _references(analysis)))
    if analysis.traces:
        parts.append(("staircases", "Staircases", _staircases(analysis, unit)))
    parts.append(("notes", "Notes", _notes(analysis)))
    body = "\n".join(f'<section id="{name}"><h2>{head}</h2>{content}</section>' for name, head, content in parts)
    lead = (
        f"{counted(len(analysis.subjects), 'person')}, {analysis.plan.method}, {analysis.plan.stimulus.kind} [{unit}]."
    )
    top = f'<header><h1>{text(analysis.plan.name)}</h1><p class="lead">{text(lead)}</p></header>'
    return page_html(analysis.plan.name, f"{top}\n{body}", "page.js")


def _answers(analysis: Analysis, unit: str) -> str:
    settings, model = analysis.settings, analysis.settings.model
    assert model is not None
    note = (
        f"All persons' answers together, as if one person's: hit ratios with {percentage(settings.coverage)} "
        f"intervals (Wilson's), the function of "
        f"largest likelihood where the method has one ({text(model.shape)}), and the threshold at a hit ratio "
        f"of {model.criterion:g} with its interval. Intervals that would cover each other stand a little apart."
    )
    figure = figure_html("psychometric", figures.psychometric(analysis.pooled, model, unit))
    head = ["who", f"reference [{text(unit)}]", "threshold", "interval", "JND", "trials", "cut", "the other way", "fit"]
    cells = (*analysis.pooled, *analysis.cells)
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
    below = f'<p class="note">{about}</p>{_persons(analysis, unit)}{_detection(analysis)}'
    return f'<p class="note">{note}</p>{figure}{table(head, rows)}{below}'


def _persons(analysis: Analysis, unit: str) -> str:
    """Return a psychometric figure of all persons for each reference; empty if levels follow the answers."""
    model = analysis.settings.model
    if analysis.plan.procedure.follows_answers or len(analysis.subjects) < 2 or model is None:
        return ""
    drawn = []
    for k, reference in enumerate(analysis.plan.session.references):
        cells = tuple(cell for cell in analysis.cells if cell.reference == reference and len(cell.counts.levels))
        if not cells:
            continue
        name = f"{reference:g} {unit}" if reference > 0 else "detection"
        figure = figures.psychometric(cells, model, unit, of_persons=True)
        drawn.append(f"<h3>{text(name)}</h3>{figure_html(f'persons-{k}', figure)}")
    return f"<h3>Each person</h3>{''.join(drawn)}"


def _row(cell: Cell) -> list[str]:
    threshold = cell.threshold
    fit = f"p = {number(cell.fit.p_value, 2)}" if cell.fit is not None else ""
    return [
        text(cell.subject),
        f"{cell.reference:g}",
        number(threshold.value),
        NOTHING if threshold.finding is Finding.NO_TRIALS else f"{number(threshold.low)} to {number(threshold.high)}",
        number(cell.weber.jnd) if cell.weber is not None else "",
        str(int(cell.counts.trials.sum())),
        str(cell.saturated or ""),
        number(cell.alternative.value) if cell.alternative is not None else "",
        fit,
    ]


def _detection(analysis: Analysis) -> str:
    if not any(cell.sensitivities for cell in analysis.pooled):
        return ""
    rows = [
        [
            f"{cell.reference:g}",
            f"{level:g}",
            number(round(view.d_prime, 6)),
            f"{number(view.low)} to {number(view.high)}",
            number(round(view.lean, 6), 2),
        ]
        for cell in analysis.pooled
        for level, view in cell.sensitivities
    ]
    head = ["reference", "level", "d\N{PRIME}", "interval", "criterion c (towards the second)"]
    return f"<details><summary>Signal detection: d\N{PRIME} and bias</summary>{table(head, rows)}</details>"


def _references(analysis: Analysis) -> str:
    unit = analysis.plan.stimulus.unit
    drawn = [
        f'<div class="panel3"><h3>{title}</h3>{figure_html(part, figure)}</div>'
        for part, title in (("jnd", "Just noticeable difference"), ("fraction", "Weber fraction"))
        if (figure := figures.by_reference(analysis, part, unit)) is not None
    ]
    if not drawn:
        return '<p class="note">No reference has a threshold.</p>'
    return f'<div class="three">{"".join(drawn)}</div>{_groups(analysis)}{_variance(analysis)}'


def _groups(analysis: Analysis) -> str:
    rows = [
        [f"{g.reference:g}", number(g.mean), number(g.deviation), number(g.error), f"{g.persons} of {g.n_persons}"]
        for g in analysis.groups
    ]
    head = ["reference", "mean of persons' thresholds", "deviation", "standard error", "persons with a threshold"]
    return table(head, rows)


def _variance(analysis: Analysis) -> str:
    comparison = analysis.comparison
    if comparison is None:
        return ""
    rows = [
        [
            name,
            f"F[{anova.between:g}, {anova.within:g}] = {number(anova.f)}",
            number(anova.p_value),
            number(anova.corrected_p_value) if np.isfinite(anova.corrected_p_value) else "",
            number(anova.generalized_eta_squared),
        ]
        for name, anova in (("the same persons", comparison.within), ("as if different ones", comparison.between))
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


def _settings(analysis: Analysis, unit: str) -> str:
    rows = [
        [
            text(matched.subject),
            f"{matched.reference:g}",
            str(matched.settings),
            f"{number(matched.error)} ({number(matched.error_low)} to {number(matched.error_high)})",
            f"{number(matched.deviation)} ({number(matched.deviation_low)} to {number(matched.deviation_high)})",
            number(matched.jnd),
        ]
        for matched in analysis.matched
    ]
    head = ["who", f"reference [{text(unit)}]", "settings", "constant error", "deviation", "JND"]
    return table(head, rows)


def _staircases(analysis: Analysis, unit: str) -> str:
    rows = [
        [
            text(trace.subject),
            f"{trace.reference:g}",
            number(trace.turning_points),
            number(trace.target),
            str(len(trace.levels)),
        ]
        for trace in analysis.traces
    ]
    head = ["who", "reference", "mean of turning points", "at a hit ratio of", "trials"]
    return figure_html("staircases", figures.staircases(analysis.traces, unit)) + table(head, rows)


def _notes(analysis: Analysis) -> str:
    settings = analysis.settings
    least, most = settings.model.lapse if settings.model is not None else (0.0, 0.0)
    word = "left out" if settings.saturated == "exclude" else "counted"
    how = f"Method {settings.method}; lapses {least:g} to {most:g}; saturated trials {word}."
    points = [how, *(f"{note}." for note in analysis.notes)]
    return "<ul>" + "".join(f"<li>{text(point)}</li>" for point in points) + "</ul>"
