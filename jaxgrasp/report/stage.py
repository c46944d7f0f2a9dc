"""Surfaces on the stage of a grip, the part of the world that is shown, and the scale of force arrows."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from jaxgrasp.grip.monitor import Hold
from jaxgrasp.grip.scene import Scene
from jaxgrasp.report.grasp_in_3d import round_up
from jaxgrasp.report.grip_over_time import History
from jaxgrasp.report.surfaces import DrawnSurface, link_surfaces, placed, shape_surface

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
