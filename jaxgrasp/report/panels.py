"""The three plots over time of a grip, as plain data: normal forces, joint torques, friction margins.

The plots over time of a grip as one plotly figure: panels below each other on one axis of time.
"""

from typing import NamedTuple

import numpy as np

from jaxgrasp.grip.monitor import Hold
from jaxgrasp.report.bundle import listed
from jaxgrasp.report.figures import axis, layout
from jaxgrasp.report.grip_over_time import History
from jaxgrasp.report.look import HOLD_COLOURS, INK, MUTED, finger_colours, number

WORTH_NAMING = 0.09
"""Share of the time from which a spell of slipping or falling is named: about as wide as its name, so that names of
neighbours stand apart."""


class PanelLine(NamedTuple):
    """Quantity over time, drawn in its finger's colour."""

    name: str
    colour: str
    values: np.ndarray
    label: str = ""
    """Label beside the line's end; empty if the line has none."""
    dotted: bool = False


class Panel(NamedTuple):
    """A plot with its axis, and a level worth a line of its own."""

    title: str
    lines: list[PanelLine]
    least: float
    """The least range of values that is worth the whole height."""
    level: str = ""
    """Meaning of zero."""


def panels(history: History) -> list[Panel]:
    """Return the panels of normal forces, joint torques and friction margins over all instants, by finger."""
    colours = finger_colours(history.fingers)
    return [_forces(history, colours), _torques(history, colours), _margins(history, colours)]


def spells(history: History) -> list[tuple[float, float, Hold]]:
    """Return begin [s], end [s] and hold of each spell in which the object is not held."""
    changes = np.flatnonzero(np.diff(history.hold)) + 1
    begins = np.concatenate([[0], changes])
    ends = np.concatenate([changes, [len(history.hold) - 1]])
    all_spells = [
        (float(history.times[a]), float(history.times[b]), Hold(int(history.hold[a])))
        for a, b in zip(begins, ends, strict=True)
    ]
    return [spell for spell in all_spells if spell[2] != Hold.STABLE]


def levels(history: History, lines: list[PanelLine]) -> list[float]:
    """Return the label level of each line: its last value or, if the object is lost then or the value is unknown, the
    median while the object is held.
    """
    held = history.hold == Hold.STABLE
    lost = bool(history.hold[-1] == Hold.LOST)
    return [_level(line.values, held, lost) for line in lines]


def _level(values: np.ndarray, held: np.ndarray, lost: bool) -> float:
    if not lost and np.isfinite(values[-1]):
        return float(values[-1])
    is_finite = np.isfinite(values)
    chosen = values[is_finite & held] if (is_finite & held).any() else values[is_finite]
    return float(np.median(chosen)) if len(chosen) else 0.0


def label_heights(targets: list[float], low: float, high: float, gap: float) -> list[float]:
    """Return the heights of labels, near the wanted heights and in their order, at least ``gap`` apart."""
    order = np.argsort(targets, kind="stable")
    heights = np.array(targets, float)[order]
    floor = low - gap
    for k, height in enumerate(heights):
        heights[k] = floor = max(height, floor + gap)
    # Those pushed over the top come down again, and take their neighbours with them.
    ceiling = high + gap
    for k in range(len(heights) - 1, -1, -1):
        heights[k] = ceiling = min(heights[k], ceiling - gap)
    return heights[np.argsort(order)].tolist()


def value_range(panel: Panel) -> tuple[float, float]:
    """Return the value range of a panel: zero and all values, but short peaks at most double it."""
    values = _values(panel)
    least, low, high, most = (float(v) for v in np.quantile(values, [0, 0.02, 0.98, 1]))
    low, high = min(low, 0.0), max(high, 0.0)
    beyond = (high - low) / 2
    low, high = max(least, low - beyond), min(most, high + beyond)
    room = max(0.06 * (high - low), (panel.least - (high - low)) / 2)
    # A footnote stands below all lines.
    return low - 2 * room, high + room


def footnote(panel: Panel) -> str:
    """Return the footnote of a panel: the meaning of zero, and the extremes of peaks that the range cuts off."""
    low, high = value_range(panel)
    values = _values(panel)
    notes = [panel.level] if panel.level else []
    if values.max() > high or values.min() < low:
        notes.append(f"peaks cut off: {number(values.min(), 2)} to {number(values.max(), 2)}")
    return "; ".join(notes)


def _values(panel: Panel) -> np.ndarray:
    """Return all finite values of a panel's lines, and zero."""
    values = np.concatenate([line.values for line in panel.lines])
    return np.append(values[np.isfinite(values)], 0)


def _forces(history: History, colours: dict[str, str]) -> Panel:
    exerted, intended = np.where(history.drawn, history.pressing, 0), np.where(history.drawn, history.squeeze, 0)
    lines = []
    for finger, columns in _links(history, colours):
        lines += [
            PanelLine(f"{finger}, squeezing force", colours[finger], intended[:, columns].sum(1), dotted=True),
            PanelLine(f"{finger}, normal force", colours[finger], exerted[:, columns].sum(1), finger),
        ]
    return Panel("normal force [N]", lines, 1.0)


def _torques(history: History, colours: dict[str, str]) -> Panel:
    """Return the panel of joint torques; a label names each finger's most loaded joint."""
    peaks = np.abs(np.nan_to_num(history.torques)).max(0)
    fingers = np.array(history.joint_fingers)
    lines = []
    for j, joint in enumerate(history.joints):
        finger_joints = np.flatnonzero(fingers == fingers[j])
        named = finger_joints[peaks[finger_joints].argmax()] == j
        lines.append(PanelLine(joint, colours[fingers[j]], history.torques[:, j], joint if named else ""))
    return Panel("joint torque [N·m]", lines, 0.1, "below 0: against flexion")


def _margins(history: History, colours: dict[str, str]) -> Panel:
    margins = np.where(history.drawn & np.isfinite(history.margins), np.degrees(history.margins), np.inf)
    smallest = [(finger, margins[:, columns].min(1)) for finger, columns in _links(history, colours)]
    # A finger that never touches has no line, and no name beside it.
    lines = [
        PanelLine(
            f"{finger}, smallest margin",
            colours[finger],
            np.where(np.isfinite(least), least, np.nan),
            finger if np.isfinite(least).any() else "",
        )
        for finger, least in smallest
    ]
    return Panel("friction margin [°]", lines, 5.0, "below 0: slides")


def _links(history: History, colours: dict[str, str]) -> list[tuple[str, np.ndarray]]:
    fingers = np.array(history.fingers)
    return [(finger, np.flatnonzero(fingers == finger)) for finger in colours]


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
