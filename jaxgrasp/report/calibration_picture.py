"""A picture of a calibration: each channel's residuals over its values, encoders above, gauges below."""

import math
from pathlib import Path

import numpy as np

from jaxgrasp.glove.sensors import CalibrationLine
from jaxgrasp.report.look import GRID, INK, MUTED
from jaxgrasp.report.png import check_matplotlib, write_png

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
