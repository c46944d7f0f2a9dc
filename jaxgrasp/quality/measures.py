"""The measures of quality by name, as columns of numbers for many grasps: what an evaluation can be asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import jax
import numpy as np

from jaxgrasp.model.grasp import Grasp
from jaxgrasp.quality.closure import force_closure
from jaxgrasp.quality.ferrari_canny import ferrari_canny
from jaxgrasp.quality.min_weight import min_weight
from jaxgrasp.quality.singular_values import grasp_isotropy, grasp_volume, least_singular_value
from jaxgrasp.quality.wrench_sets import Bound

OPEN, CLOSED, UNDECIDED = 0, 1, -1


@dataclass(frozen=True)
class Measure:
    """One measure of grasps, with its options at their defaults."""

    name: str
    columns: Callable[[Grasp], dict[str, np.ndarray]]
    """Function of a batch of grasps ``(N, n)``: it gives arrays ``(N,)`` by name, the one that sums it up first."""


def _closure(grasp: Grasp) -> dict[str, np.ndarray]:
    found = force_closure(grasp)
    code = np.where(found.closed, CLOSED, np.where(found.decided, OPEN, UNDECIDED))
    return {"closed": code.astype(np.int8), "margin": found.margin}


def _ball(bound: Bound, grasp: Grasp) -> dict[str, np.ndarray]:
    found = ferrari_canny(grasp, bound)
    return {"lower": found.lower, "upper": found.upper}


def _weight(grasp: Grasp) -> dict[str, np.ndarray]:
    return {"value": min_weight(grasp).value}


def _of_matrix(measure: Callable[[Grasp], jax.Array], grasp: Grasp) -> dict[str, np.ndarray]:
    return {"value": np.asarray(_compiled(measure)(grasp))}


@cache
def _compiled(measure: Callable[[Grasp], jax.Array]) -> Callable[[Grasp], jax.Array]:
    return jax.jit(measure)


MEASURES = {
    measure.name: measure
    for measure in (
        Measure("force-closure", _closure),
        Measure("ferrari-canny-l1", partial(_ball, "l1")),
        Measure("ferrari-canny-linf", partial(_ball, "linf")),
        Measure("min-weight", _weight),
        Measure("least-singular-value", partial(_of_matrix, least_singular_value)),
        Measure("volume", partial(_of_matrix, grasp_volume)),
        Measure("isotropy", partial(_of_matrix, grasp_isotropy)),
    )
}


def measures_named(names: tuple[str, ...]) -> tuple[Measure, ...]:
    """The measures of these names, each once, in the order of the table above."""
    for name in names:
        if name not in MEASURES:
            raise ValueError(f"quality {name!r} is unknown: expected some of {', '.join(MEASURES)}")
    return tuple(measure for name, measure in MEASURES.items() if name in names)
