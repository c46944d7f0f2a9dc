"""Arguments of the commands that look at a file of grasps, and of all that read one."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Convention:
    """Differences of a file's grasps from the conventions."""

    normals: Literal["inward", "outward"] = "inward"
    """Direction of the file's normals: into the object, or out of it."""
    normalize: bool = False
    """Scale every normal to length 1; those of tables with few digits are not."""


@dataclass(frozen=True)
class Data(Convention):
    """File of grasps, and its differences from the conventions."""

    file: tyro.conf.Positional[Path | None] = None
    """A file of grasps (.npz, .csv, .parquet, .h5); the simulated grips that ship with the package where not given."""


@dataclass(frozen=True)
class Info(Data):
    """Say what a file of grasps holds."""


@dataclass(frozen=True)
class Validate(Data):
    """List every bad entry of a file of grasps; the exit code is 1 if there is any."""
