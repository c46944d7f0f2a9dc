"""A grip over time as plain arrays: the poses and forces, the surfaces on its stage, and the scale of force arrows.

Its page and its pictures draw these.
"""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace

import numpy as np

from jaxgrasp.force.slip import friction_margin
from jaxgrasp.grip.monitor import Hold, Touch
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.simulation import Record
from jaxgrasp.hand.kinematics import ancestry, pose_hand
from jaxgrasp.model.hand import Hand, Posture
from jaxgrasp.report.grasp_in_3d import round_up
from jaxgrasp.report.look import counted
from jaxgrasp.report.surfaces import DrawnSurface, link_surfaces, placed, pose_matrix, shape_surface

VERBS = {Touch.HOLDS: "hold", Touch.SLIDES: "slide", Touch.PULLS: "pull"}


@dataclass(frozen=True)
class History:
    """T instants of a hand of L links and J joints, in the world and in SI units; NaN is what is not known."""

    fingers: tuple[str, ...]
    """Finger of each link."""
    links: tuple[str, ...]
    joint_fingers: tuple[str, ...]
    """The finger that each joint moves."""
    joints: tuple[str, ...]
    times: np.ndarray
    link_poses: np.ndarray
    """``(T, L, 3, 4)``: rotation and, as the last column, origin."""
    object_pose: np.ndarray
    """``(T, 3, 4)``: rotation and, as the last column, origin."""
    points: np.ndarray
    """``(T, L, 3)``"""
    normals: np.ndarray
    forces: np.ndarray
    """``(T, L, 3)``: of the applied law, on the object [N]."""
    touches: np.ndarray
    """``(T, L)``: codes of Touch."""
    squeeze: np.ndarray
    """``(T, L)``: intended normal forces [N], 0 where nothing touches."""
    margins: np.ndarray
    """``(T, L)``: friction angle less slip angle [rad]; NaN where no force acts."""
    torques: np.ndarray
    """``(T, J)`` [N.m]"""
    hold: np.ndarray
    """``(T,)``: codes of Hold."""

    @property
    def drawn(self) -> np.ndarray:
        """Mask ``(T, L)`` of contacts that exist and have finite coordinates."""
        is_finite = np.isfinite(self.points).all(-1) & np.isfinite(self.normals).all(-1)
        return (self.touches != Touch.ABSENT) & is_finite

    @property
    def pressing(self) -> np.ndarray:
        """Normal components ``(T, L)`` of the forces, along the inward normals [N]."""
        return np.einsum("tli,tli->tl", self.forces, self.normals)

    def description(self, k: int) -> str:
        """Return instant k as text: the object's hold, and the numbers of contacts that hold, slide or pull."""
        title = Hold(int(self.hold[k])).name.lower()
        touches = self.touches[k][self.touches[k] != Touch.ABSENT]
        if not len(touches):
            return f"{title}: nothing touches"
        counts_by_touch = [f"{(touches == touch).sum()} {VERBS[touch]}" for touch in VERBS if (touches == touch).any()]
        return f"{title}: {counted(len(touches), 'contact')}, {', '.join(counts_by_touch)}"

    def at(self, chosen: np.ndarray) -> "History":
        """Return the history at the chosen instants, an index array or mask over T."""
        over_time = {field.name: getattr(self, field.name) for field in fields(self) if field.type is np.ndarray}
        return replace(self, **{name: array[chosen] for name, array in over_time.items()})


def history(scene: Scene, postures: Posture, times: np.ndarray, record: Record) -> History:
    """Collect the history of a grip from the postures and the stacked record of the same T instants."""
    ticks = record.tick
    margins = np.asarray(friction_margin(ticks.grasp, ticks.assessment.forces, ticks.assessment.moments))
    links = pose_hand(scene.hand, postures).links
    is_present = ticks.contacts.present > 0
    return History(
        fingers=tuple(link.finger for link in scene.hand.links),
        links=tuple(link.name for link in scene.hand.links),
        joint_fingers=_joint_fingers(scene.hand),
        joints=scene.hand.joints,
        times=np.asarray(times, float),
        link_poses=pose_matrix(links),
        object_pose=pose_matrix(record.placed),
        points=np.asarray(ticks.contacts.points),
        normals=np.asarray(ticks.contacts.normals),
        forces=np.asarray(ticks.assessment.forces),
        touches=np.asarray(ticks.assessment.touches),
        squeeze=np.where(is_present, ticks.grasp.squeeze, 0),
        margins=np.where(np.isfinite(margins), margins, np.nan),
        torques=np.asarray(ticks.torques),
        hold=np.asarray(record.hold),
    )


def _joint_fingers(hand: Hand) -> tuple[str, ...]:
    moves = ancestry(hand)
    return tuple(hand.links[int(moves[:, j].argmax())].finger for j in range(len(hand.joints)))


NORMAL, HEAD = 0.015, 0.008
"""Lengths of a normal's arrow, and of an arrow's head [m]."""
LONG = 0.06
"""Approximate length of the arrow of a large force [m]."""
FALL, NEAR = 0.05, 0.12
"""Distances below the hand to which a lost object is followed, and to which a table is shown [m]."""
ROOM = 0.01


@dataclass(frozen=True)
class Scale:
    """A round length [m] and the force that it stands for [N]."""

    length: float
    newtons: float

    @property
    def metres(self) -> float:
        """Length at which a force of one newton is drawn [m]."""
        return self.length / self.newtons

    @staticmethod
    def of(history: History) -> "Scale":
        """Choose the scale by the 90% quantile of a grip's forces: a short peak would make all other arrows tiny."""
        sizes = np.linalg.norm(history.forces, axis=-1)
        loaded = sizes[history.drawn & (sizes > 0) & np.isfinite(sizes)]
        large = float(np.quantile(loaded, 0.9)) if len(loaded) else 1.0
        return Scale(0.01, round_up(large * 0.01 / LONG))


@dataclass(frozen=True)
class Stage:
    """Surfaces of hand, object and table, and the box that the view shows."""

    links: list[DrawnSurface]
    object: DrawnSurface
    table: DrawnSurface | None
    box: np.ndarray
    """``(2, 3)``: least and largest coordinates [m]."""

    @property
    def first_corners(self) -> np.ndarray:
        """Index of each link's first corner among the corners of the whole hand."""
        return np.cumsum([0, *(len(link.corners) for link in self.links[:-1])])

    def around(self, history: History, k: int) -> np.ndarray:
        """Return the box ``(2, 3)`` [m] of the hand at instant k, and of the object unless lost; `box` if unknown."""
        parts = [placed(link.corners, pose) for link, pose in zip(self.links, history.link_poses[k], strict=True)]
        if history.hold[k] != Hold.LOST:
            parts.append(placed(self.object.corners, history.object_pose[k]))
        corners = np.concatenate(parts)
        corners = corners[np.isfinite(corners).all(1)]
        return np.stack([corners.min(0), corners.max(0)]) if len(corners) else self.box

    @staticmethod
    def of(scene: Scene, history: History) -> "Stage":
        """Build the stage around all poses of the hand, of the object while it is held, and the start of its fall."""
        links, object_surface = link_surfaces(scene.hand), shape_surface(scene.body.shape)
        lost = history.hold == Hold.LOST
        link_corners = [placed(link.corners, history.link_poses[:, k]).reshape(-1, 3) for k, link in enumerate(links)]
        hand = np.concatenate(link_corners)
        held = placed(object_surface.corners, history.object_pose[~lost]).reshape(-1, 3)
        corners = np.concatenate([hand, held])
        corners = corners[np.isfinite(corners).all(-1)]
        if not len(corners):
            corners = np.zeros((1, 3))
        box = np.stack([corners.min(0) - ROOM, corners.max(0) + ROOM])
        if lost.any():
            box[0, 2] -= FALL
        height = (box[0] - scene.table.origin) @ np.asarray(scene.table.rotation)[:, 2]
        if height > NEAR:
            return Stage(links, object_surface, None, box)
        box[0, 2] -= max(float(height), 0.0)
        return Stage(links, object_surface, _table(scene, box), box)


def largest_reach(boxes: Iterable[np.ndarray]) -> float:
    """Return half the edge [m] of a cube that holds each of the boxes."""
    return max(float(np.ptp(box, axis=0).max()) for box in boxes) / 2


def _table(scene: Scene, box: np.ndarray) -> DrawnSurface:
    """Return a square of the table's top, as large as the box and below the box's middle."""
    origin, rotation = np.asarray(scene.table.origin), np.asarray(scene.table.rotation)
    middle = (box.mean(0) - origin) @ rotation
    reach = float(np.ptp(box[:, :2], axis=0).max()) / 2
    square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    corners = square * reach + [middle[0], middle[1], 0]
    return DrawnSurface(corners @ rotation.T + origin, np.array([[0, 1, 2], [0, 2, 3]]))
