"""Page of viser that shows drawings: bodies are created once, and each instant moves, scales and colours them.

This module decides nothing: a Drawing holds the picture, and the text comes as HTML.
"""

import re
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.report.look import MUTED, OBJECT_COLOUR, SKIN_COLOUR, TABLE_COLOUR, text
from jaxgrasp.report.surfaces import DrawnSurface, bands, circle, hull
from jaxgrasp.view.drawing import Arrows, Drawing, Instances, escaped, rgb

ROUND = 20
"""Corners around cones and shafts."""
GREY, STALE_OPACITY = 150, 0.25
"""Background of an old picture, and opacity of its hand."""
OBJECT_OPACITY, CONE_OPACITY, WORLD_OPACITY = 0.3, 0.45, 0.6
"""Contacts lie between hand and object, which lets them be seen; so does the hand, if asked to."""
EYE, ASIDE = np.array([0.21, 0.25, 0.07]), 0.15
"""Position of the eye relative to an object in a hand [m], and its sideways offset as a share of that distance: text
stands on the right."""
FIELD_OF_VIEW = 0.6
"""Angle between the upper and the lower edge of the picture [rad]."""
MARGIN = 1.1
"""Distance of the eye relative to that at which what is shown touches the picture's edges."""
DEPTH_RANGE = 50.0
"""Ratio of the distance of the eye to the nearest distance that is drawn, and of the furthest to it."""
LAYERS = {"friction cones": "cones", "closed form": "B", "optimum": "B-optimum", "load": "load"}
"""Parts that can be hidden, by their label in the panel."""
CORNER = (
    "position:fixed;right:14px;top:60px;width:390px;max-height:calc(100vh - 90px);overflow:auto;background:#ffffffee;"
    "border-radius:10px;box-shadow:0 1px 8px #0003;padding:6px"
)
"""Style of the text beside a saved scene."""
TITLE = re.compile("<title>.*?</title>", re.DOTALL)
LINES: dict[str, Any] = {"thickness": 1.5, "thickness_units": "screen"}
BRAND = (0, 114, 178)


class Viewer:
    """Page with a scene whose parts persist and move."""

    def __init__(
        self,
        server: Any,
        links: Sequence[DrawnSurface] = (),
        object_surface: DrawnSurface | None = None,
        fixed: Sequence[DrawnSurface] = (),
        other_surfaces: Sequence[DrawnSurface] = (),
        moving: Sequence[DrawnSurface] = (),
    ):
        """Create the parts of the page, without an instant.

        Args:
            server: of [`serving`][jaxgrasp.view.viewer_server.serving].
            links: the skin of the hand's links, each in its own frame.
            object_surface: the object, in its own frame.
            fixed: surfaces that never move, in the world: a table, obstacles.
            other_surfaces: further objects, each in its own frame.
            moving: obstacles that move, likewise.
        """
        self.server, self._scene = server, server.scene
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large", brand_color=BRAND)
        self._light()
        self._parts: dict[str, Any] = {}
        self._edges: Any = None
        self._links = [self._link(k, link) for k, link in enumerate(links)]
        self._object = self._scene.add_frame("/object", show_axes=False)
        if object_surface is not None:
            self._add_object(object_surface)
        for k, surface in enumerate(fixed):
            self._add_fixed(f"/world/{k}", surface)
        names = [f"/moving/{k}" for k in range(len(other_surfaces) + len(moving))]
        self._moving = [self._scene.add_frame(name, show_axes=False) for name in names]
        for name, surface in zip(names, other_surfaces, strict=False):
            self._add_surface(name, surface)
            self._add_lines(name, surface)
        for name, surface in zip(names[len(other_surfaces) :], moving, strict=True):
            self._add_fixed(name, surface)
        self._drawn: Drawing | None = None
        self._is_stale = False
        self._hidden_by_age: dict[str, bool] = {}
        """Parts that are hidden while the picture is old, and whether they were visible before."""

    def look_from(self, eye: np.ndarray, at: np.ndarray) -> None:
        """Set the initial camera: it looks at a place from ``eye`` relative to it, beside the panel."""
        right = np.cross(-eye, [0.0, 0.0, 1.0])
        aside = ASIDE * np.linalg.norm(eye) * right / np.linalg.norm(right)
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.up = tuple(at + eye + aside), tuple(at + aside), (0.0, 0.0, 1.0)
        camera.near, camera.far, camera.fov = 0.005, 20.0, FIELD_OF_VIEW

    def fit(self, points: np.ndarray, eye: np.ndarray = EYE) -> None:
        """Set the initial camera so that points ``(P, 3)`` [m] fill the part of the picture beside the panel.

        ``eye`` is the direction from which it looks; nothing changes without points that lie apart.
        """
        if not len(points):
            return
        center = (points.min(0) + points.max(0)) / 2
        radius = np.linalg.norm(points - center, axis=1).max()
        if radius > 0:
            # A ball touches the upper and the lower edge of a picture of this angle at r = d sin(fov / 2).
            distance = MARGIN * radius / np.sin(FIELD_OF_VIEW / 2)
            self.look_from(distance * eye / np.linalg.norm(eye), center)
            camera = self.server.initial_camera
            camera.near, camera.far = distance / DEPTH_RANGE, distance * DEPTH_RANGE

    def show(self, drawn: Drawing) -> None:
        """Show an instant; browsers get it whole."""
        with self.server.atomic():
            self._place_bodies(drawn.links, drawn.object_pose)
            if self._moving:
                _set_poses(self._moving, drawn.moving)
            self._instances("/cones", cone(), drawn.cones, CONE_OPACITY)
            self._instances("/contacts", ball(), drawn.contacts)
            for name, arrows in drawn.forces.items():
                self._arrows(f"/forces/{name}", arrows)
            self._arrows("/load", drawn.load)
        self._drawn = drawn
        self.server.flush()

    def show_bodies(self, links: np.ndarray | None, object_pose: np.ndarray) -> None:
        """Move hand and object to their poses, and leave all other parts as they are."""
        with self.server.atomic():
            self._place_bodies(links, object_pose)
        self.server.flush()

    def show_escape(self, twist: np.ndarray, share: float) -> None:
        """Show the object displaced along a share, 0 to 1, of a twist."""
        if self._drawn is not None:
            with self.server.atomic():
                _set_poses([self._object], escaped(self._drawn.object_pose, twist, self._drawn.origin, share)[None])
            self.server.flush()

    def set_edges(self, lines: np.ndarray) -> None:
        """Set the lines ``(S, 2, 3)`` that stand for the object, in its own frame [m]."""
        if self._edges is None:
            self._edges = self._scene.add_line_segments("/object/edges", lines, rgb(MUTED), **LINES)
        else:
            self._edges.points = _floats(lines)

    def set_opacity(self, opacity: float) -> None:
        """Set the opacity of the hand, 0 to 1."""
        for handle in self._links:
            handle.opacity = None if opacity >= 1 else opacity

    def set_stale(self, is_stale: bool) -> None:
        """Grey out the picture where it is old: a grey background, a faint hand, and no forces; or undo that."""
        if is_stale == self._is_stale:
            return
        self._is_stale = is_stale
        # Without an image the background would be black once it had been grey.
        self._scene.set_background_image(np.full((2, 2, 3), GREY if is_stale else 255, np.uint8))
        self.set_opacity(STALE_OPACITY if is_stale else 1.0)
        for name, handle in self._parts.items():
            if is_stale:
                self._hidden_by_age[name] = handle.visible
                handle.visible = False
            else:
                handle.visible = self._hidden_by_age.get(name, handle.visible)

    def add_layers(self) -> None:
        """Add the checkboxes that show and hide parts."""
        for label, part in LAYERS.items():
            box = self.server.gui.add_checkbox(label, True)
            box.on_update(lambda _, part=part, box=box: self.set_visible(part, box.value))

    def set_visible(self, part: str, visible: bool) -> None:
        """Show or hide a part: ``cones``, ``B`` or ``B-optimum``, or ``load``."""
        for name, handle in self._parts.items():
            if part in name.split("/"):
                handle.visible = visible

    def html(self, words: str, title: str = "") -> str:
        """Return the current scene as an HTML page that opens offline, with words in a corner.

        ``title`` is that of the page; viser's own where it is empty.
        """
        page = self.server.get_scene_serializer().as_html()
        if title:
            page = TITLE.sub(lambda _: f"<title>{text(title)}</title>", page, count=1)
        return page.replace("</body>", f'<aside style="{CORNER}">{words}</aside></body>')

    def _place_bodies(self, links: np.ndarray | None, object_pose: np.ndarray) -> None:
        bodies, poses = [self._object], object_pose[None]
        if links is not None:
            bodies, poses = [*bodies, *self._links], np.concatenate([poses, links])
        _set_poses(bodies, poses)

    def _light(self) -> None:
        """Light the scene softly from all sides and from above a shoulder, so that colours match the reports."""
        self._scene.configure_environment_map(None)
        self._scene.configure_default_lights(False)
        self._scene.add_light_hemisphere(
            "/light/sky", sky_color=(255, 255, 255), ground_color=(176, 170, 164), intensity=2.7
        )
        self._scene.add_light_directional("/light/sun", intensity=1.5, position=(0.6, 0.9, 1.4))

    def _link(self, k: int, link: DrawnSurface) -> Any:
        return self._scene.add_mesh_simple(
            f"/hand/{k}", link.corners, link.faces, color=rgb(SKIN_COLOUR), cast_shadow=False, receive_shadow=False
        )

    def _add_fixed(self, name: str, surface: DrawnSurface) -> None:
        self._scene.add_mesh_simple(
            f"{name}/surface",
            surface.corners,
            surface.faces,
            color=rgb(TABLE_COLOUR),
            opacity=WORLD_OPACITY,
            side="double",
            flat_shading=True,
            cast_shadow=False,
            receive_shadow=False,
        )
        self._add_lines(name, surface)

    def _add_lines(self, name: str, surface: DrawnSurface) -> None:
        if len(surface.lines):
            self._scene.add_line_segments(f"{name}/edges", segments(surface.lines), rgb(MUTED), **LINES)

    def _add_object(self, surface: DrawnSurface) -> None:
        self._add_surface("/object", surface)
        if len(surface.lines):
            self.set_edges(segments(surface.lines))

    def _add_surface(self, name: str, surface: DrawnSurface) -> None:
        if len(surface.faces):
            self._scene.add_mesh_simple(
                f"{name}/surface",
                surface.corners,
                surface.faces,
                color=rgb(OBJECT_COLOUR),
                opacity=OBJECT_OPACITY,
                side="double",
                flat_shading=False,
                receive_shadow=False,
            )

    def _instances(self, name: str, body: DrawnSurface, instances: Instances, opacity: float | None = None) -> None:
        handle = self._parts.get(name)
        if handle is None or len(handle.batched_positions) != len(instances.positions):
            self._parts[name] = self._scene.add_batched_meshes_simple(
                name,
                body.corners,
                body.faces,
                instances.quaternions,
                instances.positions,
                batched_scales=instances.scales,
                batched_colors=linear(instances.colours),
                lod="off",
                opacity=opacity,
                side="double" if opacity else "front",
                cast_shadow=False,
                receive_shadow=False,
            )
            return
        handle.batched_positions, handle.batched_wxyzs = _floats(instances.positions), _floats(instances.quaternions)
        handle.batched_scales, handle.batched_colors = _floats(instances.scales), linear(instances.colours)

    def _arrows(self, name: str, arrows: Arrows) -> None:
        self._instances(f"{name}/shafts", shaft(), arrows.shafts)
        self._instances(f"{name}/heads", head(), arrows.heads)


def _set_poses(bodies: Sequence[Any], poses: np.ndarray) -> None:
    turns = Rotation.from_matrix(poses[:, :, :3]).as_quat(scalar_first=True)
    for body, pose, turn in zip(bodies, poses, turns, strict=True):
        body.position, body.wxyz = pose[:, 3], turn


def _floats(array: np.ndarray) -> np.ndarray:
    return np.asarray(array, np.float32)


def linear(colours: np.ndarray) -> np.ndarray:
    """Convert sRGB bytes to linear bytes: viser takes linear colours for instances, and sRGB for all other parts."""
    shares = colours / 255
    light = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    return np.round(255 * light).astype(np.uint8)


def segments(lines: np.ndarray) -> np.ndarray:
    """Split lines ``(E, 3)``, each ended by NaN, into their segments ``(S, 2, 3)``."""
    pairs = np.stack([lines[:-1], lines[1:]], 1)
    return pairs[np.isfinite(pairs).all((1, 2))]


@cache
def ball() -> DrawnSurface:
    """Return a ball of radius 1."""
    return hull(np.zeros((1, 3)), np.ones(1), 12)


@cache
def cone() -> DrawnSurface:
    """Return an open cone from its apex at the origin to a rim of radius 1 at z = 1."""
    return _between(0.0, 1.0)


@cache
def head() -> DrawnSurface:
    """Return an arrow's head: from a closed base of radius 1 at the origin to its apex at z = 1."""
    sides = _between(1.0, 0.0)
    base = np.vstack([sides.corners[:ROUND], [[0.0, 0, 0]]])
    at, after = np.arange(ROUND), (np.arange(ROUND) + 1) % ROUND
    disc = np.column_stack([np.full(ROUND, ROUND), after, at]) + len(sides.corners)
    return DrawnSurface(np.vstack([sides.corners, base]), np.vstack([sides.faces, disc]))


@cache
def shaft() -> DrawnSurface:
    """Return a tube of radius 1 from the origin to z = 1."""
    return _between(1.0, 1.0)


def _between(low: float, high: float) -> DrawnSurface:
    """Return the surface between two rims about z, at z = 0 and z = 1, of these radii."""
    ring = circle(ROUND)
    rims = [np.column_stack([radius * ring, np.full(ROUND, z)]) for radius, z in ((low, 0.0), (high, 1.0))]
    return DrawnSurface(np.vstack(rims), bands(2, ROUND))
