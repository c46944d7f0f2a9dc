"""Arguments of the commands that write files of grasps: ``jaxgrasp convert`` and ``jaxgrasp template``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Convert:
    """Write the grasps of a file as a file of another kind: .npz, .csv, .parquet or .h5, by their endings."""

    file: tyro.conf.Positional[Path]
    """The file to read."""
    out: tyro.conf.Positional[Path]
    """The file to write, whole or not at all."""
    normals: Literal["inward", "outward"] = "inward"
    """Where the normals of the file to read point; those that are written point into the object."""
    normalize: bool = False
    """Make every normal length 1, as those of tables with few digits are not."""
    overwrite: bool = False
    """Replace a file that stands there."""


@dataclass(frozen=True)
class Template:
    """Write a small file of grasps with comments, to be filled in."""

    kind: tyro.conf.Positional[Literal["csv"]] = "csv"
    """What kind of file."""
    out: Path = Path("grasps.csv")
    """The file to write; one that stands there is left alone, and refused."""
