"""Demands of a task on grasps beyond each load: wrenches, an ellipsoid of them, uncertainty; from a TOML file."""

import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxgrasp.files.toml_fields import build_dataclass, load_toml
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.values import check_not_negative

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
