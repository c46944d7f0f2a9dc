"""Page of a teleoperation: the robot's world as MuJoCo has it, contact forces, torques and state, in a browser.

A process of its own shows it, so that no step of person or robot waits for a browser.
"""

import time
from collections.abc import Callable, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.loop.exchange import WORDS_SIZE, GloveState, Slot, pack_words, unpack_words
from jaxgrasp.glove.protocol.device import N_FINGERS
from jaxgrasp.glove.substitution import FINGERS, Sensations
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Sphere
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.report.surfaces import shape_surface
from jaxgrasp.teleop.mujoco_hand import MujocoFollower
from jaxgrasp.view.panel_words import FeltNotice
from jaxgrasp.view.view_slots import ViewFeed, ViewFrame
from jaxgrasp.view.viewer import FIELD_OF_VIEW

RATE = 30.0
"""Pictures per second."""
METRES_PER_NEWTON = 0.01
EYE = np.array([0.42, -0.3, 0.3])
"""Place of the camera from the object at the start [m]."""
MAX_CONTACTS = 64
"""Largest number of contacts that a page shows."""
NO_GLOVE = -1
"""Code in place of a glove's [`LinkState`][jaxgrasp.glove.glove_device.LinkState]."""
LINES: dict[str, Any] = {"thickness": 4.0, "thickness_units": "screen"}
VISUAL_GROUPS = (0, 1, 2)
"""Groups of geoms that are drawn, as in MuJoCo's own viewer."""
ROBOT_COLOUR, WORLD_COLOUR, FORCE_COLOUR = (120, 130, 150), (200, 190, 170), (214, 39, 40)


class TeleopPicture(NamedTuple):
    """Robot's world and state of a teleoperation at one time, as a page shows it."""

    poses: Float[np.ndarray, "bodies 7"]
    """Origin [m] and unit quaternion (w, x, y, z) of each body."""
    points: Float[np.ndarray, "contacts 3"]
    """Contact points of the robot's hand [m]."""
    forces: Float[np.ndarray, "contacts 3"]
    """Contact forces on the object [N]."""
    words: str
    """Line of text, of which 120 bytes are shown."""
    sensations: Sensations | None = None
    """Vibration and heat by finger; None where there are none to be felt."""

    @staticmethod
    def size(n_bodies: int) -> int:
        """Return the length of the vector."""
        return 7 * n_bodies + 6 * MAX_CONTACTS + WORDS_SIZE + 2 * N_FINGERS

    def vector(self) -> Float[np.ndarray, "size"]:
        """Pack all fields into a vector; of more than 64 contacts, those with the largest forces."""
        kept = np.argsort(-np.linalg.norm(self.forces, axis=-1))[:MAX_CONTACTS]
        contacts = np.full((MAX_CONTACTS, 6), np.nan)
        contacts[: len(kept)] = np.concatenate([self.points[kept], self.forces[kept]], 1)
        sensations = np.full(2 * N_FINGERS, np.nan) if self.sensations is None else self.sensations.vector()
        return np.concatenate([self.poses.ravel(), contacts.ravel(), pack_words(self.words), sensations])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], n_bodies: int) -> "TeleopPicture":
        """Unpack a picture from its vector, with this number of bodies."""
        ends = np.cumsum([7 * n_bodies, 6 * MAX_CONTACTS, WORDS_SIZE])
        poses, contacts, words, sensations = np.split(vector, ends)
        contacts = contacts.reshape(-1, 6)
        contacts = contacts[np.isfinite(contacts).all(-1)]
        felt = Sensations.of(sensations) if np.isfinite(sensations).all() else None
        return TeleopPicture(poses.reshape(-1, 7), contacts[:, :3], contacts[:, 3:], unpack_words(words), felt)


class TeleopFeed:
    """Page of a teleoperation in its own process, which no step waits for; ``show`` the robot as often as you like."""

    def __init__(
        self,
        follower: MujocoFollower,
        joints: Sequence[str],
        limits: Float[np.ndarray, "channels"],
        port: int,
    ) -> None:
        """Start the page's process and wait until it listens.

        Args:
            follower: the robot.
            joints: names of the glove's joints, for the bars of their torques.
            limits: of these torques [N.m].
            port: of the page; 0 for any that is free.

        Raises:
            OSError: for a port that is taken, or if the process does not come to listen.
            ImportError: viser is not installed.
        """
        self._follower, self._shown_at = follower, -np.inf
        place = np.array(follower.data.body("object").xpos)
        shown = {"teleop": follower.model, "place": place, "joints": tuple(joints), "limits": np.asarray(limits)}
        self._feed = ViewFeed(len(joints), TeleopPicture.size(follower.model.nbody), shown, (port,))
        self.address = self._feed.addresses[0]
        self._unknown = np.full(len(joints), np.nan)

    def show(
        self,
        words: str,
        torques: Float[np.ndarray, "channels"],
        sensations: Sensations | None = None,
        glove: GloveState | None = None,
    ) -> None:
        """Hand the present state to the page, at most ``RATE`` times a second.

        Args:
            words: line of text.
            torques: of the glove [N.m].
            sensations: vibration and heat by finger; None where there are none to be felt.
            glove: state of the glove, to say why no torque is felt; None without a glove.
        """
        timestamp = time.perf_counter()
        if timestamp - self._shown_at < 1 / RATE:
            return
        self._shown_at = timestamp
        data, contacts = self._follower.data, self._follower.contacts()
        poses = np.concatenate([data.xpos, data.xquat], 1)
        picture = TeleopPicture(poses, contacts.points, contacts.forces, words, sensations)
        at, link, guard, cause = 0.0, NO_GLOVE, 0, ""
        if glove is not None:
            at, link, guard, cause = float(np.nan_to_num(glove.angles_at)), glove.link, glove.guard, glove.cause
        arrays = (self._unknown, torques, self._unknown, picture.vector())
        self._feed.write(ViewFrame(at, link, guard, *arrays, cause=cause, ticked_at=timestamp))

    def close(self) -> None:
        """End the page."""
        self._feed.close()

    def __enter__(self) -> "TeleopFeed":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class TeleopPage:
    """Robot's world on a server, as its feed has it."""

    def __init__(
        self,
        server: Any,
        model: Any,
        place: Float[np.ndarray, "3"],
        joints: Sequence[str],
        limits: Float[np.ndarray, "channels"],
        slot: Slot,
    ) -> None:
        """Draw all bodies, at the world's origin until the first picture.

        Args:
            server: from [`jaxgrasp.view.viewer_server.serving`][].
            model: compiled model of MuJoCo.
            place: at which the camera looks [m].
            joints: names of the glove's joints, for the bars of their torques.
            limits: of these torques [N.m].
            slot: of the frames.
        """
        self._server, self._joints, self._limits, self._slot = server, tuple(joints), limits, slot
        self._notice = FeltNotice(server)
        self._words = server.gui.add_html("")
        self._bars = server.gui.add_html("")
        self._vector: np.ndarray | None = None
        self._shown: ViewFrame | None = None
        self._n_bodies = int(model.nbody)
        mujoco = import_mujoco("TeleopPage")
        server.scene.set_up_direction("+z")
        server.scene.add_grid("/table", width=1.0, height=1.0, cell_size=0.05)
        camera = server.initial_camera
        camera.position, camera.look_at, camera.up = tuple(place + EYE), tuple(place), (0.0, 0.0, 1.0)
        camera.near, camera.far, camera.fov = 0.01, 20.0, FIELD_OF_VIEW
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

    def show_initial(self) -> None:
        """Show what there is before the first frame: bodies without poses."""

    def run(self, is_running: Callable[[], bool] = lambda: True) -> None:
        """Show each new frame until it goes on no more."""
        while is_running():
            self.frame()
            time.sleep(1 / RATE)

    def frame(self) -> None:
        """Show the newest frame, and how old it is."""
        vector = self._slot.read()
        if vector is not None and vector is not self._vector:
            self._vector, self._shown = vector, ViewFrame.of(vector, len(self._joints))
            self._show(self._shown, TeleopPicture.of(self._shown.extra, self._n_bodies))
        if self._shown is not None and self._shown.link != NO_GLOVE:
            self._notice.update(self._shown, self._shown)

    def _show(self, frame: ViewFrame, picture: TeleopPicture) -> None:
        with self._server.atomic():
            for body, part in self._frames.items():
                part.position, part.wxyz = picture.poses[body, :3], picture.poses[body, 3:]
            ends = picture.points + METRES_PER_NEWTON * picture.forces
            # A segment of no length keeps the node where nothing touches.
            points = np.stack([picture.points, ends], 1) if len(ends) else np.zeros((1, 2, 3))
            self._server.scene.add_line_segments("/forces", points, colors=FORCE_COLOUR, **LINES)
            self._words.content = f"<p>{escape(picture.words)}</p>"
            bars = bars_html(self._joints, frame.torques, self._limits)
            self._bars.content = bars + ("" if picture.sensations is None else sensations_html(picture.sensations))


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
