"""Table of all methods of the literature, to run and compare them on a batch."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from jaxgrasp.literature.buss import buss
from jaxgrasp.literature.kerr_roth import kerr_roth
from jaxgrasp.literature.kuhn_tucker import kuhn_tucker
from jaxgrasp.literature.kumar_waldron import kumar_waldron
from jaxgrasp.literature.method_input import MethodAnswer
from jaxgrasp.literature.nakamura import nakamura
from jaxgrasp.literature.orin_oh import cheng_orin, orin_oh
from jaxgrasp.model.arrays import AnyArray
from jaxgrasp.model.grasp import Grasp, Limits


@dataclass(frozen=True)
class Method:
    """A method with the properties that a comparison needs."""

    title: str
    solve: Callable[..., MethodAnswer]
    measure: str
    """Objective, with its unit."""
    friction: Literal["pyramids", "cones"]
    """Model of friction: forces in the ``"cones"`` are those of the problem itself."""
    takes_limits: bool = False

    def __call__(self, grasp: Grasp, wrench: AnyArray, limits: Limits, **options: Any) -> MethodAnswer:
        """Run the method, with the limits if it supports any."""
        return self.solve(grasp, wrench, **({"limits": limits} if self.takes_limits else {}), **options)


LITERATURE_METHODS = {
    "kerr_roth": Method("Kerr, Roth 1986", kerr_roth, "least distance to a plane [N]", "pyramids", True),
    "nakamura": Method("Nakamura et al. 1989", nakamura, "norm of internal forces [N]", "cones"),
    "buss": Method("Buss et al. 1996, 1998", buss, "effort tr P + margin tr P^-1 [N]", "cones"),
    "orin_oh": Method("Orin, Oh 1981", orin_oh, "weighted effort and largest load", "pyramids", True),
    "cheng_orin": Method("Cheng, Orin 1990", cheng_orin, "weighted effort and largest load", "pyramids", True),
    "kumar_waldron": Method("Kumar, Waldron 1988", kumar_waldron, "largest interaction force [N]", "cones"),
    "kuhn_tucker": Method("Kuhn-Tucker, active set", kuhn_tucker, "F_3 [N], or F_2 [N^2]", "pyramids"),
}
"""Methods by the name of their function in ``jaxgrasp.literature``, in the order of the paper."""
