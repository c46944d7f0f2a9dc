"""One grasp in three dimensions: contacts, normals, friction cones, and the forces of a closed form and its optimum."""

import numpy as np

from jaxgrasp.report.figures import layout
from jaxgrasp.report.look import GRID, INK, METHOD_COLOURS, MUTED, WRENCH_COLOUR, degrees, number

SIDES = 28
"""Corners of a friction cone's rim."""
CONE, NORMAL, ARROW, HEAD = 0.34, 0.42, 0.9, 0.11
"""Lengths as shares of the contacts' spread: a cone's side, a normal, the longest arrow, an arrow's head."""


class Case:
    """A worst case with what is needed to draw it, in SI units."""

    def __init__(self, case: dict):
        self.name = case["method"]
        names = ("points", "normals", "friction", "squeeze", "wrench", "closed", "optimum")
        arrays = {name: np.asarray(case[name], float) for name in names}
        self.points, self.normals = arrays["points"], arrays["normals"]
        self.friction, self.squeeze = arrays["friction"], arrays["squeeze"]
        self.wrench, self.closed, self.optimum = arrays["wrench"], arrays["closed"], arrays["optimum"]
        self.centroid = self.points.mean(0)
        spread = float(np.linalg.norm(self.points - self.centroid, axis=1).max())
        self.spread = spread if spread > 0 else 0.01

    @property
    def scale(self) -> tuple[float, float]:
        """A round length of arrow [m] and the round force [N] that it stands for, the same for all arrows."""
        forces = np.vstack([self.closed, self.optimum, self.wrench[None, :3]])
        largest = np.linalg.norm(forces, axis=1).max() or 1.0
        length = _round_up(self.spread / 5)
        return length, _round_up(largest * length / (ARROW * self.spread))

    def arrow(self, force: np.ndarray) -> np.ndarray:
        length, newtons = self.scale
        return force * (length / newtons)

    def angles(self, forces: np.ndarray) -> np.ndarray:
        """Slip angle of each contact [rad]; NaN where it carries nothing, for zero force has no slip angle."""
        along = np.einsum("ni,ni->n", forces, self.normals)
        across = np.linalg.norm(np.cross(self.normals, forces), axis=1)
        return np.where(np.any(forces != 0, axis=1), np.arctan2(across, along), np.nan)


def scene(case: Case) -> dict:
    """The figure. Lengths in metres on equal axes; all arrows share one scale."""
    optimum = f"{case.name}-optimum"
    normals = case.points + NORMAL * case.spread * case.normals
    force = case.centroid[None], case.wrench[None, :3]
    traces = [
        _cones(case),
        _lines("inward normal", case.points, normals, MUTED, 2, dash="dot"),
        *_arrows(case, f"closed form {case.name}", case.points, case.closed, METHOD_COLOURS[case.name], 7),
        *_arrows(case, f"optimum {case.name}", case.points, case.optimum, METHOD_COLOURS[optimum], 5),
        *_arrows(case, "wrench's force, at the centroid", *force, WRENCH_COLOUR, 5),
        _contacts(case),
    ]
    axes = {f"{name}axis": _axis(name) for name in "xyz"}
    camera = {"eye": {"x": 1.25, "y": 1.25, "z": 0.75}}
    shape = layout(
        560,
        scene={"aspectmode": "data", "camera": camera, **axes},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0, "itemsizing": "constant"},
    )
    shape["margin"] = {"l": 0, "r": 0, "t": 30, "b": 0}
    return {"data": traces, "layout": shape}


def scale_text(case: Case) -> str:
    length, newtons = case.scale
    return f"{number(1000 * length)} mm of arrow stand for {number(newtons)} N, for every arrow."


def _axis(name: str) -> dict:
    font = {"size": 11, "color": MUTED}
    return {"title": {"text": f"{name} [m]", "font": font}, "tickfont": font, "nticks": 5, "gridcolor": GRID,
            "showbackground": False, "zeroline": False}  # fmt: skip


def _contacts(case: Case) -> dict:
    return {
        "type": "scatter3d",
        "mode": "markers+text",
        "name": "contact",
        **_xyz(case.points),
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
        f"<br>{_force_text(case, 'closed form ' + case.name, case.closed, index)}"
        f"<br>{_force_text(case, 'optimum ' + case.name, case.optimum, index)}"
    )


def _force_text(case: Case, title: str, forces: np.ndarray, index: int) -> str:
    size = np.linalg.norm(forces[index])
    slip, limit = case.angles(forces)[index], np.arctan(case.friction[index])
    if np.isnan(slip):
        return f"{title}: no load"
    return f"{title}: |f| {number(size)} N, slip {degrees(slip)}, friction {degrees(limit)}, margin {degrees(limit - slip)}"


def _arrows(case: Case, title: str, tails: np.ndarray, forces: np.ndarray, colour: str, width: int) -> list[dict]:
    """Shafts and heads; a force of zero has neither."""
    loaded = np.flatnonzero(np.any(forces != 0, axis=1))
    if not len(loaded):
        return []
    tails, arrows = tails[loaded], case.arrow(forces[loaded])
    lengths = np.linalg.norm(arrows, axis=1, keepdims=True)
    heads = np.minimum(HEAD * case.spread, 0.5 * lengths)
    tips, along = tails + arrows, arrows / lengths
    at_contacts = len(forces) == len(case.points) and "wrench" not in title
    if at_contacts:
        texts = [f"contact {i + 1}<br>{_force_text(case, title, forces, i)}" for i in loaded]
    else:
        torque = number(float(np.linalg.norm(case.wrench[3:])))
        texts = [f"wrench: |force| {number(float(np.linalg.norm(forces)))} N, |torque| {torque} N·m about the origin"]
    shafts = _lines(title, tails, tips - heads * along, colour, width, texts)
    rims = 0.3 * heads
    tops = _mesh(tips, -along, heads, rims, colour, 1.0, 12, closed=True)
    return [shafts | {"legendgroup": title}, tops | {"legendgroup": title, "hoverinfo": "skip"}]


def _lines(title: str, tails, tips, colour: str, width: int, texts: list[str] | None = None, dash: str = "solid") -> dict:
    """Separate segments in one trace: each is ended by a gap."""
    gap = np.full_like(tails, np.nan)
    path = np.stack([tails, tips, gap], 1).reshape(-1, 3)
    hover = {"hovertext": [t for text in texts for t in (text, text, "")], "hoverinfo": "text"} if texts else {"hoverinfo": "skip"}
    line = {"color": colour, "width": width, "dash": dash}
    return {"type": "scatter3d", "mode": "lines", "name": title, **_xyz(path), "line": line, **hover}


def _cones(case: Case) -> dict:
    """Friction cones of equal side, so that large friction opens the cone and does not enlarge it."""
    angle = np.arctan(case.friction)[:, None]
    side = CONE * case.spread
    trace = _mesh(case.points, case.normals, side * np.cos(angle), side * np.sin(angle), "#009E73", 0.18, SIDES, closed=False)
    return trace | {"name": "friction cone", "showlegend": True, "hoverinfo": "skip"}


def _mesh(apexes, axes, heights, radii, colour: str, opacity: float, sides: int, closed: bool) -> dict:
    """Cones as triangles from apex to rim, and over the base where it is closed."""
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    first, second = _across(axes)
    ring = np.cos(turn)[:, None, None] * first + np.sin(turn)[:, None, None] * second
    base = apexes + heights * axes
    rim = np.swapaxes(base + radii * ring, 0, 1)
    corners = np.concatenate([apexes[:, None], base[:, None], rim], 1)
    at, after = np.arange(sides) + 2, np.roll(np.arange(sides), -1) + 2
    faces = np.column_stack([np.zeros(sides, int), at, after])
    if closed:
        faces = np.concatenate([faces, np.column_stack([np.ones(sides, int), at, after])])
    faces = (faces + (sides + 2) * np.arange(len(apexes))[:, None, None]).reshape(-1, 3)
    corner_lists = dict(zip("ijk", faces.T.tolist(), strict=True))
    return {"type": "mesh3d", **_xyz(corners.reshape(-1, 3)), **corner_lists, "color": colour, "opacity": opacity, "flatshading": False}


def _across(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across each axis."""
    # The coordinate direction that an axis has least of is never parallel to it.
    least = np.eye(3)[np.abs(axes).argmin(1)]
    first = np.cross(axes, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axes, first)


def _xyz(points: np.ndarray) -> dict:
    """Coordinates to five digits, finer than a pixel; a gap is null."""
    columns = [[None if np.isnan(v) else float(f"{v:.5g}") for v in column] for column in points.T]
    return dict(zip("xyz", columns, strict=True))


def _round_up(value: float) -> float:
    """The next number of the form 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9)) * power)
