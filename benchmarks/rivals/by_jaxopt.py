"""jaxopt's operator-splitting quadratic programs on inscribed pyramids of several sides."""

from functools import partial
from typing import Literal

import jaxgrasp
from benchmarks.rivals.by_jaxgrasp import rival
from benchmarks.rivals.interface import Rival

Splitting = Literal["osqp", "box_osqp"]
NAMES: dict[Splitting, str] = {"osqp": "OSQP", "box_osqp": "BoxOSQP"}


def _pyramid(sides: int, solver: Splitting, tolerance: float) -> Rival:
    method = partial(jaxgrasp.pyramid_optimum, sides=sides, solver=solver, tol=tolerance)
    name = f"jaxopt {NAMES[solver]} pyramid of {sides} {tolerance:.0e}"
    return rival(name, "jaxopt", method, tolerance, cones="pyramids")


RIVALS = [
    *(_pyramid(sides, solver, 1e-6) for solver in NAMES for sides in (4, 8, 16)),
    _pyramid(8, "box_osqp", 1e-3),
]
