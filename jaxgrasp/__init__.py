"""Contact forces of a grasp: the paper's closed forms and the friction-cone optimum, batched and differentiable.

It holds a grasp's data, the two answers, further questions about a grasp, and files of grasps. All other public names
are in public packages: ``batch`` (a function for workers of a cluster), ``hand`` (kinematics, shapes, contacts),
``grip`` (grips, squeezing forces, the object over time), ``quality``, ``sensitivity``, ``literature`` (prior methods),
``interop`` (MuJoCo, URDF), ``world`` (several objects), ``glove``, ``psychophysics``, ``lab``, ``report`` (pages).

Every name loads on first use, so that parts which need no JAX can be imported without it.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING

if _TYPE_CHECKING:
    from jaxgrasp import (
        batch,
        glove,
        grip,
        hand,
        interop,
        lab,
        literature,
        psychophysics,
        quality,
        report,
        sensitivity,
        teleop,
        world,
    )
    from jaxgrasp.batch.contact_sets import ContactSets
    from jaxgrasp.batch.evaluation import Evaluation, evaluate
    from jaxgrasp.batch.file_error import GraspFileError
    from jaxgrasp.batch.qualities import price_of_friction
    from jaxgrasp.batch.sources import load_grasps, save_grasps
    from jaxgrasp.force.certificate import verify_certificate
    from jaxgrasp.force.distribution import (
        ForceSplit,
        closed_form,
        closed_form_and_optimum,
        constrained_optimum,
        dual_value,
        multiplier_forces,
        split_forces,
    )
    from jaxgrasp.force.least_friction import least_friction
    from jaxgrasp.force.least_squeeze import least_squeeze, least_squeeze_factor
    from jaxgrasp.force.margin import wrench_margin
    from jaxgrasp.force.pyramid import pyramid_optimum
    from jaxgrasp.force.reachable import Reachable, reachable_wrench
    from jaxgrasp.force.slip import friction_margin, slip_angle, stability_margin
    from jaxgrasp.model.faults import Fault, GraspError, check_grasp, check_limits
    from jaxgrasp.model.grasp import Grasp, Limits
    from jaxgrasp.model.solution import Route, Solution, Verdict
    from jaxgrasp.model.wrench import grasp_matrix, weight_wrench
    from jaxgrasp.numerics.compiled_code import use_cache
    from jaxgrasp.objectives.best_forces import OBJECTIVES, BestForces, best_forces

_HOME = {
    "BestForces": "objectives.best_forces",
    "ContactSets": "batch.contact_sets",
    "Evaluation": "batch.evaluation",
    "Fault": "model.faults",
    "ForceSplit": "force.distribution",
    "Grasp": "model.grasp",
    "GraspError": "model.faults",
    "GraspFileError": "batch.file_error",
    "Limits": "model.grasp",
    "OBJECTIVES": "objectives.best_forces",
    "Reachable": "force.reachable",
    "Route": "model.solution",
    "Solution": "model.solution",
    "Verdict": "model.solution",
    "best_forces": "objectives.best_forces",
    "check_grasp": "model.faults",
    "check_limits": "model.faults",
    "closed_form": "force.distribution",
    "closed_form_and_optimum": "force.distribution",
    "constrained_optimum": "force.distribution",
    "dual_value": "force.distribution",
    "evaluate": "batch.evaluation",
    "friction_margin": "force.slip",
    "grasp_matrix": "model.wrench",
    "least_friction": "force.least_friction",
    "least_squeeze": "force.least_squeeze",
    "least_squeeze_factor": "force.least_squeeze",
    "load_grasps": "batch.sources",
    "multiplier_forces": "force.distribution",
    "price_of_friction": "batch.qualities",
    "pyramid_optimum": "force.pyramid",
    "reachable_wrench": "force.reachable",
    "save_grasps": "batch.sources",
    "slip_angle": "force.slip",
    "split_forces": "force.distribution",
    "stability_margin": "force.slip",
    "use_cache": "numerics.compiled_code",
    "verify_certificate": "force.certificate",
    "weight_wrench": "model.wrench",
    "wrench_margin": "force.margin",
}
_ROOMS = (
    "batch",
    "glove",
    "grip",
    "hand",
    "interop",
    "lab",
    "literature",
    "psychophysics",
    "quality",
    "report",
    "sensitivity",
    "teleop",
    "world",
)

__all__ = sorted([*_HOME, *_ROOMS])  # noqa: PLE0605


def __getattr__(name: str):
    if name in _ROOMS:
        return _import_module(f"jaxgrasp.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'jaxgrasp' has no attribute {name!r}")
    return getattr(_import_module(f"jaxgrasp.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
