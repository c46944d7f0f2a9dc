"""Arguments of ``jaxgrasp show``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from jaxgrasp.cli.data_arguments import Data


@dataclass(frozen=True)
class Show(Data):
    """Draw one grasp of a file in three dimensions, with the forces of both answers."""

    grasp: str = "0"
    """Name of the grasp, or its number from 0."""
    wrench: int = 0
    """Number of one of its wrenches, from 0."""
    method: Literal["A", "B"] = "B"
    """Method whose closed form and optimum are drawn."""
    mesh: Path | None = None
    """The object, in the frame of the contacts (needs the extra `mesh`)."""
    scale: float = 1.0
    """Metres for one unit of the mesh."""
    out: Path = Path("show.html")
    """The page to write."""
