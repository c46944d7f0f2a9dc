"""Grasps out of other people's simulators and hand models (extra ``hands``)."""

from jaxgrasp.interop.mujoco_contacts import MujocoGrasp, from_mujoco
from jaxgrasp.interop.mujoco_hand import MujocoHand, hand_from_mujoco
from jaxgrasp.interop.urdf_hand import hand_from_urdf

__all__ = [
    "MujocoGrasp",
    "MujocoHand",
    "from_mujoco",
    "hand_from_mujoco",
    "hand_from_urdf",
]


def __dir__() -> list[str]:
    return __all__
