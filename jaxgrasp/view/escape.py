"""Repeated short motion of an object that no forces hold, along the twist that proves infeasibility."""

import numpy as np
from scipy.spatial.transform import Rotation

TRAVEL = 0.02
"""Distance that the object's farthest point moves [m]."""
TURN = 0.7
"""Largest rotation of the object [rad]."""
PERIOD, REST_SHARE = 2.4, 0.25
"""Duration of a motion [s], and the share of it in which the object rests, half of it at either end."""


def scaled_twist(twist: np.ndarray, origin: np.ndarray, corners: np.ndarray, size: float = 1.0) -> np.ndarray:
    """Scale a twist for display: the object's farthest corner moves by ``TRAVEL``, or the object turns by ``TURN``.

    Args:
        twist: (linear, angular) ``(6,)`` about the origin, of any length.
        origin: ``(3,)`` [m].
        corners: of the object in the world ``(V, 3)`` [m].
        size: of contacts and object, relative to those beside a human hand.
    """
    speeds = np.linalg.norm(twist[:3] + np.cross(twist[3:], corners - origin), axis=1)
    fastest, turning = float(speeds.max(initial=0)), float(np.linalg.norm(twist[3:]))
    lengths = [TRAVEL * size / fastest if fastest > 0 else np.inf, TURN / turning if turning > 0 else np.inf]
    return twist * min(lengths) if np.isfinite(min(lengths)) else np.zeros(6)


def escaped(pose: np.ndarray, twist: np.ndarray, origin: np.ndarray, share: float) -> np.ndarray:
    """Move a pose ``(3, 4)`` along a share, 0 to 1, of a twist ``(6,)`` about an origin ``(3,)``."""
    rotation = Rotation.from_rotvec(share * twist[3:]).as_matrix()
    # x' = o + R (x - o) + s v.
    position = origin + rotation @ (pose[:, 3] - origin) + share * twist[:3]
    return np.concatenate([rotation @ pose[:, :3], position[:, None]], 1)


def share_at(time: float) -> float:
    """Return the share of the motion at a time [s], 0 to 1: it grows smoothly, rests, and begins again."""
    phase = (time % PERIOD) / PERIOD
    phase = min(max((phase - REST_SHARE / 2) / (1 - REST_SHARE), 0.0), 1.0)
    return phase * phase * (3 - 2 * phase)
