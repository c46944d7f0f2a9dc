"""The flat figures of the report, as plotly's own JSON: verdicts, distributions, slip angles.

They are plain dictionaries rather than plotly objects: the page needs no more, and building them needs no plotly.
"""

import numpy as np

from jaxgrasp.batch.chunk_statistics import EDGES, PER_DECADE, LogHistogram
from jaxgrasp.batch.summary import Summary
from jaxgrasp.model.solution import Verdict
from jaxgrasp.report.look import (
    GRID,
    INK,
    METHOD_COLOURS,
    MUTED,
    VERDICT_COLOURS,
    VERDICT_TITLES,
    format_count,
    method_title,
    share,
)

FONT = {"family": "system-ui, 'Segoe UI', 'Helvetica Neue', Arial, sans-serif", "size": 13, "color": INK}
DARK_TEXT = {Verdict.OPTIMAL, Verdict.NO_CONTACTS, Verdict.NOT_CONVERGED, Verdict.OUTSIDE_CONES}
COARSE = 4
"""Bins of the histograms joined to one bar: a fifth of a decade."""


def layout(height: int, **options) -> dict:
    """Return plotly's layout that all figures share, with a height [px] and further entries."""
    return {
        "font": FONT,
        "height": height,
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "margin": {"l": 60, "r": 16, "t": 30, "b": 48},
        "modebar": {"bgcolor": "rgba(255,255,255,0.7)", "color": "#a9b3be", "activecolor": INK},
        "hoverlabel": {"bgcolor": "#ffffff", "bordercolor": MUTED, "font": {"color": INK}},
        **options,
    }


def axis(title: str, **options) -> dict:
    name = {"text": title, "standoff": 8, "font": {"size": 13}}
    line = {"showline": True, "linecolor": MUTED, "ticks": "outside", "tickcolor": MUTED, "ticklen": 4}
    return {"title": name, "tickfont": {"size": 12}, "gridcolor": GRID, "zeroline": False, **line, **options}


def verdict_bars(summary: Summary) -> dict:
    """Return a bar chart with a bar for each method, divided by verdict in percent of all problems."""
    names = list(summary.methods)
    traces = []
    for verdict in Verdict:
        counts = [summary.methods[name].count(verdict) for name in names]
        if not any(counts):
            continue
        parts = [100 * count / max(1, summary.problems) for count in counts]
        traces.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": VERDICT_TITLES[verdict],
                "y": [method_title(name) for name in names],
                "x": parts,
                "marker": {"color": VERDICT_COLOURS[verdict], "line": {"color": "#ffffff", "width": 1}},
                "text": [share(c, summary.problems) if c > 0.04 * summary.problems else "" for c in counts],
                "textposition": "inside",
                "insidetextanchor": "middle",
                "textangle": 0,
                "textfont": {"color": INK if verdict in DARK_TEXT else "#ffffff"},
                "customdata": [format_count(count) for count in counts],
                "hovertemplate": f"%{{y}}: %{{customdata}} (%{{x:.2f}}%)<br>{VERDICT_TITLES[verdict]}<extra></extra>",
            }
        )
    shape = layout(
        144 + 46 * len(names),
        barmode="stack",
        bargap=0.28,
        xaxis=axis("share [%]", range=[0, 100]),
        yaxis={"autorange": "reversed", "ticklabelstandoff": 6, "automargin": True},
        showlegend=True,
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "traceorder": "normal"},
    )
    shape["margin"] |= {"l": 110, "t": 64}
    return {"data": traces, "layout": shape}


def distribution(histograms: dict[str, LogHistogram], title: str) -> dict | None:
    """Plot the positive values of a quantity on a logarithmic axis, an outline per method; None if all are zero."""
    used_bins = [np.flatnonzero(histogram.counts) for histogram in histograms.values()]
    if not any(len(u) for u in used_bins):
        return None
    first = min(int(u[0]) for u in used_bins if len(u)) // COARSE * COARSE
    last = max(int(u[-1]) for u in used_bins if len(u)) // COARSE * COARSE + COARSE
    traces = [_outline(name, histogram, first, last) for name, histogram in histograms.items()]
    # Exponents are labelled no closer than whole decades, and at most about four of them.
    decade_step = max(1, round((last - first) / PER_DECADE / 4))
    ends = np.log10(EDGES[[first, last]]).tolist()
    shape = layout(
        270,
        xaxis=axis(title, type="log", dtick=decade_step, exponentformat="power", range=ends),
        yaxis=axis("share [%]", rangemode="tozero"),
        showlegend=False,
        hovermode="closest",
    )
    shape["margin"] |= {"l": 52}
    return {"data": traces, "layout": shape}


def _outline(name: str, histogram: LogHistogram, first: int, last: int) -> dict:
    counts = histogram.counts[first:last].reshape(-1, COARSE).sum(1)
    left_edges = EDGES[first:last:COARSE]
    right_edges = EDGES[first + COARSE : last + 1 : COARSE]
    heights = 100 * counts / max(1, histogram.total)
    texts = [
        f"closed form {name}: {format_count(int(c))} ({h:.2f}%)<br>from {a:.2g} to {b:.2g}"
        for c, h, a, b in zip(counts, heights, left_edges, right_edges, strict=True)
    ]
    # Each bar is drawn by its own two corners: a step line would need a last point that has no bar of its own.
    return {
        "type": "scatter",
        "mode": "lines",
        "x": _rounded([left_edges[0], *np.column_stack([left_edges, right_edges]).ravel(), right_edges[-1]]),
        "y": _rounded([0, *np.repeat(heights, 2), 0]),
        "text": [texts[0], *(t for t in texts for _ in range(2)), texts[-1]],
        "hoverinfo": "text",
        "name": f"closed form {name}",
        # Only one is filled: two fills would mix to a third colour that belongs to no method.
        "fill": "tozeroy" if name == "A" else "none",
        "fillcolor": METHOD_COLOURS[name] + "40",
        "line": {"color": METHOD_COLOURS[name], "width": 1.5 if name == "A" else 2.5},
    }


def slip_maps(summary: Summary) -> dict | None:
    """Plot slip angle over friction angle, a panel per method: contacts above the line slip; None without load."""
    maps = {name: answers.angles for name, answers in summary.methods.items() if answers.angles.sum()}
    if not maps:
        return None
    whole_map = np.sum(list(maps.values()), axis=0)
    bins = len(whole_map)
    slip_step, friction_step = 180 / bins, 90 / bins
    x0, x1 = _used_range(whole_map.sum(0), friction_step, 90.0)
    # Room above the line even where nothing slips, to see that nothing does.
    top = max(_used_range(whole_map.sum(1), slip_step, 180.0)[1], x1 + 20)
    axes: dict[str, dict] = {}
    traces, notes = [], []
    for index, (name, counts) in enumerate(maps.items()):
        suffix = "" if index == 0 else str(index + 1)
        traces += _slip_panel(counts, suffix, (x0, x1), (slip_step, friction_step), top)
        # A lone panel stays as narrow as one of two: angles stretched over the whole page are hard to compare.
        pitch = 1 / max(2, len(maps))
        left = index * pitch
        axes |= _panel_axes(suffix, (x0, x1), top, [left, left + pitch - 0.02])
        text = f"<b>{method_title(name)}</b><br>above the line: {_above(counts)}"
        position = {"x": left, "y": 1.02, "xref": "paper", "yref": "paper", "yanchor": "bottom", "xanchor": "left"}
        notes.append({"text": text, **position})
    notes.append(_line_note(suffix, x0, x1, top))
    for note in notes:
        note |= {"showarrow": False, "align": "left"}
    peak = max(int(counts.max()) for counts in maps.values())
    shape = layout(450, **axes, annotations=notes, showlegend=False, coloraxis=_count_colours(peak))
    shape["margin"] |= {"t": 76, "r": 84}
    return {"data": traces, "layout": shape}


def _panel_axes(suffix: str, across: tuple, top: float, domain: list[float]) -> dict:
    """Return the axes of a panel; all panels share the slip angles of the left panel, and zoom with it."""
    shared = {"showticklabels": False, "matches": "y"} if suffix else {}
    return {
        "xaxis" + suffix: axis("friction angle atan μ [°]", range=list(across), domain=domain, anchor="y" + suffix),
        "yaxis" + suffix: axis("" if suffix else "slip angle [°]", range=[0, top], anchor="x" + suffix, **shared),
    }


def _slip_panel(counts, suffix: str, across: tuple, steps: tuple, top: float) -> list[dict]:
    slip_step, friction_step = steps
    columns = slice(round(across[0] / friction_step), round(across[1] / friction_step))
    shown = counts[: round(top / slip_step), columns]
    axis_names = {"xaxis": "x" + suffix, "yaxis": "y" + suffix}
    heat = {
        "type": "heatmap",
        "x0": across[0] + friction_step / 2,
        "dx": friction_step,
        "y0": slip_step / 2,
        "dy": slip_step,
        "z": [[float(f"{np.log10(c):.4g}") if c else None for c in row] for row in shown.tolist()],
        "customdata": shown.tolist(),
        "coloraxis": "coloraxis",
        "hoverongaps": False,
        "hovertemplate": "slip %{y:.0f}°, friction %{x:.1f}°: %{customdata} contacts<extra></extra>",
        **axis_names,
    }
    line = {
        "type": "scatter",
        "mode": "lines",
        "x": list(across),
        "y": list(across),
        "line": {"color": METHOD_COLOURS["B"], "width": 1.5},
        "hoverinfo": "skip",
        **axis_names,
    }
    return [heat, line]


def _line_note(suffix: str, x0: float, x1: float, top: float) -> dict:
    """Return the label of the line, in the last panel: an optimum, if there is one, has no contacts above the line."""
    text = "<b>slips</b> above the line<br>slip = friction angle"
    font = {"size": 11, "color": METHOD_COLOURS["B"]}
    position = {"x": x0 + 0.06 * (x1 - x0), "y": min(x1, top - 18), "xref": "x" + suffix, "yref": "y" + suffix}
    anchor = {"xanchor": "left", "yanchor": "bottom"}
    return {"text": text, "font": font, "bgcolor": "rgba(255,255,255,0.85)", **anchor, **position}


def _above(counts: np.ndarray) -> str:
    """Return the share of contacts in bins wholly above the line; a bin that the line crosses is not counted."""
    slip_step, friction_step = 180 / len(counts), 90 / len(counts)
    above = slip_step * np.arange(len(counts))[:, None] >= friction_step * (1 + np.arange(len(counts)))
    return share(int(counts[above].sum()), int(counts.sum()))


def _used_range(totals: np.ndarray, step: float, limit: float) -> tuple[float, float]:
    """Return the range [degrees] of the bins with a positive count, widened by a margin and cut at the limit."""
    used_bins = np.flatnonzero(totals)
    room = max(4 * step, 4)
    return max(0.0, float(used_bins[0]) * step - room), min(limit, float(used_bins[-1] + 1) * step + room)


def _count_colours(peak: int) -> dict:
    ticks = list(range(int(np.log10(max(peak, 1))) + 1))
    # The palest shade still stands out from the page; the greys leave the colours to methods and verdicts.
    shades = ["#d5dde6", "#a9b8c8", "#6f8499", "#3f5368", "#101c2b"]
    title = {"text": "contacts", "font": {"size": 13}}
    return {
        "cmin": 0,
        "cmax": max(1, float(np.log10(max(peak, 1)))),
        "colorscale": [[i / 4, shade] for i, shade in enumerate(shades)],
        "colorbar": {
            "title": title,
            "tickvals": ticks,
            "ticktext": [format_count(10**t) for t in ticks],
            "thickness": 12,
        },
    }


def _rounded(values) -> list[float]:
    return [float(f"{value:.5g}") for value in values]
