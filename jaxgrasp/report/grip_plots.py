"""The plots over time of a grip as one plotly figure: panels below each other on one axis of time."""

from jaxgrasp.report.bundle import listed
from jaxgrasp.report.figures import axis, layout
from jaxgrasp.report.grip_over_time import History
from jaxgrasp.report.look import HOLD_COLOURS, INK, MUTED
from jaxgrasp.report.panels import (
    WORTH_NAMING,
    Panel,
    PanelLine,
    footnote,
    label_heights,
    levels,
    panels,
    spells,
    value_range,
)

PANEL, GAP, LABEL = 190, 22, 15
"""Heights of a panel, between panels, and of a label [px]."""
PLAIN = {"xref": "paper", "showarrow": False}


def plots(history: History) -> dict:
    """Return the figure of all panels over time; its first shape is the cursor."""
    drawn = panels(history)
    height = len(drawn) * (PANEL + GAP) - GAP
    span = (float(history.times[0]), float(history.times[-1]))
    x = listed(history.times, 5)
    traces, notes, axes = [], [], {"xaxis": axis("time [s]", range=list(span), anchor=f"y{len(drawn)}")}
    for k, panel in enumerate(drawn):
        name = "y" if k == 0 else f"y{k + 1}"
        top = 1 - k * (PANEL + GAP) / height
        low, high = value_range(panel)
        level = {"zeroline": True, "zerolinecolor": MUTED} if panel.level else {}
        domain = [max(0.0, top - PANEL / height), top]
        axes["yaxis" + name[1:]] = axis(panel.title, range=[low, high], domain=domain, nticks=5, **level)
        traces += _traces(panel, x, name)
        named = [line for line in panel.lines if line.label]
        heights = label_heights(levels(history, named), low, high, LABEL / PANEL * (high - low))
        notes += _labels(named, heights, name)
        notes.append(_footnote(panel, name, low))
    spans = _spells(history, span)
    cursor = {"type": "line", "x0": span[0], "x1": span[0], "y0": 0, "y1": 1, "yref": "paper"}
    shapes = [cursor | {"line": {"color": INK, "width": 1.5}}, *(shape for shape, _ in spans)]
    notes += [note for _, note in spans if note]
    shape = layout(height + 78, **axes, shapes=shapes, annotations=notes, showlegend=False, hovermode="closest")
    shape["margin"] = {"l": 62, "r": 122, "t": 26, "b": 52}
    return {"data": traces, "layout": shape}


def _traces(panel: Panel, x: list, name: str) -> list[dict]:
    unit = panel.title.partition("[")[2].rstrip("]")
    styles = {False: {"width": 2, "dash": "solid"}, True: {"width": 1.2, "dash": "dot"}}
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": line.name,
            "x": x,
            "y": listed(line.values, 4),
            "yaxis": name,
            "line": {"color": line.colour, **styles[line.dotted]},
            "hovertemplate": f"{line.name}: %{{y:.3g}} {unit} at %{{x:.3g}} s<extra></extra>",
        }
        for line in panel.lines
    ]


def _labels(named: list[PanelLine], heights: list[float], name: str) -> list[dict]:
    """Return the annotations with the names of lines, beside their ends."""
    position = {"x": 1.01, "yref": name, "xanchor": "left", **PLAIN}
    return [
        {"text": line.label, "y": y, "font": {"color": line.colour}, **position}
        for line, y in zip(named, heights, strict=True)
    ]


def _footnote(panel: Panel, name: str, low: float) -> dict:
    """Return the annotation with a panel's footnote, at the panel's lower left."""
    look = {"font": {"size": 11, "color": MUTED}, "bgcolor": "rgba(255,255,255,0.8)", "borderpad": 1}
    position = {"x": 0.01, "y": low, "yref": name, "xanchor": "left", "yanchor": "bottom"}
    return {"text": footnote(panel), **position, **look, **PLAIN}


def _spells(history: History, span: tuple[float, float]) -> list[tuple[dict, dict | None]]:
    """Return a shade for each spell in which the object is not held, and its name at the top if it is long enough."""
    shades = []
    for begin, end, hold in spells(history):
        colour = HOLD_COLOURS[hold]
        shade = {"type": "rect", "x0": begin, "x1": end, "y0": 0, "y1": 1, "yref": "paper", "layer": "below"}
        shade |= {"fillcolor": colour, "opacity": 0.14, "line": {"width": 0}}
        note = {"text": hold.name.lower(), "x": (begin + end) / 2, "y": 1, "yref": "paper", "yanchor": "bottom"}
        note |= {"showarrow": False, "font": {"color": colour}}
        shades.append((shade, note if end - begin > WORTH_NAMING * (span[1] - span[0]) else None))
    return shades
