"""Grasps that say where a hand or gripper stands, not where it touches: what every reader of such files returns."""

from dataclasses import dataclass, replace
from os.path import isfile
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

LONGEST_PATH = 4096
"""Characters of a path; no file has a longer one."""


@dataclass(frozen=True)
class GraspPoses:
    """N grasps of one object; what the file does not say is None."""

    path: Path
    names: tuple[str, ...]
    """Each grasp's name in its file, or its number there."""
    transforms: Float[np.ndarray, "N 4 4"]
    """Poses of the wrist or the gripper; in the mesh's frame, or where ``objects`` is given in the one that both stand
    in. Lengths in metres."""
    angles: Float[np.ndarray, "N J"] | None = None
    """Positions of the hand's joints [rad, m]; None of a hand that is to close."""
    scales: Float[np.ndarray, "N"] | None = None
    """Metres for one unit of the object's mesh."""
    objects: Float[np.ndarray, "N 4 4"] | None = None
    """Poses of the mesh; at the origin where None."""
    mesh: str | None = None
    """The mesh's path as the file has it."""
    mesh_parts: int = 1
    """Number of last parts of that path that tell the object: all objects may have the same file name."""
    mass: float | None = None
    """Mass of the object [kg]."""
    friction: float | None = None
    center_of_mass: Float[np.ndarray, "3"] | None = None
    """In the mesh's frame [m]."""
    succeeded: Bool[np.ndarray, "N"] | None = None
    """True for grasps that held in the simulator that the file comes from."""
    left_out: tuple[str, ...] = ()
    """Messages on the records that were left out."""

    def __len__(self) -> int:
        return len(self.transforms)

    def rows(self, chosen: np.ndarray) -> "GraspPoses":
        """Return the grasps of the given indices or mask."""
        by_grasp = ("transforms", "angles", "scales", "objects", "succeeded")
        changed = {name: array[chosen] for name in by_grasp if (array := getattr(self, name)) is not None}
        return replace(self, names=tuple(self.names[i] for i in chosen), **changed)

    def mesh_path(self, folder: Path | None = None) -> Path | None:
        """Find the mesh in a folder, or beside the file and in the folders above it; None where it is not there."""
        return None if self.mesh is None else find_named(self.mesh, self.mesh_parts, self.path, folder)


def find_named(name: str, least: int, beside: Path, folder: Path | None = None) -> Path | None:
    """Find a file that another file names: under a folder, or beside that file and in the folders above it.

    Paths that only the machine had that wrote the file are tried from each of their parts on, as long as ``least``
    parts are left.
    """
    if len(name) > LONGEST_PATH:
        return None
    folders = beside.resolve().parents if folder is None else (folder,)
    parts = Path(name).parts
    for directory in folders:
        for first in range(max(1, len(parts) - least + 1)):
            candidate = directory / Path(*parts[first:])
            # Path.is_file raises for a name that is too long: no such file exists.
            if isfile(candidate):
                return candidate
    return None
