"""The plots over time of a grip as one picture."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgrasp.report.grip_over_time import History
from jaxgrasp.report.look import GRID, HOLD_COLOURS, INK, MUTED
from jaxgrasp.report.panels import WORTH_NAMING, Panel, footnote, label_heights, levels, panels, spells, value_range

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def panels_figure(history: History, shown: Mapping[str, int]) -> "Figure":
    """Draw the panels over time, with the named instants marked."""
    from matplotlib.figure import Figure

    drawn = panels(history)
    figure = Figure(figsize=(9.5, 2.6 * len(drawn) + 0.4))
    rows = figure.subplots(len(drawn), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(rows, drawn, strict=True):
        _draw_panel(axes, panel, history)
        for k in shown.values():
            axes.axvline(history.times[k], color=MUTED, linewidth=0.8, linestyle=(0, (2, 3)))
    ends = {0: "left", len(history.times) - 1: "right"}
    for name, k in shown.items():
        position = (history.times[k], 1.03)
        side = ends.get(k, "center")
        rows[0].text(*position, name, transform=rows[0].get_xaxis_transform(), ha=side, fontsize=9, color=MUTED)
    _name_spells(rows[0], history)
    rows[0].plot([], [], color=INK, linewidth=2, label="applied force")
    rows[0].plot([], [], color=INK, linewidth=1.2, linestyle=":", label="squeezing force (eq. 6)")
    figure.legend(loc="lower right", frameon=False, fontsize=9, ncols=2)
    rows[-1].set_xlabel("time [s]")
    figure.subplots_adjust(left=0.085, right=0.85, top=0.94, bottom=0.075, hspace=0.1)
    figure.align_ylabels()
    return figure


def _draw_panel(axes: "Axes", panel: Panel, history: History) -> None:
    low, high = value_range(panel)
    axes.margins(x=0)
    for line in panel.lines:
        style = {"linestyle": ":", "linewidth": 1.2} if line.dotted else {"linewidth": 1.8}
        axes.plot(history.times, line.values, color=line.colour, **style)
    named = [line for line in panel.lines if line.label]
    heights = label_heights(levels(history, named), low, high, 0.085 * (high - low))
    for line, height in zip(named, heights, strict=True):
        label_style: dict[str, Any] = {"transform": axes.get_yaxis_transform(), "va": "center", "fontsize": 9.5}
        axes.text(1.012, height, line.label, color=line.colour, **label_style)
    if panel.level:
        axes.axhline(0, color=MUTED, linewidth=0.8)
    axes.text(0.008, 0.03, footnote(panel), transform=axes.transAxes, fontsize=8.5, color=MUTED)
    for begin, end, hold in spells(history):
        axes.axvspan(begin, end, color=HOLD_COLOURS[hold], alpha=0.14, linewidth=0)
    axes.set_ylim(low, high)
    axes.set_ylabel(panel.title)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _name_spells(axes: "Axes", history: History) -> None:
    """Write the names of spells above all panels, over their shades."""
    style: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "ha": "center", "fontsize": 9.5, "weight": "bold"}
    for begin, end, hold in spells(history):
        if end - begin > WORTH_NAMING * np.ptp(history.times):
            axes.text((begin + end) / 2, 1.12, hold.name.lower(), color=HOLD_COLOURS[hold], **style)
