"""Force distribution methods of the literature before the paper (section II-D), each in its own formulation.

They are rivals and references: all take the same grasps and wrenches and return the same type, so that they can be
compared with each other, with the closed forms and with the constrained optimum. None is differentiable.
"""

from jaxgrasp.force.distribution import lagrange_forces
from jaxgrasp.literature.all_methods import LITERATURE_METHODS, Method
from jaxgrasp.literature.buss import buss
from jaxgrasp.literature.kerr_roth import kerr_roth
from jaxgrasp.literature.kuhn_tucker import kuhn_tucker
from jaxgrasp.literature.kumar_waldron import kumar_waldron
from jaxgrasp.literature.method_input import MethodAnswer, MethodStatus
from jaxgrasp.literature.nakamura import nakamura
from jaxgrasp.literature.orin_oh import cheng_orin, orin_oh

__all__ = [
    "LITERATURE_METHODS",
    "Method",
    "MethodAnswer",
    "MethodStatus",
    "buss",
    "cheng_orin",
    "kerr_roth",
    "kuhn_tucker",
    "kumar_waldron",
    "lagrange_forces",
    "nakamura",
    "orin_oh",
]


def __dir__() -> list[str]:
    return __all__
