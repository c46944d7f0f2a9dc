"""Bodies that are led steadily from one place to another, in NumPy."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose


class Motions(NamedTuple):
    """How n bodies move in the world: their centres, and about them."""

    linear: Float[np.ndarray, "n 3"]
    """[m/s]"""
    angular: Float[np.ndarray, "n 3"]
    """[rad/s]"""


def link_motion(now: HandFrames, later: HandFrames, dt: float) -> tuple[Pose, Motions]:
    """Where a hand's links ``(L,)`` are now, and the steady motion that leads them to their later places."""
    first, last = (np.asarray(frames.links.origin, float) for frames in (now, later))
    start, end = (np.asarray(frames.links.rotation, float) for frames in (now, later))
    turn = Rotation.from_matrix(end @ start.swapaxes(-1, -2)).as_rotvec()
    return Pose(first, start), Motions((last - first) / dt, turn / dt)


def led(placed: Pose, motion: Motions, dt: float) -> Pose:
    """Where steady motions lead bodies ``(n,)`` in ``dt`` seconds, their centres straight on."""
    turn = Rotation.from_rotvec(motion.angular * dt).as_matrix()
    return Pose(placed.origin + dt * motion.linear, turn @ placed.rotation)


def velocity_at(motion: Motions, origin: Float[AnyArray, "n 3"], points: Float[np.ndarray, "n 3"]) -> np.ndarray:
    """``(n, 3)``: how a point of each body moves [m/s]."""
    return motion.linear + np.cross(motion.angular, points - origin)
