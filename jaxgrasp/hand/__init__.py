"""Hands and objects: kinematics, shapes, and the contacts of a posed hand with an object."""

from jaxgrasp.hand.closing import ClosingKinematics, close_hand, closing_kinematics, name_fingers
from jaxgrasp.hand.detection import Contacts, DeepestContacts, find_contacts, keep_deepest
from jaxgrasp.hand.doglove_hand import doglove_hand, linkage_angles
from jaxgrasp.hand.filling import LevelError, level_errors, sphere_tree
from jaxgrasp.hand.human_hand import human_hand, mirrored
from jaxgrasp.hand.kinematics import contact_jacobian, joint_torques, pose_hand
from jaxgrasp.hand.mesh import Mesh, check_mesh, load_mesh, principal_frame
from jaxgrasp.hand.parallel_jaw import parallel_jaw
from jaxgrasp.hand.posture_limits import check_clear, check_pose, check_posture, clamp_posture, torque_limits
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Plane, Shape, Shifted, Sphere, check_shape, signed_distance
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.to_grasp import grasp_from_contacts, link_contributions
from jaxgrasp.hand.world import rigid_body, spring_wrench, world_contacts
from jaxgrasp.model.hand import Coupling, Hand, HandFrames, Link, Pose, Posture, Spheres

__all__ = [
    "Box",
    "Capsule",
    "ClosingKinematics",
    "Contacts",
    "Coupling",
    "Cylinder",
    "DeepestContacts",
    "Hand",
    "HandFrames",
    "LevelError",
    "Link",
    "Mesh",
    "Plane",
    "Pose",
    "Posture",
    "Shape",
    "Shifted",
    "Sphere",
    "SphereTree",
    "Spheres",
    "check_clear",
    "check_mesh",
    "check_pose",
    "check_posture",
    "check_shape",
    "clamp_posture",
    "close_hand",
    "closing_kinematics",
    "contact_jacobian",
    "doglove_hand",
    "find_contacts",
    "grasp_from_contacts",
    "human_hand",
    "joint_torques",
    "keep_deepest",
    "level_errors",
    "link_contributions",
    "linkage_angles",
    "load_mesh",
    "mirrored",
    "name_fingers",
    "parallel_jaw",
    "pose_hand",
    "principal_frame",
    "rigid_body",
    "signed_distance",
    "sphere_tree",
    "spring_wrench",
    "torque_limits",
    "world_contacts",
]


def __dir__() -> list[str]:
    return __all__
