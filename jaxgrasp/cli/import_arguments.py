"""Arguments of ``jaxgrasp import``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class ImportGrasps:
    """Make a file of contacts out of a data set's grasps, for evaluate (needs the extras `hands` and `mesh`)."""

    format: tyro.conf.Positional[Literal["dexgraspnet"]]
    """Whose files: DexGraspNet's .npy files of the Shadow hand."""
    files: tyro.conf.Positional[tuple[Path, ...]]
    """Files of grasps of one object."""
    hand: Path
    """The hand's MJCF, whose joints the files name; what this MuJoCo does not know of it is left out."""
    object: Path
    """The object's mesh, closed, in the units whose size the files say."""
    root: str | None = None
    """Body of the hand that the files place; the first of its model where not given."""
    reach: float = 1e-3
    """How far from the mesh a link still touches it [m]: the files' hands stand at its surface, not in it."""
    levels: int = 6
    """How often the cube about the mesh is cut in eight."""
    friction: float = 0.5
    """Coulomb's coefficient."""
    stiffness: float = 1000.0
    """K of eq. 6 [N/m]: squeezing forces are this times how far links reach in."""
    mass: float = 0.1
    """Mass of the object [kg]."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """Gravity in the mesh's frame [m/s^2]."""
    max_contacts: int | None = None
    """The most contacts of a grasp: the deepest are kept."""
    keep_going: bool = False
    """Leave bad records out and count them, instead of stopping at the first."""
    out: Path = Path("grasps.npz")
    """The file of contacts."""
