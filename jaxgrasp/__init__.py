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
    from jaxgrasp.force.least_friction import least_friction
    from jaxgrasp.force.least_squeeze import least_squeeze
    from jaxgrasp.force.least_squeeze_factor import least_squeeze_factor
    from jaxgrasp.force.margin import wrench_margin
    from jaxgrasp.force.pyramid import pyramid_optimum
    from jaxgrasp.force.reachable import Reachable, reachable_wrench
    from jaxgrasp.force.slip import friction_margin, slip_angle, stability_margin
    from jaxgrasp.grip.carry import Instant, carry
    from jaxgrasp.grip.monitor import Assessment, Hold, Touch, monitor
    from jaxgrasp.grip.motion import Body
    from jaxgrasp.grip.power_grip import power_grip
    from jaxgrasp.grip.precision_grip import precision_grip
    from jaxgrasp.grip.scene import Obstacle, Scene
    from jaxgrasp.grip.tick import Tick, observe
    from jaxgrasp.hand.closing import close_hand
    from jaxgrasp.hand.deepest import Kept, keep_deepest
    from jaxgrasp.hand.detection import Contacts, find_contacts
    from jaxgrasp.hand.filling import LevelError, level_errors, sphere_tree
    from jaxgrasp.hand.grip_type import GripType, contributions_of, grip_type
    from jaxgrasp.hand.human_hand import human_hand, mirrored
    from jaxgrasp.hand.kinematics import contact_jacobian, joint_torques, pose_hand
    from jaxgrasp.hand.mesh import Mesh, check_mesh, load_mesh, principal_frame
    from jaxgrasp.hand.parallel_jaw import parallel_jaw
    from jaxgrasp.hand.posture_limits import check_clear, check_pose, check_posture, clamp_posture
    from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Plane, Shape, Sphere, check_shape, signed_distance
    from jaxgrasp.hand.sphere_tree import SphereTree
    from jaxgrasp.hand.to_grasp import grasp_from_contacts, link_contributions
    from jaxgrasp.hand.world import rigid_body, spring_wrench, world_contacts
    from jaxgrasp.interop.mujoco_contacts import MujocoGrasp, from_mujoco
    from jaxgrasp.interop.mujoco_hand import MujocoHand, hand_from_mujoco
    from jaxgrasp.interop.urdf_hand import hand_from_urdf
    from jaxgrasp.literature.all_methods import LITERATURE_METHODS, Method
    from jaxgrasp.literature.buss import buss
    from jaxgrasp.literature.cheng_orin import cheng_orin
    from jaxgrasp.literature.kerr_roth import kerr_roth
    from jaxgrasp.literature.kuhn_tucker import kuhn_tucker
    from jaxgrasp.literature.kumar_waldron import kumar_waldron
    from jaxgrasp.literature.method_answer import MethodAnswer, MethodStatus
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
    "Assessment": "grip.monitor",
    "BestForces": "objectives.best_forces",
    "Body": "grip.motion",
    "Box": "hand.shapes",
    "CYLINDRICAL_POWER_GRIP": "model.squeeze",
    "Capsule": "hand.shapes",
    "ContactSets": "batch.contact_sets",
    "Contacts": "hand.detection",
    "Contributions": "model.squeeze",
    "Cylinder": "hand.shapes",
    "Design": "sensitivity.design",
    "Epsilon": "quality.ferrari_canny",
    "Evaluation": "batch.evaluation",
    "Fault": "model.faults",
    "ForceClosure": "quality.closure",
    "ForceSplit": "force.distribution",
    "Grasp": "model.grasp",
    "GraspError": "model.faults",
    "GraspFileError": "batch.file_error",
    "GripType": "hand.grip_type",
    "Hand": "model.hand",
    "HandFrames": "model.hand",
    "Held": "model.held",
    "HeldCylinder": "model.held",
    "Hold": "grip.monitor",
    "Influence": "sensitivity.matrix",
    "Instant": "grip.carry",
    "Kept": "hand.deepest",
    "LITERATURE_METHODS": "literature.all_methods",
    "LargestWrench": "quality.largest_wrench",
    "LevelError": "hand.filling",
    "Lift": "model.paths",
    "Limits": "model.limits",
    "Link": "model.hand",
    "Mesh": "hand.mesh",
    "Method": "literature.all_methods",
    "MethodAnswer": "literature.method_answer",
    "MethodStatus": "literature.method_answer",
    "MinWeight": "quality.min_weight",
    "MujocoGrasp": "interop.mujoco_contacts",
    "MujocoHand": "interop.mujoco_hand",
    "OBJECTIVES": "objectives.best_forces",
    "Obstacle": "grip.scene",
    "Output": "sensitivity.outputs",
    "Plane": "hand.shapes",
    "Pose": "model.hand",
    "Posture": "model.hand",
    "Reachable": "force.reachable",
    "Route": "model.solution",
    "Scene": "grip.scene",
    "SensitivityMatrix": "sensitivity.matrix",
    "SensitivityTrajectory": "sensitivity.trajectory",
    "Shake": "model.paths",
    "Shape": "hand.shapes",
    "Solution": "model.solution",
    "Sphere": "hand.shapes",
    "SphereTree": "hand.sphere_tree",
    "Spheres": "model.hand",
    "Task": "model.task",
    "Tick": "grip.tick",
    "Touch": "grip.monitor",
    "Turn": "model.paths",
    "VariedCurves": "sensitivity.trajectory",
    "Verdict": "model.solution",
    "best_forces": "objectives.best_forces",
    "buss": "literature.buss",
    "carry": "grip.carry",
    "carrying": "model.task",
    "check_clear": "hand.posture_limits",
    "check_grasp": "model.faults",
    "check_limits": "model.limit_faults",
    "check_mesh": "hand.mesh",
    "check_pose": "hand.posture_limits",
    "check_posture": "hand.posture_limits",
    "check_shape": "hand.shapes",
    "cheng_orin": "literature.cheng_orin",
    "clamp_posture": "hand.posture_limits",
    "close_hand": "hand.closing",
    "closed_form": "force.distribution",
    "closed_form_and_optimum": "force.distribution",
    "constrained_optimum": "force.distribution",
    "contact_jacobian": "hand.kinematics",
    "contributions_of": "hand.grip_type",
    "cylinder_task": "sensitivity.paper_task",
    "dual_value": "force.dual_function",
    "evaluate": "batch.evaluation",
    "ferrari_canny": "quality.ferrari_canny",
    "ferrari_canny_at": "quality.ferrari_canny",
    "find_contacts": "hand.detection",
    "force_closure": "quality.closure",
    "friction_margin": "force.slip",
    "friction_reserve": "sensitivity.outputs",
    "from_mujoco": "interop.mujoco_contacts",
    "grasp_from_contacts": "hand.to_grasp",
    "grasp_isotropy": "quality.singular_values",
    "grasp_matrix": "model.wrench",
    "grasp_volume": "quality.singular_values",
    "grip_type": "hand.grip_type",
    "hand_from_mujoco": "interop.mujoco_hand",
    "hand_from_urdf": "interop.urdf_hand",
    "human_hand": "hand.human_hand",
    "joint_torques": "hand.kinematics",
    "keep_deepest": "hand.deepest",
    "kerr_roth": "literature.kerr_roth",
    "kuhn_tucker": "literature.kuhn_tucker",
    "kumar_waldron": "literature.kumar_waldron",
    "lagrange_forces": "force.lagrange",
    "largest_wrench": "quality.largest_wrench",
    "largest_wrench_at": "quality.largest_wrench",
    "least_friction": "force.least_friction",
    "least_singular_value": "quality.singular_values",
    "least_squeeze": "force.least_squeeze",
    "least_squeeze_factor": "force.least_squeeze_factor",
    "level_errors": "hand.filling",
    "link_contributions": "hand.to_grasp",
    "load_grasps": "batch.sources",
    "load_mesh": "hand.mesh",
    "min_weight": "quality.min_weight",
    "min_weight_at": "quality.min_weight",
    "mirrored": "hand.human_hand",
    "monitor": "grip.monitor",
    "multiplier_forces": "force.dual_function",
    "nakamura": "literature.nakamura",
    "observe": "grip.tick",
    "orin_oh": "literature.orin_oh",
    "parallel_jaw": "hand.parallel_jaw",
    "pose_hand": "hand.kinematics",
    "power_grip": "grip.power_grip",
    "precision_grip": "grip.precision_grip",
    "principal_frame": "hand.mesh",
    "pyramid_optimum": "force.pyramid",
    "raise_worst": "sensitivity.design",
    "reachable_wrench": "force.reachable",
    "rigid_body": "hand.world",
    "save_grasps": "batch.sources",
    "sensitivity_matrix": "sensitivity.matrix",
    "sensitivity_trajectory": "sensitivity.trajectory",
    "signed_distance": "hand.shapes",
    "singular_values": "quality.singular_values",
    "slip_angle": "force.slip",
    "sphere_tree": "hand.filling",
    "split_forces": "force.distribution",
    "spring_wrench": "hand.world",
    "squeezing": "model.squeeze",
    "stability_margin": "force.slip",
    "use_cache": "numerics.compiled_code",
    "verify_certificate": "force.certificate",
    "weight_wrench": "model.wrench",
    "world_contacts": "hand.world",
    "wrench_margin": "force.margin",
}

__all__ = sorted(_HOME)  # noqa: PLE0605


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'jaxgrasp' has no attribute {name!r}")
    return getattr(import_module(f"jaxgrasp.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
