"""Pictures of a grip, which need no browser.

Hand and object at a few instants of a grip, with normals and forces, as one picture.

The plots over time of a grip as one picture.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgrasp.grip.monitor import Hold
from jaxgrasp.grip.scene import Scene
from jaxgrasp.report.grip_over_time import HEAD, NORMAL, VERBS, History, Scale, Stage, largest_reach
from jaxgrasp.report.look import (
    GRID,
    HOLD_COLOURS,
    INK,
    MUTED,
    OBJECT_COLOUR,
    SKIN_COLOUR,
    TABLE_COLOUR,
    TOUCH_COLOURS,
    check_matplotlib,
    number,
    write_png,
)
from jaxgrasp.report.panels import WORTH_NAMING, Panel, footnote, label_heights, levels, panels, spells, value_range
from jaxgrasp.report.surfaces import DrawnSurface, arrows, placed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ELEVATION, AZIMUTH = 12.0, 52.0
"""Elevation and azimuth of the eye [degrees]: it sees a right thumb, and the palm once it is turned."""
SIDES = {"": 0.0, "from the other side": 180.0, "from the left": 90.0, "from the right": 270.0}
"""Further azimuths of the eye [degrees], by the number of earlier views of the same relative poses."""
POSE_TOLERANCE = 1e-4
"""Largest relative motion of parts at which two views count as the same [m, rad]."""
SUN = np.array([0.5, 0.3, 0.81])


def instants_figure(scene: Scene, history: History, shown: Mapping[str, int]) -> "Figure":
    """Draw hand and object at named instants on the same scale; a repeated pose is seen from another side."""
    from matplotlib.figure import Figure

    stage, scale = Stage.of(scene, history), Scale.of(history)
    columns = 2 if len(shown) > 1 else 1
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(5.2 * columns, 4.9 * rows + 0.6))
    boxes = {name: stage.around(history, k) for name, k in shown.items()}
    reach = largest_reach(boxes.values())
    sides = _sides(history, list(shown.values()))
    for position, ((name, k), side) in enumerate(zip(shown.items(), sides, strict=True), 1):
        axes = figure.add_subplot(rows, columns, position, projection="3d", computed_zorder=False)
        azimuth = AZIMUTH + SIDES[side]
        _set_up(axes, boxes[name].mean(0), reach, azimuth)
        _draw_solids(axes, stage, history, k, _to_eye(azimuth))
        _draw_arrows(axes, history, k, scale)
        words = ", ".join(part for part in (name, f"{history.times[k]:.2f} s", side) if part)
        axes.set_title(words, fontsize=12, color=INK, pad=14)
        colour = HOLD_COLOURS[Hold(int(history.hold[k]))]
        axes.text2D(
            0.5, 1.0, history.description(k), transform=axes.transAxes, ha="center", color=colour, weight="bold"
        )
    _legend(figure, scale)
    foot = 0.55 / figure.get_figheight()
    figure.subplots_adjust(left=0.05, right=0.98, bottom=foot + 0.02, top=0.95, wspace=0.1, hspace=0.14)
    return figure


def _sides(history: History, instants: list[int]) -> list[str]:
    """Return the side, a key of `SIDES`, from which each instant is seen."""
    standing = [_standing(history, k) for k in instants]
    earlier_views = [
        sum(np.allclose(earlier, poses, atol=POSE_TOLERANCE) for earlier in standing[:k])
        for k, poses in enumerate(standing)
    ]
    return [list(SIDES)[count % len(SIDES)] for count in earlier_views]


def _standing(history: History, k: int) -> np.ndarray:
    """Return poses of links and object ``(L + 1, 3, 4)``, with origins relative to the first link's."""
    poses = np.concatenate([history.link_poses[k], history.object_pose[k][None]])
    return np.concatenate([poses[..., :3], poses[..., 3:] - poses[:1, :, 3:]], -1)


def _to_eye(azimuth: float) -> np.ndarray:
    up, around = np.radians(ELEVATION), np.radians(azimuth)
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def _set_up(axes, middle: np.ndarray, reach: float, azimuth: float) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.view_init(ELEVATION, azimuth)
    axes.set_proj_type("ortho")
    axes.set_box_aspect((1, 1, 1), zoom=1.15)
    for name, at in zip("xyz", middle.tolist(), strict=True):
        getattr(axes, f"set_{name}lim")(at - reach, at + reach)
        getattr(axes, f"set_{name}label")(f"{name} [m]", fontsize=9, color=MUTED)
        axis = getattr(axes, f"{name}axis")
        axis.set_major_locator(MaxNLocator(4))
        axis.set_pane_color((1, 1, 1, 0))
        axis._axinfo["grid"].update(color=GRID, linewidth=0.8)
    axes.tick_params(labelsize=8, labelcolor=MUTED)


def _draw_solids(axes, stage: Stage, history: History, k: int, to_eye: np.ndarray) -> None:
    """Draw hand, object and table at instant k, as far as they lie within the axes."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    object_corners = placed(stage.object.corners, history.object_pose[k])
    solids = [
        (placed(link.corners, pose), link.faces, SKIN_COLOUR, 1.0)
        for link, pose in zip(stage.links, history.link_poses[k], strict=True)
    ]
    solids.append((object_corners, stage.object.faces, OBJECT_COLOUR, 0.5))
    triangles, colours = (
        np.concatenate(part) for part in zip(*(_shaded(*solid, to_eye) for solid in solids), strict=True)
    )
    low, high = np.array([axes.get_xlim3d(), axes.get_ylim3d(), axes.get_zlim3d()]).T
    is_inside = ((triangles >= low) & (triangles <= high)).all((1, 2))
    # Opaque triangles are drawn a hair larger, or what lies behind would shine through their seams.
    rims = np.where(colours[:, 3:] < 1, 0, colours)
    look = {"facecolors": colours[is_inside], "edgecolors": rims[is_inside], "linewidths": 0.4, "zorder": 1}
    axes.add_collection3d(Poly3DCollection(triangles[is_inside], **look))
    if stage.table is not None:
        _draw_table(axes, stage.table, low, high)
    if ((object_corners >= low) & (object_corners <= high)).all():
        edges = placed(stage.object.lines, history.object_pose[k])
        axes.plot(*edges.T, color=MUTED, linewidth=0.7, zorder=2)


def _draw_table(axes, table: DrawnSurface, low: np.ndarray, high: np.ndarray) -> None:
    """Draw the part of a level table within the axes, below all solids; draw no part of a tilted table."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    corners = np.clip(table.corners, low, high)
    if (corners[:, 2] == table.corners[0, 2]).all() and np.ptp(table.corners[:, 2]) == 0:
        axes.add_collection3d(Poly3DCollection([corners], facecolors=TABLE_COLOUR, alpha=0.5, linewidths=0, zorder=0))


def _draw_arrows(axes, history: History, k: int, scale: Scale) -> None:
    """Draw normals and forces over all solids, so that arrows between hand and object stay visible."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    drawn, points = history.drawn[k], history.points[k]
    heaps = [(arrows(points[drawn], NORMAL * history.normals[k][drawn], HEAD), INK)]
    for touch in VERBS:
        mask = drawn & (history.touches[k] == touch) & np.isfinite(history.forces[k]).all(-1)
        heaps.append((arrows(points[mask], scale.metres * history.forces[k][mask], HEAD), TOUCH_COLOURS[touch]))
    for zorder, (heap, colour) in enumerate(heaps, 3):
        if len(heap.faces):
            look = {"facecolors": colour, "linewidths": 0, "zorder": zorder}
            axes.add_collection3d(Poly3DCollection(heap.corners[heap.faces], **look))


def _shaded(
    corners: np.ndarray, faces: np.ndarray, colour: str, alpha: float, to_eye: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles that face the eye and their RGBA colours under a light from above."""
    from matplotlib.colors import to_rgb

    triangles = corners[faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    faces_eye = (normals @ to_eye > 0) & (sizes[:, 0] > 0)
    lit = 0.62 + 0.38 * np.maximum(normals[faces_eye] / sizes[faces_eye] @ SUN, 0)
    colours = np.column_stack([lit[:, None] * np.array(to_rgb(colour)), np.full(len(lit), alpha)])
    return triangles[faces_eye], np.clip(colours, 0, 1)


def _legend(figure: "Figure", scale: Scale) -> None:
    from matplotlib.lines import Line2D

    names = {f"force where a contact {touch.name.lower()}": TOUCH_COLOURS[touch] for touch in VERBS}
    names = {f"inward normal ({number(1000 * NORMAL)} mm)": INK, **names}
    handles = [Line2D([], [], color=colour, linewidth=3, label=name) for name, colour in names.items()]
    figure.legend(
        handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=9.5, bbox_to_anchor=(0.5, 0.022)
    )
    words = f"forces on the object: {number(1000 * scale.length)} mm stand for {number(scale.newtons)} N"
    figure.text(0.5, 0.012, words, ha="center", fontsize=9.5, color=INK)


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
