"""Contact forces of a grasp: the paper's closed forms and the friction-cone optimum, batched and differentiable.

The public names below load on first use, so that parts which need no JAX can be imported without it.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxgrasp.batch.contact_sets import ContactSets
    from jaxgrasp.batch.evaluation import Evaluation, evaluate
    from jaxgrasp.batch.file_error import GraspFileError
    from jaxgrasp.batch.sources import load_grasps, save_grasps
    from jaxgrasp.contact.closing import close_hand
    from jaxgrasp.contact.deepest import Kept, keep_deepest
    from jaxgrasp.contact.detection import Contacts, find_contacts
    from jaxgrasp.contact.filling import LevelError, level_errors, sphere_tree
    from jaxgrasp.contact.grip_type import GripType, contributions_of, grip_type
    from jaxgrasp.contact.human_hand import human_hand, mirrored
    from jaxgrasp.contact.kinematics import contact_jacobian, joint_torques, pose_hand
    from jaxgrasp.contact.limits import check_clear, check_pose, check_posture, clamp_posture
    from jaxgrasp.contact.mesh import Mesh, check_mesh, load_mesh, principal_frame
    from jaxgrasp.contact.parallel_jaw import parallel_jaw
    from jaxgrasp.contact.shapes import Box, Capsule, Cylinder, Plane, Shape, Sphere, check_shape, signed_distance
    from jaxgrasp.contact.sphere_tree import SphereTree
    from jaxgrasp.contact.to_grasp import grasp_from_contacts, link_contributions
    from jaxgrasp.contact.world import rigid_body, spring_wrench, world_contacts
    from jaxgrasp.force.angles import friction_margin, slip_angle, stability_margin
    from jaxgrasp.force.certificate import verify_certificate
    from jaxgrasp.force.distribution import (
        ForceSplit,
        closed_form,
        closed_form_and_optimum,
        constrained_optimum,
        split_forces,
    )
    from jaxgrasp.force.dual_function import dual_value, multiplier_forces
    from jaxgrasp.force.lagrange import lagrange_forces
    from jaxgrasp.force.least_factor import least_squeeze_factor
    from jaxgrasp.force.least_friction import least_friction
    from jaxgrasp.force.least_squeeze import least_squeeze
    from jaxgrasp.force.margin import wrench_margin
    from jaxgrasp.force.pyramid import pyramid_optimum
    from jaxgrasp.force.reachable import Reachable, reachable_wrench
    from jaxgrasp.interop.mujoco_contacts import MujocoGrasp, from_mujoco
    from jaxgrasp.interop.mujoco_hand import MujocoHand, hand_from_mujoco
    from jaxgrasp.interop.urdf_hand import hand_from_urdf
    from jaxgrasp.literature.answer import MethodAnswer, MethodStatus
    from jaxgrasp.literature.buss import buss
    from jaxgrasp.literature.cheng_orin import cheng_orin
    from jaxgrasp.literature.kerr_roth import kerr_roth
    from jaxgrasp.literature.kuhn_tucker import kuhn_tucker
    from jaxgrasp.literature.kumar_waldron import kumar_waldron
    from jaxgrasp.literature.methods import LITERATURE_METHODS, Method
    from jaxgrasp.literature.nakamura import nakamura
    from jaxgrasp.literature.orin_oh import orin_oh
    from jaxgrasp.model.faults import Fault, GraspError, check_grasp
    from jaxgrasp.model.grasp import Grasp
    from jaxgrasp.model.hand import Hand, HandFrames, Link, Pose, Posture, Spheres
    from jaxgrasp.model.held import Held, HeldCylinder
    from jaxgrasp.model.limit_faults import check_limits
    from jaxgrasp.model.limits import Limits
    from jaxgrasp.model.paths import Lift, Shake, Turn
    from jaxgrasp.model.solution import Route, Solution, Verdict
    from jaxgrasp.model.squeeze import CYLINDRICAL_POWER_GRIP, Contributions, squeezing
    from jaxgrasp.model.task import Task, carrying
    from jaxgrasp.model.wrench import grasp_matrix, weight_wrench
    from jaxgrasp.numerics.compiled_code import use_cache
    from jaxgrasp.objectives.best_forces import OBJECTIVES, BestForces, best_forces
    from jaxgrasp.prehension.carry import Instant, carry
    from jaxgrasp.prehension.monitor import Assessment, Hold, Touch, monitor
    from jaxgrasp.prehension.motion import Body
    from jaxgrasp.prehension.power_grip import power_grip
    from jaxgrasp.prehension.precision_grip import precision_grip
    from jaxgrasp.prehension.scene import Obstacle, Scene
    from jaxgrasp.prehension.tick import Tick, observe
    from jaxgrasp.quality.closure import ForceClosure, force_closure
    from jaxgrasp.quality.ferrari_canny import Epsilon, ferrari_canny, ferrari_canny_at
    from jaxgrasp.quality.largest_wrench import LargestWrench, largest_wrench, largest_wrench_at
    from jaxgrasp.quality.min_weight import MinWeight, min_weight, min_weight_at
    from jaxgrasp.quality.singular_values import (
        grasp_isotropy,
        grasp_volume,
        least_singular_value,
        singular_values,
    )
    from jaxgrasp.sensitivity.design import Design, raise_worst
    from jaxgrasp.sensitivity.matrix import Influence, SensitivityMatrix, sensitivity_matrix
    from jaxgrasp.sensitivity.outputs import Output, friction_reserve
    from jaxgrasp.sensitivity.paper_task import cylinder_task
    from jaxgrasp.sensitivity.trajectory import SensitivityTrajectory, VariedCurves, sensitivity_trajectory

_HOME = {
    "Assessment": "prehension.monitor",
    "BestForces": "objectives.best_forces",
    "Body": "prehension.motion",
    "Box": "contact.shapes",
    "CYLINDRICAL_POWER_GRIP": "model.squeeze",
    "Capsule": "contact.shapes",
    "ContactSets": "batch.contact_sets",
    "Contacts": "contact.detection",
    "Contributions": "model.squeeze",
    "Cylinder": "contact.shapes",
    "Design": "sensitivity.design",
    "Epsilon": "quality.ferrari_canny",
    "Evaluation": "batch.evaluation",
    "Fault": "model.faults",
    "ForceClosure": "quality.closure",
    "ForceSplit": "force.distribution",
    "Grasp": "model.grasp",
    "GraspError": "model.faults",
    "GraspFileError": "batch.file_error",
    "GripType": "contact.grip_type",
    "Hand": "model.hand",
    "HandFrames": "model.hand",
    "Held": "model.held",
    "HeldCylinder": "model.held",
    "Hold": "prehension.monitor",
    "Influence": "sensitivity.matrix",
    "Instant": "prehension.carry",
    "Kept": "contact.deepest",
    "LITERATURE_METHODS": "literature.methods",
    "LargestWrench": "quality.largest_wrench",
    "LevelError": "contact.filling",
    "Lift": "model.paths",
    "Limits": "model.limits",
    "Link": "model.hand",
    "Mesh": "contact.mesh",
    "Method": "literature.methods",
    "MethodAnswer": "literature.answer",
    "MethodStatus": "literature.answer",
    "MinWeight": "quality.min_weight",
    "MujocoGrasp": "interop.mujoco_contacts",
    "MujocoHand": "interop.mujoco_hand",
    "OBJECTIVES": "objectives.best_forces",
    "Obstacle": "prehension.scene",
    "Output": "sensitivity.outputs",
    "Plane": "contact.shapes",
    "Pose": "model.hand",
    "Posture": "model.hand",
    "Reachable": "force.reachable",
    "Route": "model.solution",
    "Scene": "prehension.scene",
    "SensitivityMatrix": "sensitivity.matrix",
    "SensitivityTrajectory": "sensitivity.trajectory",
    "Shake": "model.paths",
    "Shape": "contact.shapes",
    "Solution": "model.solution",
    "Sphere": "contact.shapes",
    "SphereTree": "contact.sphere_tree",
    "Spheres": "model.hand",
    "Task": "model.task",
    "Tick": "prehension.tick",
    "Touch": "prehension.monitor",
    "Turn": "model.paths",
    "VariedCurves": "sensitivity.trajectory",
    "Verdict": "model.solution",
    "best_forces": "objectives.best_forces",
    "buss": "literature.buss",
    "carry": "prehension.carry",
    "carrying": "model.task",
    "check_clear": "contact.limits",
    "check_grasp": "model.faults",
    "check_limits": "model.limit_faults",
    "check_mesh": "contact.mesh",
    "check_pose": "contact.limits",
    "check_posture": "contact.limits",
    "check_shape": "contact.shapes",
    "cheng_orin": "literature.cheng_orin",
    "clamp_posture": "contact.limits",
    "close_hand": "contact.closing",
    "closed_form": "force.distribution",
    "closed_form_and_optimum": "force.distribution",
    "constrained_optimum": "force.distribution",
    "contact_jacobian": "contact.kinematics",
    "contributions_of": "contact.grip_type",
    "cylinder_task": "sensitivity.paper_task",
    "dual_value": "force.dual_function",
    "evaluate": "batch.evaluation",
    "ferrari_canny": "quality.ferrari_canny",
    "ferrari_canny_at": "quality.ferrari_canny",
    "find_contacts": "contact.detection",
    "force_closure": "quality.closure",
    "friction_margin": "force.angles",
    "friction_reserve": "sensitivity.outputs",
    "from_mujoco": "interop.mujoco_contacts",
    "grasp_from_contacts": "contact.to_grasp",
    "grasp_isotropy": "quality.singular_values",
    "grasp_matrix": "model.wrench",
    "grasp_volume": "quality.singular_values",
    "grip_type": "contact.grip_type",
    "hand_from_mujoco": "interop.mujoco_hand",
    "hand_from_urdf": "interop.urdf_hand",
    "human_hand": "contact.human_hand",
    "joint_torques": "contact.kinematics",
    "keep_deepest": "contact.deepest",
    "kerr_roth": "literature.kerr_roth",
    "kuhn_tucker": "literature.kuhn_tucker",
    "kumar_waldron": "literature.kumar_waldron",
    "lagrange_forces": "force.lagrange",
    "largest_wrench": "quality.largest_wrench",
    "largest_wrench_at": "quality.largest_wrench",
    "least_friction": "force.least_friction",
    "least_singular_value": "quality.singular_values",
    "least_squeeze": "force.least_squeeze",
    "least_squeeze_factor": "force.least_factor",
    "level_errors": "contact.filling",
    "link_contributions": "contact.to_grasp",
    "load_grasps": "batch.sources",
    "load_mesh": "contact.mesh",
    "min_weight": "quality.min_weight",
    "min_weight_at": "quality.min_weight",
    "mirrored": "contact.human_hand",
    "monitor": "prehension.monitor",
    "multiplier_forces": "force.dual_function",
    "nakamura": "literature.nakamura",
    "observe": "prehension.tick",
    "orin_oh": "literature.orin_oh",
    "parallel_jaw": "contact.parallel_jaw",
    "pose_hand": "contact.kinematics",
    "power_grip": "prehension.power_grip",
    "precision_grip": "prehension.precision_grip",
    "principal_frame": "contact.mesh",
    "pyramid_optimum": "force.pyramid",
    "raise_worst": "sensitivity.design",
    "reachable_wrench": "force.reachable",
    "rigid_body": "contact.world",
    "save_grasps": "batch.sources",
    "sensitivity_matrix": "sensitivity.matrix",
    "sensitivity_trajectory": "sensitivity.trajectory",
    "signed_distance": "contact.shapes",
    "singular_values": "quality.singular_values",
    "slip_angle": "force.angles",
    "sphere_tree": "contact.filling",
    "split_forces": "force.distribution",
    "spring_wrench": "contact.world",
    "squeezing": "model.squeeze",
    "stability_margin": "force.angles",
    "use_cache": "numerics.compiled_code",
    "verify_certificate": "force.certificate",
    "weight_wrench": "model.wrench",
    "world_contacts": "contact.world",
    "wrench_margin": "force.margin",
}

__all__ = sorted(_HOME)  # noqa: PLE0605


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'jaxgrasp' has no attribute {name!r}")
    return getattr(import_module(f"jaxgrasp.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
