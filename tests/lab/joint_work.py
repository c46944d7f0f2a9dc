"""Joint torques of contact forces by virtual work alone."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.hand import Hand, Posture, pose_hand

MODEL = lrp_hand_master()


def by_work(
    hand: Hand, posture: Posture, points: np.ndarray, forces: np.ndarray, couples: np.ndarray | None = None
) -> np.ndarray:
    """Compute torques against flexion of the glove's joints: the work of forces and couples as a joint turns."""
    step = 1e-5

    def links(place: int, by: float):
        angles = np.asarray(posture.angles).copy()
        angles[place] += by
        frames = pose_hand(hand, Posture(posture.wrist, angles)).links
        return np.asarray(frames.origin), np.asarray(frames.rotation)

    own_origin, own_turn = links(0, 0.0)
    local = np.einsum("lji,lj->li", own_turn, points - own_origin)
    torques = []
    for place in MODEL.joint_indices(hand.joints):
        (ahead, ahead_turn), (back, back_turn) = links(place, step), links(place, -step)
        displacement = (
            ahead + np.einsum("lij,lj->li", ahead_turn, local) - back - np.einsum("lij,lj->li", back_turn, local)
        )
        turn = Rotation.from_matrix(ahead_turn @ back_turn.swapaxes(-1, -2)).as_rotvec()
        work = np.sum(forces * displacement) + (0.0 if couples is None else np.sum(couples * turn))
        torques.append(work / (2 * step))
    return np.array(torques)
