"""How answers move with what they depend on: matrices, trajectories, and design, all by automatic differentiation."""

from jaxgrasp.sensitivity.design import Design, raise_worst
from jaxgrasp.sensitivity.matrix import Influence, SensitivityMatrix, sensitivity_matrix
from jaxgrasp.sensitivity.outputs import FrictionReserve, Output, friction_reserve
from jaxgrasp.sensitivity.paper_task import cylinder_task
from jaxgrasp.sensitivity.trajectory import SensitivityTrajectory, VariedCurves, sensitivity_trajectory

__all__ = [
    "Design",
    "FrictionReserve",
    "Influence",
    "Output",
    "SensitivityMatrix",
    "SensitivityTrajectory",
    "VariedCurves",
    "cylinder_task",
    "friction_reserve",
    "raise_worst",
    "sensitivity_matrix",
    "sensitivity_trajectory",
]


def __dir__() -> list[str]:
    return __all__
