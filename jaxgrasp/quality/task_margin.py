"""The least margin of a hand over all wrenches that a task asks for, and which of them is the weakest."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.margin import wrench_margin
from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.limits import Limits
from jaxgrasp.validation.checked import checked


class TaskMargin(NamedTuple):
    """Multiples of each wrench of a task that a hand resists."""

    margin: Float[Array, "*batch"]
    """The least of them."""
    weakest: Int[Array, "*batch"]
    """Index of the weakest wrench, from 0; the first of equal ones."""
    margins: Float[Array, "*batch k"]
    """The margin of each wrench, as [`jaxgrasp.wrench_margin`][] has it."""


@checked
def task_margin(
    grasp: Grasp,
    tasks: Float[AnyArray, "*#batch k 6"],
    wrench: Float[AnyArray, "*#batch 6"] | None = None,
    sharing: str = "squeeze",
    *,
    limits: Limits | None = None,
) -> TaskMargin:
    """Compute the largest theta for which a hand exerts wrench + theta task, for each wrench of a task.

    Each multiple is by itself, one after the other; where it is 1 or more for all, every wrench of the task is
    resisted, and so is any mixture of them, since what is in reach is convex. Where they are the corners of what may
    come, that is all that may. Without ``limits`` forces may be as large as they need, and margins of a grasp that is
    closed are endless.

    Works under ``jit``, ``vmap`` and ``grad``. The derivative of the least margin is that of the weakest wrench's.

    Source of the measure: Borst, Fischer and Hirzinger, Grasp planning: how to choose a suitable task wrench space,
    ICRA 2004, for any finite set.

    Args:
        grasp: contacts ``(..., n)``; leading axes broadcast against the tasks' and the wrench's.
        tasks: k wrenches ``(..., k, 6)`` [N, N.m]: of what the hand must exert, against what disturbs the object.
        wrench: what it exerts already ``(..., 6)`` [N, N.m], as against the weight; none where it is not given.
        sharing: as for [`jaxgrasp.wrench_margin`][].
        limits: of the hand, as for [`jaxgrasp.constrained_optimum`][].

    Raises:
        ValueError: for a sharing that cannot be used, or shapes that do not fit.
        NotImplementedError: when differentiated twice.
    """
    load = np.zeros(6, np.float32) if wrench is None else wrench
    check_arguments(grasp, {"tasks": (tasks, ("k", 6)), "wrench": (load, (6,))}, {})
    if np.shape(tasks)[-2] == 0:
        raise ValueError(f"tasks has shape {np.shape(tasks)}: expected (..., k, 6) with at least one wrench")
    grasps, loads = _beside(grasp, Grasp.last_axes), _spread(load, 1)
    bounds = None if limits is None else _beside(limits, LIMIT_AXES)
    margins = wrench_margin(grasps, loads, tasks, sharing, limits=bounds)
    weakest = jnp.argmin(margins, -1)
    least = jnp.take_along_axis(margins, weakest[..., None], -1)[..., 0]
    return TaskMargin(least, weakest, margins)


LIMIT_AXES = {"normal_min": 1, "normal_max": 1, "torque_map": 3, "torque_max": 1}
"""Last axes of the fields of Limits."""


def _beside(record: Any, last_axes: dict[str, int]) -> Any:
    """Insert an axis for the wrenches of a task behind the leading axes of a grasp, or of its limits."""
    fields = {name: getattr(record, name) for name in last_axes}
    return type(record)(**{name: None if x is None else _spread(x, last_axes[name]) for name, x in fields.items()})


def _spread(array: AnyArray, last: int) -> Any:
    return (array if hasattr(array, "ndim") else np.asarray(array))[(..., None, *[slice(None)] * last)]
