"""Arguments of ``jaxgrasp view``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class View:
    """Show a live hand, a scene or a file of grasps in a browser (needs the extra `view`)."""

    file: tyro.conf.Positional[str | None] = None
    """A file of grasps (.npz, .csv, .parquet, .h5), which is stepped through; a TOML file of a scene or the name of a
    ready one, in which time runs; a hand around a cylinder where not given."""
    grasp: str | None = None
    """Grasp of a file that is shown first: its name, or its number from 0; the best where not given."""
    law: Literal["closed-form", "optimum"] | None = None
    """Law of the forces that the hand applies; the scene's, or the optimum, where not given."""
    save: Path | None = None
    """Write the first state of the scene as a page that opens offline, and show nothing."""
    host: str = "127.0.0.1"
    """Address to listen at: others than this machine's own let others look, and move the sliders."""
    allowed_hosts: tuple[str, ...] = ()
    """Further names by which browsers reach this machine, beside localhost, addresses and `--host`; pages of other
    sites are refused."""
    port: int = 8080
    """Port to listen at; 0 for any free one."""
    normals: Literal["inward", "outward"] = "inward"
    """Direction of the normals of a file of grasps: into the object, or out of it."""
    normalize: bool = False
    """Scale every normal of a file of grasps to length 1; those of tables with few digits are not."""
    mesh: Path | None = None
    """The object of a file of grasps, in the frame of its contacts (needs the extra `mesh`)."""
    scale: float = 1.0
    """Metres for one unit of the mesh."""
    seconds: float | None = None
    """Duration; until interrupted where not given."""
