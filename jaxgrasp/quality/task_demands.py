"""Demands of a task on grasps beyond each load, and the least margin of a hand over the wrenches that it asks for.

Demands are wrenches, an ellipsoid of them, and uncertainty; they come from a TOML file.
"""

import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.files.file_values import build_dataclass, load_toml
from jaxgrasp.force.margin import wrench_margin
from jaxgrasp.model.arguments import check_arguments
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.grasp import Grasp, Limits
from jaxgrasp.validation.checked import check_not_negative, checked

Numbers = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """The table ``[uncertainty]``: arguments of [`jaxgrasp.quality.hold_probability`][]."""

    friction: float = 0.0
    """Standard deviation of the logarithm of friction."""
    place: float = 0.0
    """The spread of places along each tangent [m]."""
    load: Numbers = (0.0,) * 6
    """The spread of each component of the load [N, N.m]."""
    samples: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        check_not_negative(self, "friction", "place")
        _check_six(self.load, "load")
        for k, value in enumerate(self.load):
            if value < 0:
                raise ValueError(f"load[{k}] is {value}: expected zero or more")
        if self.samples < 1:
            raise ValueError(f"samples is {self.samples}: expected a number of cases, 1 or more")


@dataclass(frozen=True, kw_only=True)
class TaskDemands:
    """A file of demands; a missing demand is None, and measures that need it are not available."""

    about: Literal["contacts", "origin"] = "contacts"
    """Point about which torques are taken: the mean of each grasp's contacts, or the origin of their frame."""
    wrenches: tuple[Numbers, ...] | None = None
    """Wrenches that the hand must resist, for ``task-margin`` [N, N.m]."""
    semi_axes: Numbers | None = None
    """Semi-axes of the ellipsoid of disturbances along the six components, for ``task-ball-...`` [N, N.m]."""
    axes: tuple[Numbers, ...] | None = None
    """In place of these, any six semi-axes, one a row."""
    uncertainty: Uncertainty | None = None
    """For ``hold-probability``."""

    def __post_init__(self) -> None:
        for name in ("wrenches", "axes"):
            for k, row in enumerate(getattr(self, name) or ()):
                _check_six(row, f"{name}[{k}]")
        if self.wrenches is not None and not self.wrenches:
            raise ValueError("wrenches is empty: expected one or more")
        if self.semi_axes is not None:
            if self.axes is not None:
                raise ValueError("semi_axes and axes are both given: expected only one of them")
            _check_six(self.semi_axes, "semi_axes")
            for k, value in enumerate(self.semi_axes):
                if value <= 0:
                    raise ValueError(f"semi_axes[{k}] is {value}: expected a positive number")
        if self.axes is not None and (len(self.axes) != 6 or np.linalg.matrix_rank(np.array(self.axes)) < 6):
            raise ValueError(f"axes has {len(self.axes)} rows: expected six that span all wrenches")

    @property
    def ellipsoid(self) -> np.ndarray | None:
        """The semi-axes as columns ``(6, 6)``."""
        if self.semi_axes is not None:
            return np.diag(self.semi_axes)
        return None if self.axes is None else np.array(self.axes).T

    def to_json(self) -> dict[str, Any]:
        """Convert the demands to the dictionary that a manifest stores."""
        return asdict(self)


@checked
def load_demands(path: str | os.PathLike) -> TaskDemands:
    """Read the demands in a TOML file.

    Raises:
        ValueError: for a file that is no TOML, keys that are unknown, and values that cannot be, by name.
        OSError: for a file that cannot be read.
    """
    table = load_toml(Path(path))
    uncertainty = table.pop("uncertainty", None)
    if uncertainty is not None:
        table["uncertainty"] = build_dataclass(Uncertainty, uncertainty, f"{path}: uncertainty")
    return build_dataclass(TaskDemands, table, str(path))


def _check_six(numbers: Numbers, name: str) -> None:
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{name} is {list(numbers)}: expected six finite numbers")


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
