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
    from jaxgrasp.force.angles import friction_margin, slip_angle, stability_margin
    from jaxgrasp.force.certificate import verify_certificate
    from jaxgrasp.force.distribution import ForceSplit, closed_form, constrained_optimum, split_forces
    from jaxgrasp.force.dual_function import dual_value, multiplier_forces
    from jaxgrasp.force.lagrange import lagrange_forces
    from jaxgrasp.force.margin import wrench_margin
    from jaxgrasp.force.pyramid import pyramid_optimum
    from jaxgrasp.force.reachable import Reachable, reachable_wrench
    from jaxgrasp.interop.mujoco_contacts import MujocoGrasp, from_mujoco
    from jaxgrasp.model.faults import Fault, GraspError, check_grasp
    from jaxgrasp.model.grasp import Grasp
    from jaxgrasp.model.solution import Route, Solution, Verdict
    from jaxgrasp.model.squeeze import CYLINDRICAL_POWER_GRIP, Contributions, squeezing
    from jaxgrasp.model.wrench import grasp_matrix, weight_wrench

_HOME = {
    "CYLINDRICAL_POWER_GRIP": "model.squeeze",
    "ContactSets": "batch.contact_sets",
    "Contributions": "model.squeeze",
    "Evaluation": "batch.evaluation",
    "Fault": "model.faults",
    "ForceSplit": "force.distribution",
    "Grasp": "model.grasp",
    "GraspError": "model.faults",
    "GraspFileError": "batch.file_error",
    "MujocoGrasp": "interop.mujoco_contacts",
    "Reachable": "force.reachable",
    "Route": "model.solution",
    "Solution": "model.solution",
    "Verdict": "model.solution",
    "check_grasp": "model.faults",
    "closed_form": "force.distribution",
    "constrained_optimum": "force.distribution",
    "dual_value": "force.dual_function",
    "evaluate": "batch.evaluation",
    "friction_margin": "force.angles",
    "from_mujoco": "interop.mujoco_contacts",
    "grasp_matrix": "model.wrench",
    "lagrange_forces": "force.lagrange",
    "load_grasps": "batch.sources",
    "multiplier_forces": "force.dual_function",
    "pyramid_optimum": "force.pyramid",
    "reachable_wrench": "force.reachable",
    "save_grasps": "batch.sources",
    "slip_angle": "force.angles",
    "split_forces": "force.distribution",
    "squeezing": "model.squeeze",
    "stability_margin": "force.angles",
    "verify_certificate": "force.certificate",
    "weight_wrench": "model.wrench",
    "wrench_margin": "force.margin",
}

__all__ = sorted(_HOME)  # noqa: PLE0605


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'jaxgrasp' has no attribute {name!r}")
    return getattr(import_module(f"jaxgrasp.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
