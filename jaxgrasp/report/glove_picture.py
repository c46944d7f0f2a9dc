"""A picture of a glove over time: torques, a finger's angle, the object's height, and what happened when.

A picture of a calibration: each channel's residuals over its values, encoders above, gauges below.
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxgrasp.glove.sensors import CalibrationLine
from jaxgrasp.report.look import GRID, INK, MUTED, check_matplotlib, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FINGERS = {"thumb": "#0072B2", "index": "#D55E00", "middle": "#009E73", "ring": "#CC79A7", "little": "#B08A00"}
"""Okabe and Ito's colours, which the colour-blind tell apart; the yellow is darker, to be read on white."""


def write_glove_picture(
    path: Path,
    joints: tuple[str, ...],
    times: np.ndarray,
    torques: np.ndarray,
    angles: np.ndarray,
    object_times: np.ndarray,
    heights: np.ndarray,
    marks: dict[str, float],
) -> None:
    """Write the picture, whole or not at all.

    Args:
        path: of the PNG file.
        joints: of the channels.
        times: of torques and angles [s].
        torques: at the glove ``(T, channels)`` [N.m].
        angles: of the joints ``(T, channels)`` [rad].
        object_times: of the heights [s].
        heights: of the object [m].
        marks: what happened, and when [s].

    Raises:
        ImportError: matplotlib is not installed.
    """
    check_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7.2))
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    figure.subplots_adjust(left=0.085, right=0.86, top=0.9, bottom=0.075, hspace=0.14)
    _draw_fingers(top, joints, times, torques)
    top.set_ylabel("torque against flexion, sum\nof each finger's joints [N\N{MIDDLE DOT}m]")
    _draw_fingers(middle, joints, times, np.degrees(angles))
    middle.set_ylabel("flexion, sum of each\nfinger's joints [\N{DEGREE SIGN}]")
    bottom.plot(object_times, 100 * heights, color=INK, lw=1.8)
    bottom.set_ylabel("object's height [cm]")
    bottom.set_xlabel("time [s]")
    for axes in (top, middle, bottom):
        _dress(axes, times, marks)
    for name, at in marks.items():
        top.annotate(
            name,
            (at, 1),
            xycoords=("data", "axes fraction"),
            xytext=(0, 4),
            textcoords="offset points",
            ha="left",
            fontsize=9,
            color=INK,
        )
    # Curves that coincide are told apart by a broken one above a whole one.
    for line in (*top.lines, *middle.lines):
        if line.get_color() == FINGERS["middle"]:
            line.set_linestyle((0, (4, 3)))
    figure.text(0.012, 0.955, "A hand in a glove: it grasps, lifts, loses its cable, and is armed again", fontsize=12)
    write_png(path, figure)


def _draw_fingers(axes: "Axes", joints: tuple[str, ...], times: np.ndarray, values: np.ndarray) -> None:
    """Draw the sum of each finger's joints over time as a line; names at the line ends do not overlap."""
    ends = {}
    for finger, colour in FINGERS.items():
        columns = [k for k, joint in enumerate(joints) if joint.startswith(finger)]
        if columns:
            curve = values[:, columns].sum(1)
            axes.plot(times, curve, color=colour, lw=1.6)
            ends[finger] = curve[-1]
    for finger, height in _separate_heights(ends, axes.get_ylim()).items():
        axes.annotate(
            finger,
            (times[-1], height),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
            color=FINGERS[finger],
        )


def _separate_heights(ends: dict[str, float], limits: tuple[float, float]) -> dict[str, float]:
    """Return the heights of names, in the order of their curves' ends, without overlap and within the limits."""
    low, high = limits
    gap = 0.085 * (high - low)
    names = sorted(ends, key=ends.__getitem__)
    heights: dict[str, float] = {}
    for k, name in enumerate(names):
        heights[name] = max(ends[name], heights[names[k - 1]] + gap) if k else ends[name]
    ceiling = high
    for name in reversed(names):
        heights[name] = min(heights[name], ceiling)
        ceiling = heights[name] - gap
    return heights


def _dress(axes: "Axes", times: np.ndarray, marks: dict[str, float]) -> None:
    axes.set_xlim(times[0], times[-1])
    axes.grid(color=GRID, lw=0.6)
    axes.tick_params(colors=MUTED, labelcolor=INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for at in marks.values():
        axes.axvline(at, color=MUTED, lw=0.8, ls=(0, (4, 3)))


SHOWN = {
    "encoder": ("joint angle [\N{DEGREE SIGN}]", "residual [\N{DEGREE SIGN}]", math.degrees(1)),
    "gauge": ("tension [N]", "residual [N]", 1.0),
}


def write_calibration_picture(
    path: Path,
    pairs: dict[str, tuple[np.ndarray, np.ndarray]],
    lines: dict[str, CalibrationLine],
    joints: tuple[str, ...],
) -> None:
    """Write the picture, whole or not at all.

    Args:
        path: of the PNG file.
        pairs: counts and values ``(pairs, channels)`` of each sensor.
        lines: fitted to them.
        joints: of the channels.

    Raises:
        ImportError: matplotlib is not installed.
    """
    check_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 0.6 + 3.2 * len(lines)), layout="constrained")
    grid = figure.subplots(len(lines), 1, squeeze=False)[:, 0]
    for axes, (sensor, line) in zip(grid, lines.items(), strict=True):
        across, up, factor = SHOWN[sensor]
        values = factor * pairs[sensor][1]
        width = 1.15 * (np.nanmax(values) - np.nanmin(values))
        for k, joint in enumerate(joints):
            # Side by side, each channel in a field of its own: 14 colours would tell nobody anything.
            axes.plot(k * width + values[:, k] - np.nanmin(values), factor * line.residuals[:, k], ".", color=INK, ms=4)
            axes.annotate(
                joint, (k * width, 1), xycoords=("data", "axes fraction"), va="bottom", fontsize=8, color=MUTED
            )
            axes.axvline((k - 0.06) * width, color=GRID, lw=0.8)
        axes.axhline(0, color=MUTED, lw=0.8)
        axes.set_ylabel(f"{sensor}s: {up}")
        axes.set_xlabel(f"{across}, {np.nanmin(values):.3g} to {np.nanmax(values):.3g} in each field")
        axes.set_xticks([])
        axes.set_xlim(-0.06 * width, len(joints) * width)
    write_png(path, figure)
