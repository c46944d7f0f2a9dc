"""Grasps and hands from other projects' simulators, models and data sets (extra ``hands``)."""

from jaxgrasp.interop.acronym import read_acronym
from jaxgrasp.interop.bodex import read_bodex
from jaxgrasp.interop.contact_arrays import ContactGrasps, from_contact_arrays
from jaxgrasp.interop.dexgraspbench import read_dexgraspbench
from jaxgrasp.interop.dexgraspnet import read_dexgraspnet
from jaxgrasp.interop.dexonomy import read_dexonomy
from jaxgrasp.interop.file_records import ContactRecords, GraspPoses
from jaxgrasp.interop.grasp_writers import hold_confidence, judged_by_margin, write_graspgen, write_isaac_grasp
from jaxgrasp.interop.graspgen import read_graspgen
from jaxgrasp.interop.graspit import read_graspit
from jaxgrasp.interop.hand_file import HandFile, read_hand
from jaxgrasp.interop.isaac_grasp import read_isaac_grasp
from jaxgrasp.interop.lerobot import ContactFrames, read_lerobot, write_lerobot
from jaxgrasp.interop.mjcf_file import load_mjcf
from jaxgrasp.interop.mjx_contacts import MjxGrasp, from_mjx
from jaxgrasp.interop.model_file import LeftOut
from jaxgrasp.interop.mujoco_contacts import MujocoGrasp, from_mujoco
from jaxgrasp.interop.mujoco_hand import MujocoHand, hand_from_mujoco
from jaxgrasp.interop.mujoco_warp_contacts import from_mujoco_warp
from jaxgrasp.interop.posed_contacts import Gripper, PosedContacts, contacts_of_poses, gripper_by_name
from jaxgrasp.interop.urdf_hand import hand_from_urdf

__all__ = [
    "ContactFrames",
    "ContactGrasps",
    "ContactRecords",
    "GraspPoses",
    "Gripper",
    "HandFile",
    "LeftOut",
    "MjxGrasp",
    "MujocoGrasp",
    "MujocoHand",
    "PosedContacts",
    "contacts_of_poses",
    "from_contact_arrays",
    "from_mjx",
    "from_mujoco",
    "from_mujoco_warp",
    "gripper_by_name",
    "hand_from_mujoco",
    "hand_from_urdf",
    "hold_confidence",
    "judged_by_margin",
    "load_mjcf",
    "read_acronym",
    "read_bodex",
    "read_dexgraspbench",
    "read_dexgraspnet",
    "read_dexonomy",
    "read_graspgen",
    "read_graspit",
    "read_hand",
    "read_isaac_grasp",
    "read_lerobot",
    "write_graspgen",
    "write_isaac_grasp",
    "write_lerobot",
]


def __dir__() -> list[str]:
    return __all__
