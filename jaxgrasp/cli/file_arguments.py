"""Arguments of the commands that write files of grasps: ``jaxgrasp convert`` and ``jaxgrasp template``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Convert:
    """Convert a file of grasps to another format: .npz, .csv, .parquet or .h5, by the endings of the names."""

    file: tyro.conf.Positional[Path]
    """The file to read."""
    out: tyro.conf.Positional[Path]
    """The file to write, whole or not at all."""
    normals: Literal["inward", "outward"] = "inward"
    """Direction of the normals in the file to read; those that are written point into the object."""
    normalize: bool = False
    """Scale every normal to length 1; those of tables with few digits are not."""
    overwrite: bool = False
    """Replace an existing file."""


@dataclass(frozen=True)
class Template:
    """Write a small file of grasps with comments, to be filled in."""

    kind: tyro.conf.Positional[Literal["csv"]] = "csv"
    """Format of the file."""
    out: Path = Path("grasps.csv")
    """The file to write; an existing file is an error, and stays."""
