"""Bodies that are led steadily from one place to another, in NumPy."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.grip.motion import Motion
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import HandFrames, Pose


def link_motion(now: HandFrames, later: HandFrames, dt: float) -> tuple[Pose, Motion]:
    """Where a hand's links ``(L,)`` are now, and the steady motion that leads them to their later places."""
    start, end = (
        Pose(np.asarray(frames.links.origin, float), np.asarray(frames.links.rotation, float)) for frames in (now, later)
    )
    turn = Rotation.from_matrix(end.rotation @ start.rotation.swapaxes(-1, -2)).as_rotvec()
    return start, Motion((end.origin - start.origin) / dt, turn / dt)


def led(placed: Pose, motion: Motion, dt: float) -> Pose:
    """Where steady motions lead bodies ``(n,)`` in ``dt`` seconds, their centres straight on."""
    turn = Rotation.from_rotvec(np.asarray(motion.angular) * dt).as_matrix()
    return Pose(placed.origin + dt * np.asarray(motion.linear), turn @ placed.rotation)


def velocity_at(motion: Motion, origin: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "n 3"]) -> np.ndarray:
    """``(n, 3)``: how a point of each body moves [m/s]."""
    return np.asarray(motion.linear) + np.cross(motion.angular, points - origin)
