"""Pictures of a grip, which need no browser."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxgrasp.grip.scene import Scene
from jaxgrasp.report.grip_over_time import History
from jaxgrasp.report.instants_picture import instants_figure
from jaxgrasp.report.panels_picture import panels_figure
from jaxgrasp.report.png import check_matplotlib, write_png


def write_grip_pictures(folder: Path, scene: Scene, history: History, instants: Mapping[str, float]) -> list[Path]:
    """Write ``grip.png`` and ``grip_forces.png``, each whole or not at all, and say where.

    Args:
        folder: where to.
        scene: hand, object and table.
        history: what happened to them.
        instants: names and times [s] of what ``grip.png`` shows.

    Raises:
        ImportError: matplotlib is not installed.
    """
    check_matplotlib("the pictures need")
    shown = {name: int(np.abs(history.times - time).argmin()) for name, time in instants.items()}
    figures = {"grip.png": instants_figure(scene, history, shown), "grip_forces.png": panels_figure(history, shown)}
    for name, figure in figures.items():
        write_png(folder / name, figure)
    return [folder / name for name in figures]
