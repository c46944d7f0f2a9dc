"""Page of a teleoperation: the robot's world as MuJoCo has it, contact forces, torques and state, in a browser."""

import time
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.substitution import FINGERS, Sensations
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Sphere
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.report.surfaces import shape_surface
from jaxgrasp.teleop.mujoco_hand import MujocoFollower

RATE = 30.0
"""Pictures per second."""
METRES_PER_NEWTON = 0.01
LINES: dict[str, Any] = {"thickness": 4.0, "thickness_units": "screen"}
VISUAL_GROUPS = (0, 1, 2)
"""Groups of geoms that are drawn, as in MuJoCo's own viewer."""
ROBOT_COLOUR, WORLD_COLOUR, FORCE_COLOUR = (120, 130, 150), (200, 190, 170), (214, 39, 40)


class TeleopPage:
    """Picture of a robot's world on a server; ``show`` it after each step, as often as you like."""

    def __init__(self, server: Any, follower: MujocoFollower, joints: Sequence[str]) -> None:
        """Draw the world as it stands.

        Args:
            server: from [`jaxgrasp.view.viewer_server.serving`][].
            follower: the robot.
            joints: names of the glove's joints, for the bars of their torques.
        """
        self._server, self._follower, self._joints = server, follower, tuple(joints)
        self._words = server.gui.add_html("")
        self._bars = server.gui.add_html("")
        self._shown_at = -np.inf
        mujoco, model = import_mujoco("TeleopPage"), follower.model
        server.scene.set_up_direction("+z")
        server.scene.add_grid("/table", width=1.0, height=1.0, cell_size=0.05)
        self._frames: dict[int, Any] = {}
        for body in range(model.nbody):
            first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
            for geom in range(first, first + count):
                surface = geom_surface(mujoco, model, geom)
                if surface is None or model.geom_group[geom] not in VISUAL_GROUPS:
                    continue
                if body not in self._frames:
                    self._frames[body] = server.scene.add_frame(f"/body {body}", show_axes=False)
                server.scene.add_mesh_simple(
                    f"/body {body}/geom {geom}",
                    *surface,
                    color=ROBOT_COLOUR if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH else WORLD_COLOUR,
                    position=model.geom_pos[geom],
                    wxyz=model.geom_quat[geom],
                )

    def show(
        self,
        words: str,
        torques: Float[np.ndarray, "channels"],
        limits: Float[np.ndarray, "channels"],
        sensations: Sensations | None = None,
    ) -> None:
        """Send the present state, at most ``RATE`` times a second.

        Args:
            words: line of text.
            torques: of the glove [N.m].
            limits: of these torques [N.m].
            sensations: vibration and heat by finger; None where there are none to be felt.
        """
        if time.perf_counter() - self._shown_at < 1 / RATE:
            return
        self._shown_at = time.perf_counter()
        data = self._follower.data
        with self._server.atomic():
            for body, frame in self._frames.items():
                frame.position, frame.wxyz = data.xpos[body], data.xquat[body]
            contacts = self._follower.contacts()
            ends = contacts.points + METRES_PER_NEWTON * contacts.forces
            # A segment of no length keeps the node where nothing touches.
            points = np.stack([contacts.points, ends], 1) if len(ends) else np.zeros((1, 2, 3))
            self._server.scene.add_line_segments("/forces", points, colors=FORCE_COLOUR, **LINES)
            self._words.content = f"<p>{escape(words)}</p>"
            bars = bars_html(self._joints, torques, limits)
            self._bars.content = bars + ("" if sensations is None else sensations_html(sensations))


def bars_html(
    joints: Sequence[str], torques: Float[np.ndarray, "channels"], limits: Float[np.ndarray, "channels"]
) -> str:
    """Return a table of the torques of joints with a motor, each with a bar of its share of the limit."""
    rows = [
        f"<tr><td>{escape(joint)}</td><td>{1e3 * torque:.0f} mN&middot;m</td>"
        f'<td><meter min="0" max="1" value="{min(max(torque / limit, 0.0), 1.0):.3f}"></meter></td></tr>'
        for joint, torque, limit in zip(joints, torques, limits, strict=True)
        if limit > 0
    ]
    return f"<table>{''.join(rows)}</table>"


def sensations_html(sensations: Sensations) -> str:
    """Return a table of each finger's vibration, with a bar, and of its target temperature where a heater is on."""
    rows = [
        f'<tr data-finger="{finger}"><td>{finger}</td><td>{100 * amplitude:.0f} %</td>'
        f'<td><meter min="0" max="1" value="{min(max(amplitude, 0.0), 1.0):.3f}"></meter></td>'
        f"<td>{f'{temperature:.1f} &deg;C' if temperature > 0 else ''}</td></tr>"
        for finger, amplitude, temperature in zip(FINGERS, *sensations, strict=True)
    ]
    return f"<p>vibration and heat</p><table data-sensations>{''.join(rows)}</table>"


def geom_surface(mujoco: Any, model: Any, geom: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Return vertices and triangles of a geom in its own frame; None for planes and other shapes."""
    kinds, size = mujoco.mjtGeom, model.geom_size[geom]
    kind = kinds(model.geom_type[geom])
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        vertices = slice(int(model.mesh_vertadr[mesh]), int(model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh]))
        faces = slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh] + model.mesh_facenum[mesh]))
        return np.array(model.mesh_vert[vertices]), np.array(model.mesh_face[faces])
    length, width, height = 2 * size
    shapes = {
        kinds.mjGEOM_BOX: lambda: Box(length, width, height),
        kinds.mjGEOM_CYLINDER: lambda: Cylinder(size[0], width),
        kinds.mjGEOM_CAPSULE: lambda: Capsule(size[0], width),
        kinds.mjGEOM_SPHERE: lambda: Sphere(size[0]),
    }
    if kind not in shapes:
        return None
    surface = shape_surface(shapes[kind]())
    return surface.corners, surface.faces
