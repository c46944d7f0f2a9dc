"""Grasps out of other people's simulators, hand models and data sets (extra ``hands``)."""

from jaxgrasp.interop.dexgraspnet import HandPoses, read_dexgraspnet
from jaxgrasp.interop.hand_file import HandFile, read_hand
from jaxgrasp.interop.left_out import LeftOut
from jaxgrasp.interop.mjcf_file import load_mjcf
from jaxgrasp.interop.mjx_contacts import MjxGrasp, from_mjx
from jaxgrasp.interop.mujoco_contacts import MujocoGrasp, from_mujoco
from jaxgrasp.interop.mujoco_hand import MujocoHand, hand_from_mujoco
from jaxgrasp.interop.urdf_hand import hand_from_urdf

__all__ = [
    "HandFile",
    "HandPoses",
    "LeftOut",
    "MjxGrasp",
    "MujocoGrasp",
    "MujocoHand",
    "from_mjx",
    "from_mujoco",
    "hand_from_mujoco",
    "hand_from_urdf",
    "load_mjcf",
    "read_dexgraspnet",
    "read_hand",
]


def __dir__() -> list[str]:
    return __all__
