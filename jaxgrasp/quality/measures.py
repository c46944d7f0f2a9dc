"""The measures of quality by name, as columns of numbers for many grasps: what an evaluation can be asked for."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.numerics.geometry import centred
from jaxgrasp.quality.closure import force_closure
from jaxgrasp.quality.ferrari_canny import ferrari_canny
from jaxgrasp.quality.hold_probability import hold_probability
from jaxgrasp.quality.min_weight import min_weight
from jaxgrasp.quality.singular_values import grasp_isotropy, grasp_volume, least_singular_value
from jaxgrasp.quality.task_demands import TaskDemands, task_margin
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


def _closure(inputs: MeasuredGrasps) -> Columns:
    closure = force_closure(inputs.grasp)
    code = np.where(closure.closed, CLOSED, np.where(closure.decided, OPEN, UNDECIDED))
    return {"closed": code.astype(np.int8), "margin": closure.margin}


def _ball(bound: Bound, inputs: MeasuredGrasps) -> Columns:
    epsilon = ferrari_canny(inputs.grasp, bound)
    return {"lower": epsilon.lower, "upper": epsilon.upper}


def _weight(inputs: MeasuredGrasps) -> Columns:
    return {"value": min_weight(inputs.grasp).value}


def _of_matrix(measure: Callable[[Grasp], jax.Array], inputs: MeasuredGrasps) -> Columns:
    return {"value": np.asarray(_compiled(measure)(inputs.grasp))}


@cache
def _compiled(measure: Callable[[Grasp], jax.Array]) -> Callable[[Grasp], jax.Array]:
    return jax.jit(measure)


def _task_ball(bound: Bound, demands: TaskDemands, inputs: MeasuredGrasps) -> Columns:
    about = np.zeros(3) if demands.about == "origin" else None
    epsilon = ferrari_canny(inputs.grasp, bound, ellipsoid=demands.ellipsoid, about=about)
    return {"lower": epsilon.lower, "upper": epsilon.upper}


def _task_margin(demands: TaskDemands, inputs: MeasuredGrasps) -> Columns:
    grasp, wrenches = inputs.grasp, np.asarray(demands.wrenches)
    tasks = np.broadcast_to(wrenches, (len(inputs.wrench), *wrenches.shape)).copy()
    if demands.about == "contacts":
        present = np.ones(grasp.friction.shape, bool) if grasp.present is None else np.asarray(grasp.present) > 0.5
        middle = centred(np.asarray(grasp.points), present, numpy=np).middle
        tasks[..., 3:] += np.cross(middle[:, None], tasks[..., :3])
    margins = task_margin(grasp, tasks.astype(inputs.wrench.dtype), sharing="uniform", limits=inputs.limits)
    return {"margin": np.asarray(margins.margin), "weakest": np.asarray(margins.weakest, np.int32)}


def _hold_probability(demands: TaskDemands, inputs: MeasuredGrasps) -> Columns:
    """Compute the columns of the hold probability for each grasp's worst load."""
    assert demands.uncertainty is not None
    uncertainty = demands.uncertainty
    estimates = [
        hold_probability(
            inputs.grasp,
            inputs.wrench[:, load],
            "uniform",
            limits=inputs.limits,
            friction_spread=uncertainty.friction,
            place_spread=uncertainty.place,
            load_spread=jnp.asarray(uncertainty.load, inputs.wrench.dtype),
            samples=uncertainty.samples,
            seed=uncertainty.seed,
        )
        for load in range(inputs.wrench.shape[1])
    ]
    shares = np.stack([estimate.probability for estimate in estimates])
    worst = np.argmin(shares, 0)[None]
    names = ("probability", "low", "high", "margin")
    return {
        name: np.take_along_axis(np.stack([getattr(estimate, name) for estimate in estimates]), worst, 0)[0]
        for name in names
    }


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

DEMAND_KEYS = {"ellipsoid": "semi_axes or axes", "wrenches": "wrenches", "uncertainty": "a table [uncertainty]"}
"""Names of the demands in a file of demands."""


def measures_named(names: tuple[str, ...], demands: TaskDemands | None = None) -> tuple[Measure, ...]:
    """Look up measures by name and return each once, in the order of the tables above.

    Raises:
        ValueError: for a name that is unknown, or whose demands are missing.
    """
    known_names = (*MEASURES, *TASK_MEASURES)
    for name in names:
        if name not in known_names:
            raise ValueError(f"quality {name!r} is unknown: expected one or more of {', '.join(known_names)}")
    measures = [measure for name, measure in MEASURES.items() if name in names]
    for name, (need, columns) in TASK_MEASURES.items():
        if name in names:
            if demands is None or getattr(demands, need) is None:
                raise ValueError(
                    f"quality {name!r} needs the demands of a task: expected a task file with {DEMAND_KEYS[need]}"
                )
            measures.append(Measure(name, partial(columns, demands)))
    return tuple(measures)
