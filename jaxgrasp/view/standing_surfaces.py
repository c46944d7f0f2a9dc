"""The world around an object: the table's top below it, where it is near, and obstacles, which may move."""

import numpy as np

from jaxgrasp.grip.scene import Scene, obstacles_at_time
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.surfaces import DrawnSurface, move_surface, pose_matrix, shape_surface

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
    surfaces = []
    table = pose_matrix(scene.table)
    middle = (np.asarray(at.origin) - table[:, 3]) @ table[:, :3]
    if 0 <= middle[2] <= NEAR:
        square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * EDGE / 2 + [middle[0], middle[1], 0]
        surfaces.append(move_surface(DrawnSurface(square, np.array([[0, 1, 2], [0, 2, 3]])), table))
    return surfaces + [
        move_surface(shape_surface(obstacle.shape), pose_matrix(obstacle.placed))
        for obstacle in scene.obstacles
        if obstacle.path is None
    ]


def moving_surfaces(scene: Scene) -> list[DrawnSurface]:
    """Return the surfaces of the obstacles that move, each in its own frame."""
    return [shape_surface(obstacle.shape) for obstacle in scene.obstacles if obstacle.path is not None]


def moving_poses(scene: Scene, time: float) -> np.ndarray:
    """Return the poses ``(M, 3, 4)`` of the moving obstacles at a time [s]."""
    obstacles = obstacles_at_time(scene, time)
    poses = [
        pose_matrix(obstacles[k].placed) for k, obstacle in enumerate(scene.obstacles) if obstacle.path is not None
    ]
    return np.array(poses).reshape(-1, 3, 4)
