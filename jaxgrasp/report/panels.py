"""The three plots over time of a grip, as plain data: normal forces, joint torques, friction margins."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.grip.monitor import Hold
from jaxgrasp.report.grip_over_time import History
from jaxgrasp.report.look import finger_colours, number

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
