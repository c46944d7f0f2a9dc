"""Grasp in three dimensions: contacts, normals, friction cones, and the forces of a closed form and its optimum."""

from collections.abc import Sequence

import numpy as np

from jaxgrasp.model.solution import Verdict
from jaxgrasp.report.figures import layout
from jaxgrasp.report.look import GRID, INK, METHOD_COLOURS, MUTED, VERDICT_COLOURS, WRENCH_COLOUR, degrees, number

MUCH_LARGER = 4
"""Ratio of forces from which the optimum's arrows have a scale of their own."""
SIDES = 28
"""Corners of a friction cone's rim."""
CONE, NORMAL, ARROW, HEAD = 0.34, 0.42, 0.9, 0.11
"""Lengths as shares of the contacts' spread: a cone's side, a normal, the longest arrow, an arrow's head."""


class Case:
    """Grasp, wrench, forces and scales of a drawn problem, in SI units; a missing answer has zero forces."""

    def __init__(self, case: dict):
        self.name = case["method"]
        names = ("points", "normals", "friction", "squeeze", "wrench", "closed", "optimum")
        self.has_closed, self.has_optimum = case["closed"] is not None, case["optimum"] is not None
        nothing = np.zeros_like(np.asarray(case["points"], float))
        arrays = {name: nothing if case[name] is None else np.asarray(case[name], float) for name in names}
        self.points, self.normals = arrays["points"], arrays["normals"]
        self.friction, self.squeeze = arrays["friction"], arrays["squeeze"]
        self.wrench, self.closed, self.optimum = arrays["wrench"], arrays["closed"], arrays["optimum"]
        self.centroid = self.points.mean(0)
        spread = float(np.linalg.norm(self.points - self.centroid, axis=1).max())
        self.spread = spread if spread > 0 else 0.01

        self.length = round_up(self.spread / 5)
        """A round length of arrow [m], which stands for ``newtons`` or ``optimum_newtons``."""
        closed_force, optimum_force = _largest(self.closed, self.wrench[None, :3]), _largest(self.optimum)
        # Near infeasibility the optimum's forces grow without bound, and one scale would hide the closed form's.
        has_both = self.has_closed and self.has_optimum
        if not has_both or max(closed_force, optimum_force) <= MUCH_LARGER * min(closed_force, optimum_force):
            closed_force = optimum_force = max(closed_force, optimum_force)
        self.newtons, self.optimum_newtons = self.newtons_for(closed_force), self.newtons_for(optimum_force)

    def newtons_for(self, largest: float) -> float:
        """Return the force [N] for which ``length`` stands, so that the largest force's arrow fits the scene."""
        return round_up(largest * self.length / (ARROW * self.spread))

    def angles(self, forces: np.ndarray) -> np.ndarray:
        """Return the slip angle of each contact [rad]; NaN at zero force, which has no slip angle."""
        normal_forces = np.einsum("ni,ni->n", forces, self.normals)
        tangential_forces = np.linalg.norm(np.cross(self.normals, forces), axis=1)
        return np.where(np.any(forces != 0, axis=1), np.arctan2(tangential_forces, normal_forces), np.nan)


def scene(case: Case, around: Sequence[dict] = ()) -> dict:
    """Return the figure of a case. Lengths in metres on equal axes; the legend states each arrow's scale.

    ``around`` are traces of hand, object or other surroundings.
    """
    name = case.name
    warm, cool = METHOD_COLOURS[name], METHOD_COLOURS[f"{name}-optimum"]
    traces = [
        *around,
        _cones(case),
        _lines("inward normal", case.points, case.points + NORMAL * case.spread * case.normals, MUTED, 2, dash="dot"),
        *force_arrows(case, f"closed form {name}", case.closed, case.newtons, warm, 7),
        *force_arrows(case, f"optimum {name}", case.optimum, case.optimum_newtons, cool, 5),
        *_wrench_arrow(case),
        _contacts(case),
    ]
    return framed(traces, case.centroid)


def framed(traces: list[dict], middle: np.ndarray) -> dict:
    """Return a figure of the traces in a cube about their middle that holds all of them, with equal axes."""
    reach = 1.04 * max(_reach(trace, middle) for trace in traces)
    axes = {f"{a}axis": axis3(a, at - reach, at + reach) for a, at in zip("xyz", middle.tolist(), strict=True)}
    camera = {"eye": {"x": 1.17, "y": 1.17, "z": 0.7}, "center": {"x": 0, "y": 0, "z": -0.08}}
    shape = layout(
        600,
        scene={"aspectmode": "cube", "camera": camera, **axes},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0, "itemsizing": "constant"},
    )
    shape["margin"] = {"l": 0, "r": 0, "t": 70, "b": 0}
    return {"data": traces, "layout": shape}


def scale_text(case: Case) -> str:
    """Return the scale of the arrows in words: the force [N] for which a length [mm] stands."""
    length = f"{number(1000 * case.length)} mm stand for"
    if case.newtons == case.optimum_newtons:
        return f"{length} {number(case.newtons)} N, for all arrows."
    ratio = number(case.optimum_newtons / case.newtons)
    return (
        f"{length} {number(case.newtons)} N for the closed form and the wrench, and for "
        f"{number(case.optimum_newtons)} N for the optimum, on a scale {ratio} times as coarse."
    )


def axis3(name: str, low: float, high: float) -> dict:
    """Return the settings of an axis [m] of a scene, over the range low to high."""
    font = {"size": 11, "color": MUTED}
    look = {
        "title": {"text": f"{name} [m]", "font": font},
        "tickfont": font,
        "gridcolor": GRID,
        "showbackground": False,
    }
    return {**look, "nticks": 6, "range": [low, high], "zeroline": False}


def _reach(trace: dict, centre: np.ndarray) -> float:
    """Return the largest distance [m] along any axis from a point to the coordinates of a trace."""
    coordinates = np.array([trace[axis] for axis in "xyz"], float)
    return float(np.nanmax(np.abs(coordinates - centre[:, None])))


def _contacts(case: Case) -> dict:
    return {
        "type": "scatter3d",
        "mode": "markers+text",
        "name": "contact",
        **xyz(case.points),
        "text": [f"<b>{i + 1}</b>" for i in range(len(case.points))],
        "textposition": "top center",
        "textfont": {"size": 14, "color": INK},
        "marker": {"size": 5, "color": INK},
        "hovertext": [_contact_text(case, i) for i in range(len(case.points))],
        "hoverinfo": "text",
    }


def _contact_text(case: Case, index: int) -> str:
    friction = case.friction[index]
    return (
        f"contact {index + 1}<br>friction {number(friction)}, angle {degrees(np.arctan(friction))}"
        f"<br>squeeze {number(case.squeeze[index])} N"
        + "".join(f"<br>{_force_text(case, title, forces, index)}" for title, forces in answers(case))
    )


def answers(case: Case) -> list[tuple[str, np.ndarray]]:
    """Return title and forces ``(n, 3)`` [N] of each answer that the case has."""
    candidates = ((case.has_closed, "closed form", case.closed), (case.has_optimum, "optimum", case.optimum))
    return [(f"{title} {case.name}", forces) for is_present, title, forces in candidates if is_present]


def _force_text(case: Case, title: str, forces: np.ndarray, index: int) -> str:
    size = float(np.linalg.norm(forces[index]))
    slip, limit = case.angles(forces)[index], np.arctan(case.friction[index])
    if np.isnan(slip):
        return f"{title}: no load"
    angles = f"slip {degrees(slip)}, friction {degrees(limit)}, margin {degrees(limit - slip)}"
    return f"{title}: |f| {number(size)} N, {angles}"


def force_arrows(case: Case, title: str, forces: np.ndarray, newtons: float, colour: str, width: int) -> list[dict]:
    """Return traces of the force arrows at all contacts with a nonzero force, at a scale of ``newtons``."""
    loaded = np.flatnonzero(np.any(forces != 0, axis=1))
    texts = [f"contact {i + 1}<br>{_force_text(case, title, forces, i)}" for i in loaded.tolist()]
    return _arrows(case, title, case.points[loaded], forces[loaded], newtons, texts, colour, width)


def _wrench_arrow(case: Case) -> list[dict]:
    force, torque = (float(np.linalg.norm(part)) for part in (case.wrench[:3], case.wrench[3:]))
    if force == 0:
        return []
    texts = [f"wrench: |force| {number(force)} N, |torque| {number(torque)} N·m about the origin"]
    tail, arrow = case.centroid[None], case.wrench[None, :3]
    return _arrows(case, "wrench's force", tail, arrow, case.newtons, texts, WRENCH_COLOUR, 5)


def _arrows(case: Case, title: str, tails, forces, newtons: float, texts, colour: str, width: int) -> list[dict]:
    """Return traces of shafts and heads; no traces without forces."""
    if not len(forces):
        return []
    arrows = forces * (case.length / newtons)
    lengths = np.linalg.norm(arrows, axis=1, keepdims=True)
    heads = np.minimum(HEAD * case.spread, 0.5 * lengths)
    tips, directions = tails + arrows, arrows / lengths
    name = f"{title} ({number(1000 * case.length)} mm = {number(newtons)} N)"
    shafts = _lines(name, tails, tips - heads * directions, colour, width, texts)
    tops = _mesh(tips, -directions, heads, 0.3 * heads, colour, 1.0, 12, closed=True)
    return [shafts | {"legendgroup": title}, tops | {"legendgroup": title, "hoverinfo": "skip"}]


def _lines(title: str, tails, tips, colour: str, width: int, texts=None, dash: str = "solid") -> dict:
    """Return a trace of separate segments, each ended by a gap."""
    gap = np.full_like(tails, np.nan)
    path = np.stack([tails, tips, gap], 1).reshape(-1, 3)
    hover: dict = {"hoverinfo": "skip"}
    if texts:
        hover = {"hovertext": [t for text in texts for t in (text, text, "")], "hoverinfo": "text"}
    line = {"color": colour, "width": width, "dash": dash}
    return {"type": "scatter3d", "mode": "lines", "name": title, **xyz(path), "line": line, **hover}


def _cones(case: Case) -> dict:
    """Return a trace of friction cones of equal side, so that large friction opens a cone and does not enlarge it."""
    angle = np.arctan(case.friction)[:, None]
    side = CONE * case.spread
    heights, radii = side * np.cos(angle), side * np.sin(angle)
    colour = VERDICT_COLOURS[Verdict.CLOSED_FORM_OPTIMAL]
    trace = _mesh(case.points, case.normals, heights, radii, colour, 0.18, SIDES, closed=False)
    return trace | {"name": "friction cone", "showlegend": True, "hoverinfo": "skip"}


def _mesh(apexes, axes, heights, radii, colour: str, opacity: float, sides: int, closed: bool) -> dict:
    """Build cones from triangles between apex and rim, and over the base where it is closed."""
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    first, second = across(axes)
    ring = np.cos(angles)[:, None, None] * first + np.sin(angles)[:, None, None] * second
    base = apexes + heights * axes
    rim = np.swapaxes(base + radii * ring, 0, 1)
    corners = np.concatenate([apexes[:, None], base[:, None], rim], 1)
    at, after = np.arange(sides) + 2, np.roll(np.arange(sides), -1) + 2
    faces = np.column_stack([np.zeros(sides, int), at, after])
    if closed:
        faces = np.concatenate([faces, np.column_stack([np.ones(sides, int), at, after])])
    faces = (faces + (sides + 2) * np.arange(len(apexes))[:, None, None]).reshape(-1, 3)
    triangles = dict(zip("ijk", faces.T.tolist(), strict=True))
    return {"type": "mesh3d", **xyz(corners.reshape(-1, 3)), **triangles, "color": colour, "opacity": opacity}


def across(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors perpendicular to each axis."""
    # The coordinate direction that an axis has least of is never parallel to it.
    least = np.eye(3)[np.abs(axes).argmin(1)]
    first = np.cross(axes, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axes, first)


def xyz(points: np.ndarray) -> dict:
    """Round coordinates to five digits, finer than a pixel; a gap is None."""
    columns = [[None if np.isnan(v) else float(f"{v:.5g}") for v in column] for column in points.T]
    return dict(zip("xyz", columns, strict=True))


def _largest(*forces: np.ndarray) -> float:
    return float(np.linalg.norm(np.vstack(forces), axis=1).max())


def round_up(value: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten; zero gives 1."""
    if value == 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9)) * power)
