"""How an object gets away that no forces hold: a little along the twist that proves it, there and again."""

import numpy as np
from scipy.spatial.transform import Rotation

WAY = 0.02
"""How far its farthest point goes [m]."""
TURN = 0.7
"""How far it turns at most [rad]."""
PERIOD, REST = 2.4, 0.25
"""How long a way there takes [s], and which share of it the object stands still at either end."""


def scaled_twist(twist: np.ndarray, origin: np.ndarray, corners: np.ndarray, size: float = 1.0) -> np.ndarray:
    """The twist as long as it is shown: the farthest of the object's corners goes ``WAY``, or it turns by ``TURN``.

    Args:
        twist: (linear, angular) ``(6,)`` about the origin, of any length.
        origin: ``(3,)`` [m].
        corners: of the object in the world ``(V, 3)`` [m].
        size: how many times as large things are as beside a human hand.
    """
    speeds = np.linalg.norm(twist[:3] + np.cross(twist[3:], corners - origin), axis=1)
    fastest, turning = float(speeds.max(initial=0)), float(np.linalg.norm(twist[3:]))
    lengths = [WAY * size / fastest if fastest > 0 else np.inf, TURN / turning if turning > 0 else np.inf]
    return twist * min(lengths) if np.isfinite(min(lengths)) else np.zeros(6)


def escaped(pose: np.ndarray, twist: np.ndarray, origin: np.ndarray, share: float) -> np.ndarray:
    """A pose ``(3, 4)`` on its way along a twist about an origin, from 0 to 1 of it."""
    turn = Rotation.from_rotvec(share * twist[3:]).as_matrix()
    moved = origin + turn @ (pose[:, 3] - origin) + share * twist[:3]
    return np.concatenate([turn @ pose[:, :3], moved[:, None]], 1)


def share_at(time: float) -> float:
    """How far on its way the object is at a time [s], 0 to 1: it goes smoothly, stands, and begins again."""
    way = (time % PERIOD) / PERIOD
    way = min(max((way - REST / 2) / (1 - REST), 0.0), 1.0)
    return way * way * (3 - 2 * way)
