"""Grasps that say where a hand touches, and for most of them with which forces: what readers of such files return."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.interop.grasp_poses import find_named

MESH_PARTS = 3
"""Number of last parts of a mesh's path that tell the object: the file's own name is that of every object."""
PULL = 0.05
"""Largest pull of a normal force that is accepted, as a share of the largest force: solvers reach no exact zero."""


@dataclass(frozen=True)
class ContactRecords:
    """N grasps of M contacts in all, in the world of their file."""

    path: Path
    names: tuple[str, ...]
    """Each grasp's name in its file."""
    points: Float[np.ndarray, "M 3"]
    """[m]"""
    normals: Float[np.ndarray, "M 3"]
    """Unit vectors into the object."""
    pressures: Float[np.ndarray, "M"]
    """Normal forces in the file's own unit; NaN where it has none."""
    offsets: np.ndarray
    """``(N + 1,)``: grasp i owns contacts ``offsets[i]:offsets[i + 1]``."""
    centers: Float[np.ndarray, "N 3"]
    """Centre of mass of the object; NaN where the file does not say it [m]."""
    loads: Float[np.ndarray, "N 6"]
    """Loads on the object in the file, about the world's origin, in the file's own unit of force."""
    objects: Float[np.ndarray, "N 4 4"] | None = None
    """Poses of the mesh."""
    scales: Float[np.ndarray, "N 3"] | None = None
    """Metres for one unit of the mesh, along its axes."""
    mesh: str | None = None
    """The mesh's path as the file has it."""
    left_out: tuple[str, ...] = ()
    """Messages on the records that were left out."""

    def __len__(self) -> int:
        return len(self.names)

    def mesh_path(self, folder: Path | None = None) -> Path | None:
        """Find the mesh in a folder, or beside the file and in the folders above it; None where it is not there."""
        return None if self.mesh is None else find_named(self.mesh, MESH_PARTS, self.path, folder)


class OneGrasp(NamedTuple):
    """The contacts of a grasp, before it is put among others."""

    points: np.ndarray
    normals: np.ndarray
    pressures: np.ndarray
    center: np.ndarray
    load: np.ndarray


def contact_records(
    path: str | Path, named_grasps: Sequence[tuple[str, OneGrasp]], left_out: tuple[str, ...], **fields: Any
) -> ContactRecords:
    """Concatenate grasps of different numbers of contacts into the records of a file."""
    grasps = [grasp for _, grasp in named_grasps]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(grasp, name) for grasp in grasps]) for name in ("points", "normals", "pressures")
    }
    return ContactRecords(
        path=Path(path),
        names=tuple(name for name, _ in named_grasps),
        **columns,
        offsets=np.concatenate([[0], np.cumsum([len(grasp.points) for grasp in grasps])]),
        centers=np.stack([grasp.center for grasp in grasps]),
        loads=np.stack([grasp.load for grasp in grasps]),
        left_out=left_out,
        **fields,
    )


def pressing(name: str, forces: np.ndarray) -> np.ndarray:
    """Check that normal forces press, and return them with small pulls set to zero.

    Raises:
        ValueError: for one that pulls: normals or forces point the other way than the format says.
    """
    bad = np.flatnonzero(forces < -PULL * np.abs(forces).max(initial=0))
    if len(bad):
        raise ValueError(
            f"{name}[{bad[0]}] pulls with {-forces[bad[0]]:.3g}: expected normals and forces into the object"
        )
    return np.maximum(forces, 0)
