"""Arguments of ``jaxgrasp contacts``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class FindContacts:
    """Find where hands or grippers touch a mesh, and write a file of contacts for evaluate (needs the extra `mesh`)."""

    file: tyro.conf.Positional[Path]
    """Poses of the wrist in the mesh's frame: .npz with `transforms` (N, 4, 4) and, of hands that do not close any
    further, `angles` (N, J); or ACRONYM's HDF5."""
    mesh: Path | None = None
    """A closed triangle mesh, in any format that trimesh reads; the one that the file names where not given."""
    scale: float | None = None
    """Metres for one unit of the mesh; the file's, or 1, where not given."""
    hand: Literal["jaw", "human-right", "human-left"] = "jaw"
    """Two parallel jaws like a Franka hand's, or a human hand."""
    hand_length: float = 0.19
    """Length of a human hand, from the wrist to the middle finger's tip [m]."""
    levels: int = 6
    """Number of times that the cube about the mesh is cut in eight."""
    depth: float = 1e-3
    """Depth to which a closing hand presses into the mesh [m]."""
    friction: float | None = None
    """Coulomb's coefficient; the file's where not given."""
    stiffness: float = 1000.0
    """K of eq. 6 [N/m]."""
    mass: float | None = None
    """Mass of the object [kg]; the file's where not given."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    """Gravity in the mesh's frame [m/s^2]."""
    max_contacts: int | None = None
    """Largest number of contacts of a grasp: the deepest are kept."""
    out: Path = Path("contacts.npz")
    """The file of contacts."""
