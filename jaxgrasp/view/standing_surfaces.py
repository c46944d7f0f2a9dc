"""What of a scene never moves: the table's top below the object, where it is near, and obstacles."""

import numpy as np

from jaxgrasp.grip.scene import Scene
from jaxgrasp.model.hand import Pose
from jaxgrasp.report.surfaces import DrawnSurface, moved, pose_matrix, shape_surface

NEAR = 0.2
"""How far below an object a table is worth showing [m]."""
EDGE = 0.4
"""Edge of what is shown of it [m]."""


def standing_surfaces(scene: Scene, at: Pose) -> list[DrawnSurface]:
    """Surfaces in the world.

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
    return found + [moved(shape_surface(one.shape), pose_matrix(one.placed)) for one in scene.obstacles]
