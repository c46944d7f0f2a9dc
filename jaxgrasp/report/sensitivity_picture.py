"""A picture of a sensitivity analysis: slip angles over time as in the paper's Fig. 5, and what has influence."""

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgrasp.report.look import GRID, INK, METHOD_COLOURS, MUTED, check_matplotlib, method_title, number, write_png
from jaxgrasp.sensitivity.matrix import Influence
from jaxgrasp.sensitivity.study import Study, rankings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 8
"""Bars of a ranking."""
DASHES = ("-", (0, (5, 2)), (0, (1.5, 1.5)), (0, (5, 1.5, 1, 1.5)))


def write_sensitivity_picture(path: Path, study: Study, finger: str, vary: str) -> None:
    """Write the picture, whole or not at all.

    Raises:
        ImportError: matplotlib is not installed.
    """
    check_matplotlib()
    write_png(path, sensitivity_figure(study, finger, vary))


def sensitivity_figure(study: Study, finger: str, vary: str) -> "Figure":
    """Draw a column per method, a finger's slip angle for each value; below, the rankings and the reserve's."""
    from matplotlib.figure import Figure

    columns = len(study.slips)
    figure = Figure(figsize=(max(4.2 * columns + 0.8, 10), 7.6))
    grid = figure.add_gridspec(2, columns, left=0.075, right=0.985, top=0.9, bottom=0.085, hspace=0.36, wspace=0.42)
    lower = figure.add_gridspec(2, columns + 1, left=0.11, right=0.985, top=0.9, bottom=0.085, hspace=0.36, wspace=0.75)
    ranked = rankings(study)
    for column, (method, trajectory) in enumerate(study.slips.items()):
        axes = figure.add_subplot(grid[0, column])
        _draw_slips(axes, method, trajectory, finger, vary)
        axes.set_ylabel(f"slip angle of the {finger} [\N{DEGREE SIGN}]" if column == 0 else "")
        below = figure.add_subplot(lower[1, column])
        title = f"largest slip angles, {method_title(method)}"
        _draw_ranking(below, ranked[f"slip angles, {method}"], title, METHOD_COLOURS[method])
    last = figure.add_subplot(lower[1, columns])
    _draw_ranking(last, ranked["reserve of friction"], "smallest reserve of friction", INK)
    figure.text(
        0.012,
        0.955,
        f"Slip angle of the {finger} along the task; what moves all fingers' worst",
        fontsize=12,
        color=INK,
    )
    values = np.asarray(next(iter(study.slips.values())).varied[vary].values)
    for dash, value in zip(cycle(DASHES), values, strict=False):
        last.plot([], [], color=INK, linestyle=dash, linewidth=1.7, label=f"{vary} = {number(float(value))}")
    figure.legend(frameon=False, fontsize=9.5, loc="upper right", handlelength=2.8, ncols=len(values))
    return figure


def _draw_slips(axes: "Axes", method: str, trajectory: Any, finger: str, vary: str) -> None:
    varied, times = trajectory.varied[vary], np.asarray(trajectory.times)
    k = trajectory.matrix.output_labels.index(f"slip_angle[{finger}]")
    axes.axhspan(90, 180, color="#CC79A7", alpha=0.13, linewidth=0)
    style: dict[str, Any] = {"transform": axes.transAxes, "va": "top", "ha": "center", "fontsize": 9, "color": MUTED}
    axes.text(0.5, 0.97, "pulls", **style)
    for dash, curve in zip(cycle(DASHES), np.degrees(np.asarray(varied.curves)[..., k]), strict=False):
        shown = np.where(np.isfinite(curve), curve, np.nan)
        axes.plot(times, shown, color=METHOD_COLOURS[method], linestyle=dash, linewidth=1.7)
    axes.set_title(method_title(method), fontsize=11, color=METHOD_COLOURS[method], loc="left")
    axes.set(xlim=(times[0], times[-1]), ylim=(0, 180), yticks=range(0, 181, 30), xlabel="time [s]")
    _plain(axes)


def _draw_ranking(axes: "Axes", influences: list[Influence], title: str, colour: str) -> None:
    ranked = [influence for influence in influences if np.isfinite(influence.size)][:SHOWN][::-1]
    axes.barh(
        [influence.label for influence in ranked], [influence.size for influence in ranked], color=colour, height=0.62
    )
    axes.set_title(title, fontsize=10, color=colour, loc="left")
    axes.set_xlabel("1% moves the worst by [%]")
    axes.tick_params(axis="y", length=0, labelsize=8.5)
    axes.grid(axis="y", visible=False)
    _plain(axes)


def _plain(axes: "Axes") -> None:
    axes.grid(axis="x", color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
