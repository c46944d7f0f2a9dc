"""Sensitivities of results to their parameters: matrices, trajectories and design, by automatic differentiation."""

from jaxgrasp.sensitivity.design import Design, raise_worst
from jaxgrasp.sensitivity.matrix import Influence, SensitivityMatrix, sensitivity_matrix
from jaxgrasp.sensitivity.task_file import cylinder_task
from jaxgrasp.sensitivity.trajectory import (
    FrictionReserve,
    Output,
    SensitivityTrajectory,
    VariedCurves,
    friction_reserve,
    sensitivity_trajectory,
)

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
