"""The world around an object: the table's top below it, where it is near, and obstacles, which may move."""

import numpy as np

from jaxgrasp.grip.scene import Scene, obstacles_at_time
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.surfaces import DrawnSurface, moved, pose_matrix, shape_surface

NEAR = 0.2
"""Largest distance below an object at which a table is shown [m]."""
EDGE = 0.4
"""Edge of the shown part of the table [m]."""


def standing_surfaces(scene: Scene, at: Pose) -> list[DrawnSurface]:
    """Return the surfaces in the world of table and obstacles that never move.

    Args:
        scene: whose table and obstacles.
        at: where the object is at first.
    """
    found = []
    table = pose_matrix(scene.table)
    middle = (np.asarray(at.origin) - table[:, 3]) @ table[:, :3]
    if 0 <= middle[2] <= NEAR:
        square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * EDGE / 2 + [middle[0], middle[1], 0]
        found.append(moved(DrawnSurface(square, np.array([[0, 1, 2], [0, 2, 3]])), table))
    return found + [
        moved(shape_surface(one.shape), pose_matrix(one.placed)) for one in scene.obstacles if one.path is None
    ]


def moving_surfaces(scene: Scene) -> list[DrawnSurface]:
    """Return the surfaces of the obstacles that move, each in its own frame."""
    return [shape_surface(one.shape) for one in scene.obstacles if one.path is not None]


def moving_poses(scene: Scene, time: float) -> np.ndarray:
    """Return the poses ``(M, 3, 4)`` of the moving obstacles at a time [s]."""
    now = obstacles_at_time(scene, time)
    found = [pose_matrix(now[k].placed) for k, one in enumerate(scene.obstacles) if one.path is not None]
    return np.array(found).reshape(-1, 3, 4)
