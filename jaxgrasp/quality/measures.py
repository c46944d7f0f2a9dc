"""The measures of quality by name, as columns of numbers for many grasps: what an evaluation can be asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits
from jaxgrasp.numerics.centring import centred
from jaxgrasp.quality.closure import force_closure
from jaxgrasp.quality.ferrari_canny import ferrari_canny
from jaxgrasp.quality.hold_probability import hold_probability
from jaxgrasp.quality.min_weight import min_weight
from jaxgrasp.quality.singular_values import grasp_isotropy, grasp_volume, least_singular_value
from jaxgrasp.quality.task_demands import TaskDemands
from jaxgrasp.quality.task_margin import task_margin
from jaxgrasp.quality.wrench_sets import Bound

OPEN, CLOSED, UNDECIDED = 0, 1, -1
Columns = dict[str, np.ndarray]


class MeasuredGrasps(NamedTuple):
    """Grasps, loads and limits that measures are computed from."""

    grasp: Grasp
    """Contacts ``(N, n)``."""
    wrench: np.ndarray
    """The loads of each ``(N, W, 6)``."""
    limits: Limits | None


@dataclass(frozen=True)
class Measure:
    """A measure of grasps by name, with its options at their defaults."""

    name: str
    columns: Callable[[MeasuredGrasps], Columns]
    """It gives arrays ``(N,)`` by name, the one that sums it up first."""


def _closure(given: MeasuredGrasps) -> Columns:
    found = force_closure(given.grasp)
    code = np.where(found.closed, CLOSED, np.where(found.decided, OPEN, UNDECIDED))
    return {"closed": code.astype(np.int8), "margin": found.margin}


def _ball(bound: Bound, given: MeasuredGrasps) -> Columns:
    found = ferrari_canny(given.grasp, bound)
    return {"lower": found.lower, "upper": found.upper}


def _weight(given: MeasuredGrasps) -> Columns:
    return {"value": min_weight(given.grasp).value}


def _of_matrix(measure: Callable[[Grasp], jax.Array], given: MeasuredGrasps) -> Columns:
    return {"value": np.asarray(_compiled(measure)(given.grasp))}


@cache
def _compiled(measure: Callable[[Grasp], jax.Array]) -> Callable[[Grasp], jax.Array]:
    return jax.jit(measure)


def _task_ball(bound: Bound, demands: TaskDemands, given: MeasuredGrasps) -> Columns:
    about = np.zeros(3) if demands.about == "origin" else None
    found = ferrari_canny(given.grasp, bound, ellipsoid=demands.ellipsoid, about=about)
    return {"lower": found.lower, "upper": found.upper}


def _task_margin(demands: TaskDemands, given: MeasuredGrasps) -> Columns:
    grasp, wrenches = given.grasp, np.asarray(demands.wrenches)
    tasks = np.broadcast_to(wrenches, (len(given.wrench), *wrenches.shape)).copy()
    if demands.about == "contacts":
        there = np.ones(grasp.friction.shape, bool) if grasp.present is None else np.asarray(grasp.present) > 0.5
        middle = centred(np.asarray(grasp.points), there, numpy=np).middle
        tasks[..., 3:] += np.cross(middle[:, None], tasks[..., :3])
    found = task_margin(grasp, tasks.astype(given.wrench.dtype), sharing="uniform", limits=given.limits)
    return {"margin": np.asarray(found.margin), "weakest": np.asarray(found.weakest, np.int32)}


def _hold_probability(demands: TaskDemands, given: MeasuredGrasps) -> Columns:
    """Compute the columns of the hold probability for each grasp's worst load."""
    assert demands.uncertainty is not None
    own = demands.uncertainty
    each = [
        hold_probability(
            given.grasp,
            given.wrench[:, load],
            "uniform",
            limits=given.limits,
            friction_spread=own.friction,
            place_spread=own.place,
            load_spread=jnp.asarray(own.load, given.wrench.dtype),
            samples=own.samples,
            seed=own.seed,
        )
        for load in range(given.wrench.shape[1])
    ]
    shares = np.stack([found.probability for found in each])
    worst = np.argmin(shares, 0)[None]
    names = ("probability", "low", "high", "margin")
    return {name: np.take_along_axis(np.stack([getattr(found, name) for found in each]), worst, 0)[0] for name in names}


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
"""Measures that need the grasp only."""

TASK_MEASURES: dict[str, tuple[str, Callable[..., Columns]]] = {
    "task-ball-l1": ("ellipsoid", partial(_task_ball, "l1")),
    "task-ball-linf": ("ellipsoid", partial(_task_ball, "linf")),
    "task-margin": ("wrenches", _task_margin),
    "hold-probability": ("uncertainty", _hold_probability),
}
"""Measures of a task, each with the demand that it needs."""

ASKED = {"ellipsoid": "semi_axes or axes", "wrenches": "wrenches", "uncertainty": "a table [uncertainty]"}
"""Names of the demands in a file of demands."""


def measures_named(names: tuple[str, ...], demands: TaskDemands | None = None) -> tuple[Measure, ...]:
    """Look up measures by name and return each once, in the order of the tables above.

    Raises:
        ValueError: for a name that is unknown, or whose demands are not there.
    """
    known = (*MEASURES, *TASK_MEASURES)
    for name in names:
        if name not in known:
            raise ValueError(f"quality {name!r} is unknown: expected some of {', '.join(known)}")
    found = [measure for name, measure in MEASURES.items() if name in names]
    for name, (need, columns) in TASK_MEASURES.items():
        if name in names:
            if demands is None or getattr(demands, need) is None:
                raise ValueError(f"quality {name!r} is of a task: expected a task file with {ASKED[need]}")
            found.append(Measure(name, partial(columns, demands)))
    return tuple(found)
