"""How good a grasp is, whatever it must hold: force closure, inscribed balls, singular values, weights of a balance."""

from jaxgrasp.quality.closure import ForceClosure, force_closure
from jaxgrasp.quality.ferrari_canny import Epsilon, ferrari_canny, ferrari_canny_at
from jaxgrasp.quality.largest_wrench import LargestWrench, largest_wrench, largest_wrench_at
from jaxgrasp.quality.min_weight import MinWeight, min_weight, min_weight_at
from jaxgrasp.quality.singular_values import grasp_isotropy, grasp_volume, least_singular_value, singular_values

__all__ = [
    "Epsilon",
    "ForceClosure",
    "LargestWrench",
    "MinWeight",
    "ferrari_canny",
    "ferrari_canny_at",
    "force_closure",
    "grasp_isotropy",
    "grasp_volume",
    "largest_wrench",
    "largest_wrench_at",
    "least_singular_value",
    "min_weight",
    "min_weight_at",
    "singular_values",
]


def __dir__() -> list[str]:
    return __all__
