"""Quality of a grasp: for any load (force closure, inscribed balls, singular values), and for a task."""

from jaxgrasp.quality.closure import ForceClosure, force_closure
from jaxgrasp.quality.ferrari_canny import Epsilon, ferrari_canny, ferrari_canny_at
from jaxgrasp.quality.hold_margin import hold_margin
from jaxgrasp.quality.hold_probability import HoldProbability, hold_probability
from jaxgrasp.quality.largest_wrench import LargestWrench, largest_wrench, largest_wrench_at
from jaxgrasp.quality.min_weight import MinWeight, min_weight, min_weight_at
from jaxgrasp.quality.singular_values import grasp_isotropy, grasp_volume, least_singular_value, singular_values
from jaxgrasp.quality.task_demands import TaskDemands, TaskMargin, load_demands, task_margin

__all__ = [
    "Epsilon",
    "ForceClosure",
    "HoldProbability",
    "LargestWrench",
    "MinWeight",
    "TaskDemands",
    "TaskMargin",
    "ferrari_canny",
    "ferrari_canny_at",
    "force_closure",
    "grasp_isotropy",
    "grasp_volume",
    "hold_margin",
    "hold_probability",
    "largest_wrench",
    "largest_wrench_at",
    "least_singular_value",
    "load_demands",
    "min_weight",
    "min_weight_at",
    "singular_values",
    "task_margin",
]


def __dir__() -> list[str]:
    return __all__
