"""The figures of an experiment as plotly's own JSON: psychometric functions, JNDs, Weber fractions, staircases."""

import numpy as np

from jaxgrasp.psychophysics.analysis.cell import Cell
from jaxgrasp.psychophysics.analysis.counts import ratio_intervals
from jaxgrasp.psychophysics.analysis.experiment import Analysis, Trace
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.report.figures import axis, layout
from jaxgrasp.report.look import INK, MUTED

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
    traces = [everyone, *_persons(analysis, part)]
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


def _persons(analysis: Analysis, part: str) -> list[dict]:
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
