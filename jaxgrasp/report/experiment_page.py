"""Page of an experiment in one offline file: psychometric functions, JNDs, Weber fractions, staircases.

The figures are plotly's own JSON.
"""

import os
from pathlib import Path

import numpy as np

from jaxgrasp.files.replace import replace_file
from jaxgrasp.psychophysics.analysis.cell import Cell
from jaxgrasp.psychophysics.analysis.counts import ratio_intervals
from jaxgrasp.psychophysics.analysis.experiment import Analysis, Trace, WithinComparison
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.report.bundle import page_html
from jaxgrasp.report.figures import axis, layout
from jaxgrasp.report.look import INK, MUTED, NOTHING, counted, number, percentage, table, text
from jaxgrasp.report.sections import figure_html

COLOURS = ("#1f5fa8", "#b5541c", "#2f7d4f", "#7a4fa3", "#8a6d1d", "#5a6472")
"""Colours of references, in their order; the last for all others."""
POINTS = 120
APART_X, APART_Y = 0.01, 0.012
"""Offsets between neighbours' intervals: along levels as a share of the largest level (the width of a marker, less if
a point would come nearer to the next level than to its own), and along hit ratios."""


def colour(index: int) -> str:
    """Return the colour of a reference by its index in ascending order."""
    return COLOURS[min(index, len(COLOURS) - 1)]


def psychometric(cells: tuple[Cell, ...], model: Model, unit: str, *, of_persons: bool = False) -> dict:
    """Return a figure of hit ratios with their intervals, fitted functions, and thresholds at the criterion.

    Args:
        cells: one for each reference, or for each person.
        model: of the functions.
        unit: of the references.
        of_persons: name them by the person.
    """
    traces: list[dict] = []
    step = _offset_step([cell.counts.levels for cell in cells if len(cell.counts.levels)])
    for k, cell in enumerate(cells):
        if not len(cell.counts.levels):
            continue
        aside = k - (len(cells) - 1) / 2
        name = f"{cell.reference:g} {unit}" if cell.reference > 0 else "detection"
        name = cell.subject if of_persons else name
        traces.append(_ratios(cell, name, colour(k), step * aside))
        if cell.threshold.function is not None:
            levels = np.linspace(0, 1.1 * cell.counts.levels.max(), POINTS)
            chances = model.hit_probability(levels, cell.threshold.function)
            traces.append(_line(levels, chances, colour(k)))
        if np.isfinite(cell.threshold.value):
            traces.append(_threshold(cell, name, colour(k), APART_Y * aside))
    title = "difference from the reference, by the reference" if cells[0].reference > 0 else f"intensity [{unit}]"
    level = {"type": "line", "x0": 0, "x1": 1, "xref": "paper", "y0": model.criterion, "y1": model.criterion}
    shape = layout(
        420,
        xaxis=axis(title, rangemode="tozero"),
        yaxis=axis("hit ratio", range=[0.35, 1.02]),
        showlegend=True,
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        shapes=[level | {"line": {"color": MUTED, "width": 1, "dash": "dot"}}],
    )
    return {"data": traces, "layout": shape}


def _offset_step(levels: list[np.ndarray]) -> float:
    """Return the offset along the levels between the points of neighbouring cells, from the levels of each cell."""
    if not levels:
        return 0.0
    positions = np.unique(np.concatenate([np.zeros(1), *levels]))
    return min(APART_X * positions[-1], 0.8 * float(np.diff(positions).min()) / len(levels))


def by_reference(analysis: Analysis, part: str, unit: str) -> dict | None:
    """Plot JND (``"jnd"``, the paper's Fig. 9) or Weber fraction (``"fraction"``, Fig. 10), pooled and per person."""
    cells = [cell for cell in analysis.pooled if cell.weber is not None]
    if not cells:
        return None
    values = [getattr(cell.weber, part) for cell in cells]
    low, high = ([getattr(cell.weber, f"{part}_{end}") for cell in cells] for end in ("low", "high"))
    error_bars = {
        "type": "data",
        "symmetric": False,
        "array": [_finite(h - v) for h, v in zip(high, values, strict=True)],
        "arrayminus": [_finite(v - lower) for lower, v in zip(low, values, strict=True)],
    }
    everyone = {
        "type": "scatter",
        "mode": "markers",
        "name": "all persons",
        "x": [cell.reference for cell in cells],
        "y": values,
        "error_y": error_bars | {"color": INK, "thickness": 1.5},
        "marker": {"color": INK, "size": 9},
    }
    traces = [everyone, *_person_traces(analysis, part)]
    if analysis.line is not None:
        traces.append(_weber_line(analysis, part))
    title = f"JND [{unit}]" if part == "jnd" else "Weber fraction"
    top = max(traces[0]["y"]) if traces[0]["y"] else 1.0
    highest = max([top, *(y for trace in traces[1:] for y in trace["y"] if y is not None)])
    shape = layout(
        330,
        xaxis=axis(f"reference [{unit}]", range=[0, 1.15 * max(everyone["x"])]),
        yaxis=axis(title, range=[0, 1.25 * highest]),
        showlegend=True,
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    )
    return {"data": traces, "layout": shape}


def staircases(traces: tuple[Trace, ...], unit: str) -> dict:
    """Plot the level of each trial of each staircase; a filled marker is a right answer."""
    references = sorted({trace.reference for trace in traces})
    drawn = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "name": f"{trace.subject}, {trace.reference:g} {unit}",
            "x": list(range(1, len(trace.levels) + 1)),
            "y": [float(f"{level:.5g}") for level in trace.levels],
            "line": {"color": colour(references.index(trace.reference)), "width": 1, "shape": "hv"},
            "marker": {
                "size": 6,
                "color": [
                    colour(references.index(trace.reference)) if is_right else "#ffffff" for is_right in trace.right
                ],
                "line": {"width": 1, "color": colour(references.index(trace.reference))},
            },
        }
        for trace in traces
    ]
    shape = layout(
        360, xaxis=axis("trial of its staircase"), yaxis=axis("level", type="log"), showlegend=len(traces) <= 12
    )
    return {"data": drawn, "layout": shape}


def _ratios(cell: Cell, name: str, shade: str, aside: float) -> dict:
    ends = ratio_intervals(cell.counts, cell.threshold.coverage)
    ratios = cell.counts.ratios
    error_bars = {"type": "data", "symmetric": False, "color": shade, "thickness": 1, "width": 3}
    counted = zip(cell.counts.levels, cell.counts.hits, cell.counts.trials, strict=True)
    pairs = [f"level {level:.4g}: {k} of {n}" for level, k, n in counted]
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": (cell.counts.levels + aside).tolist(),
        "y": ratios.tolist(),
        "text": pairs,
        "hovertemplate": f"{name}, %{{text}}<extra></extra>",
        "error_y": error_bars | {"array": (ends[:, 1] - ratios).tolist(), "arrayminus": (ratios - ends[:, 0]).tolist()},
        "marker": {"color": shade, "size": 8},
    }


def _line(x: np.ndarray, y: np.ndarray, shade: str) -> dict:
    points = {
        "x": [float(f"{coordinate:.5g}") for coordinate in x],
        "y": [float(f"{coordinate:.5g}") for coordinate in y],
    }
    line = {"color": shade, "width": 2}
    return {"type": "scatter", "mode": "lines", **points, "line": line, "showlegend": False, "hoverinfo": "skip"}


def _threshold(cell: Cell, name: str, shade: str, aside: float) -> dict:
    threshold = cell.threshold
    error_bars = {"type": "data", "symmetric": False, "color": shade, "thickness": 2, "width": 5}
    error_bars |= {
        "array": [_finite(threshold.high - threshold.value)],
        "arrayminus": [_finite(threshold.value - threshold.low)],
    }
    marker = {"color": "#ffffff", "size": 9, "symbol": "diamond", "line": {"color": shade, "width": 2}}
    hover = f"{name}: threshold {threshold.value:.3f}<extra></extra>"
    point = {
        "x": [threshold.value],
        "y": [threshold.criterion + aside],
        "error_x": error_bars,
        "marker": marker,
        "hovertemplate": hover,
    }
    return {"type": "scatter", "mode": "markers", "showlegend": False, **point}


def _person_traces(analysis: Analysis, part: str) -> list[dict]:
    traces = []
    for subject in analysis.subjects:
        cells = [cell for cell in analysis.cells if cell.subject == subject and cell.weber is not None]
        points = {"x": [cell.reference for cell in cells], "y": [getattr(cell.weber, part) for cell in cells]}
        look = {"line": {"color": MUTED, "width": 1}, "marker": {"color": MUTED, "size": 5}}
        traces.append({"type": "scatter", "mode": "lines+markers", "name": subject, **points, **look})
    return traces if len(traces) <= 8 else []


def _weber_line(analysis: Analysis, part: str) -> dict:
    line = analysis.line
    assert line is not None
    largest = max(cell.reference for cell in analysis.pooled)
    x = np.linspace(largest / POINTS, 1.15 * largest, POINTS)
    jnd = line.limit * x + line.floor
    drawn = _line(x, jnd if part == "jnd" else jnd / x, INK)
    if part == "fraction":
        # Near zero it has no bound, and would leave no room for the rest.
        is_shown = x >= min(cell.reference for cell in analysis.pooled) / 2
        drawn = _line(x[is_shown], (jnd / x)[is_shown], INK)
    drawn["line"] = {"color": INK, "width": 1, "dash": "dot"}
    return drawn | {"name": f"JND = {line.limit:.3f} x reference + {line.floor:.3g}", "showlegend": True}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


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
    if analysis.within is not None:
        parts.append(("conditions", "Conditions", _conditions(analysis.within)))
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
    figure = figure_html("psychometric", psychometric(analysis.pooled, model, unit))
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
        figure = psychometric(cells, model, unit, of_persons=True)
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
        if (figure := by_reference(analysis, part, unit)) is not None
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


def _conditions(within: WithinComparison) -> str:
    """Return the tables of a factor within persons: shares of right answers, their analysis, and the pairs."""
    anova = within.anova
    means = [
        [text(condition), percentage(mean), percentage(deviation)]
        for condition, mean, deviation in zip(within.conditions, within.means, within.deviations, strict=True)
    ]
    variance = [
        [
            f"F[{anova.between:g}, {anova.within:g}] = {number(anova.f)}",
            number(anova.p_value),
            f"{number(anova.corrected_p_value)} (\N{GREEK SMALL LETTER EPSILON} = {number(anova.sphericity)})",
            number(anova.eta_squared),
            str(len(within.subjects)),
        ]
    ]
    head = ["repeated measures", "p", "p corrected for sphericity", "partial \N{GREEK SMALL LETTER ETA}²", "persons"]
    pairs = [
        [
            " less ".join(text(within.conditions[k]) for k in pair.groups),
            number(pair.difference),
            number(pair.p_value),
            number(pair.effect),
        ]
        for pair in within.pairs
    ]
    return (
        table([text(within.factor), "right answers", "deviation over persons"], means)
        + table(head, variance)
        + table([text(within.factor), "difference", "p (Holm)", "d<sub>z</sub>"], pairs)
    )


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
    return figure_html("staircases", staircases(analysis.traces, unit)) + table(head, rows)


def _notes(analysis: Analysis) -> str:
    settings = analysis.settings
    least, most = settings.model.lapse if settings.model is not None else (0.0, 0.0)
    word = "left out" if settings.saturated == "exclude" else "counted"
    how = f"Method {settings.method}; lapses {least:g} to {most:g}; saturated trials {word}."
    points = [how, *(f"{note}." for note in analysis.notes)]
    return "<ul>" + "".join(f"<li>{text(point)}</li>" for point in points) + "</ul>"
