"""Page of a grip in one offline file: hand and object move in three dimensions beside plots over time."""

import os
from pathlib import Path

import numpy as np

from jaxgrasp.files.replace import replace_file
from jaxgrasp.grip.scene import Scene
from jaxgrasp.report.bundle import embedded, listed, page_html
from jaxgrasp.report.figures import layout
from jaxgrasp.report.grasp_in_3d import axis3
from jaxgrasp.report.grip_over_time import HEAD, NORMAL, VERBS, History, Scale, Stage, largest_reach
from jaxgrasp.report.look import (
    HOLD_COLOURS,
    INK,
    MUTED,
    OBJECT_COLOUR,
    SKIN_COLOUR,
    TABLE_COLOUR,
    TOUCH_COLOURS,
    number,
    swatch,
    text,
)
from jaxgrasp.report.panels import plots
from jaxgrasp.report.sections import details_html, figure_html
from jaxgrasp.report.surfaces import arrow

FRAMES = 100
"""At most so many instants are shown in three dimensions; the plots have all."""
LIGHT = {"ambient": 0.62, "diffuse": 0.6, "specular": 0.08, "roughness": 0.7, "fresnel": 0.05}


def write_grip_page(
    path: str | os.PathLike, scene: Scene, history: History, *, title: str, details: dict[str, str]
) -> None:
    """Write the page of a grip, whole or not at all.

    Args:
        path: the HTML file to write.
        scene: hand, object and table.
        history: what happened to them.
        title: the page's heading.
        details: names and texts that say where the numbers come from.

    Raises:
        ImportError: plotly is not installed.
    """
    page = grip_html(scene, history, title=title, details=details)
    replace_file(Path(path), lambda stream: stream.write(page.encode()))


def grip_html(scene: Scene, history: History, *, title: str, details: dict[str, str]) -> str:
    """Return the HTML page of a grip's history."""
    count = len(history.times)
    shown = np.unique(np.linspace(0, count - 1, min(count, FRAMES)).round().astype(int))
    film = _film(scene, history.at(shown))
    scale = Scale.of(history)
    body = f"""<header><h1>{text(title)}</h1></header>
<section id="grip"><div class="chooser"><button id="play">Play</button>
<input type="range" id="instant" min="0" max="{len(shown) - 1}" value="0" aria-label="instant">
<output id="clock"></output><label><input type="checkbox" id="close"> stay close to the hand</label>
<output id="state"></output></div>
<div class="film"><div><p class="note">{_legend(scale)}</p>
<div class="figure" id="view" style="min-height:{film["figure"]["layout"]["height"]}px"></div></div>
{figure_html("plots", plots(history))}</div>
<p class="note">{_caption(len(shown), count)}</p></section>
<section id="details"><h2>Details</h2>{details_html(details)}</section>
{embedded("film", film)}"""
    return page_html(title, body, "grip.js")


def _legend(scale: Scale) -> str:
    touches = ", ".join(f"{swatch(TOUCH_COLOURS[touch])}{touch.name.lower()}" for touch in VERBS)
    return (
        f"Arrows from the contact points. Force on the object, {number(1000 * scale.length)} mm for "
        f"{number(scale.newtons)} N, by what its contact does: {touches}. {swatch(INK)}Inward normal, "
        f"{number(1000 * NORMAL)} mm."
    )


def _caption(shown: int, count: int) -> str:
    part = "all" if shown == count else f"{shown} of"
    return (
        "Drag turns the view, the wheel zooms; a click in a plot goes to that instant, a double click shows its peaks, "
        "and the space bar plays. Solid: the applied law's forces; dotted: the squeezing forces that links intend "
        "(eq. 6). Friction margin: friction angle less slip angle, the smallest of a finger; a gap where none acts. "
        f"A joint torque is what the hand feels. In three dimensions {part} {count} instants are shown."
    )


def _film(scene: Scene, history: History) -> dict:
    """Return the animation's data: rigid parts, stored once, and poses and contacts of each frame."""
    stage = Stage.of(scene, history)
    body = len(stage.links)
    boxes = [stage.around(history, k) for k in range(len(history.times))]
    return {
        "figure": {"data": _traces(stage), "layout": _view(stage)},
        "rigid": [
            {"trace": 0, "parts": [_part(k, link.corners) for k, link in enumerate(stage.links)]},
            {"trace": 1, "parts": [_part(body, stage.object.corners)]},
            {"trace": 2, "parts": [_part(body, stage.object.lines)]},
        ],
        "arrow": {"corners": listed(arrow().corners, 4), "faces": arrow().faces.tolist(), "head": HEAD},
        "scale": Scale.of(history).metres,
        "normal": NORMAL,
        "touches": {str(int(touch)): touch.name.lower() for touch in VERBS},
        "links": list(history.links),
        "colours": {str(int(hold)): colour for hold, colour in HOLD_COLOURS.items()},
        "reach": round(largest_reach(boxes), 4),
        "frames": [_frame(history, k, box.mean(0)) for k, box in enumerate(boxes)],
    }


def _part(body: int, corners: np.ndarray) -> dict:
    return {"body": body, "corners": listed(corners, 5)}


def _frame(history: History, k: int, middle: np.ndarray) -> dict:
    drawn = np.flatnonzero(history.drawn[k])
    rows = np.concatenate([history.points[k], history.normals[k], history.forces[k]], -1)[drawn]
    bodies = np.concatenate([history.link_poses[k], history.object_pose[k][None]])
    return {
        "time": float(f"{history.times[k]:.4g}"),
        "hold": int(history.hold[k]),
        "said": history.description(k),
        "middle": listed(middle, 4),
        "poses": listed(bodies.reshape(-1, 12), 5),
        "contacts": {
            "links": drawn.tolist(),
            "touches": history.touches[k][drawn].tolist(),
            "vectors": listed(rows, 5),
            "margins": listed(np.degrees(history.margins[k][drawn]), 2),
        },
    }


def _traces(stage: Stage) -> list[dict]:
    """Return the traces without the coordinates of moving parts, which the page's script fills in."""
    skin = np.concatenate([link.faces + first for link, first in zip(stage.links, stage.first_corners, strict=True)])
    quiet = {"hoverinfo": "skip", "showlegend": False}
    light = {"lighting": LIGHT, "lightposition": {"x": 1000, "y": -2000, "z": 4000}, **quiet}
    traces = [
        {"type": "mesh3d", "name": "hand", **_corners_of(skin), "color": SKIN_COLOUR, **light},
        {"type": "mesh3d", "name": "object", **_corners_of(stage.object.faces), "color": OBJECT_COLOUR, **light},
        {"type": "scatter3d", "mode": "lines", "name": "edges", "line": {"color": MUTED, "width": 2}, **quiet},
        {"type": "mesh3d", "name": "normals", "color": INK, **quiet},
        *({"type": "mesh3d", "name": t.name.lower(), "color": TOUCH_COLOURS[t], **quiet} for t in VERBS),
        {"type": "scatter3d", "mode": "markers", "name": "contacts", "hoverinfo": "text", "showlegend": False},
    ]
    # Contacts lie between hand and object: both let them be seen.
    traces[0]["opacity"], traces[1]["opacity"] = 0.4, 0.3
    traces[-1]["marker"] = {"size": 4, "color": INK}
    if stage.table is not None:
        x, y, z = listed(stage.table.corners.T, 5)
        flat = {"lighting": {"ambient": 1, "diffuse": 0}, "opacity": 0.5, **quiet}
        table = {"x": x, "y": y, "z": z, **_corners_of(stage.table.faces), "color": TABLE_COLOUR}
        traces.append({"type": "mesh3d", "name": "table", **table, **flat})
    return traces


def _corners_of(faces: np.ndarray) -> dict:
    return dict(zip("ijk", faces.T.tolist(), strict=True))


def _view(stage: Stage) -> dict:
    """Return axes of equal scale around the whole stage; they stay fixed during the animation."""
    spans = zip("xyz", stage.box.T.tolist(), strict=True)
    axes = {f"{name}axis": axis3(name, *span) | {"showspikes": False} for name, span in spans}
    extent = stage.box[1] - stage.box[0]
    ratio = dict(zip("xyz", (np.sqrt(3) * extent / np.linalg.norm(extent)).tolist(), strict=True))
    camera = {"eye": {"x": 1.15, "y": 1.45, "z": 0.4}}
    shape = layout(640, scene={"aspectmode": "manual", "aspectratio": ratio, "camera": camera, **axes})
    shape["margin"] = {"l": 0, "r": 0, "t": 0, "b": 0}
    return shape
