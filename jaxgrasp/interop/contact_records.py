"""Grasps that say where a hand touches, and for most of them with which forces: what readers of such files return."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.interop.grasp_poses import find_named

MESH_PARTS = 3
"""How many last parts of a mesh's path tell the object: the file's own name is that of every object."""
PULL = 0.05
"""How far a solver's normal force may lie below zero, as a part of the largest: it is no exact zero."""


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
    """What the file means to pull at the object, about the world's origin, in the file's own unit of force."""
    objects: Float[np.ndarray, "N 4 4"] | None = None
    """Where the mesh stands."""
    scales: Float[np.ndarray, "N 3"] | None = None
    """Metres for one unit of the mesh, along its axes."""
    mesh: str | None = None
    """The mesh's path as the file has it."""
    left_out: tuple[str, ...] = ()
    """What was wrong with the records that are not among them."""

    def __len__(self) -> int:
        return len(self.names)

    def mesh_path(self, folder: Path | None = None) -> Path | None:
        """The mesh, looked for in a folder, or beside the file and in the folders above it."""
        return None if self.mesh is None else find_named(self.mesh, MESH_PARTS, self.path, folder)


class OneGrasp(NamedTuple):
    """The contacts of a grasp, before it is put among others."""

    points: np.ndarray
    normals: np.ndarray
    pressures: np.ndarray
    center: np.ndarray
    load: np.ndarray


def contact_records(
    path: str | Path, found: Sequence[tuple[str, OneGrasp]], left_out: tuple[str, ...], **more: Any
) -> ContactRecords:
    """Grasps of different sizes in one."""
    grasps = [grasp for _, grasp in found]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(one, name) for one in grasps]) for name in ("points", "normals", "pressures")
    }
    return ContactRecords(
        path=Path(path),
        names=tuple(name for name, _ in found),
        **columns,
        offsets=np.concatenate([[0], np.cumsum([len(one.points) for one in grasps])]),
        centers=np.stack([one.center for one in grasps]),
        loads=np.stack([one.load for one in grasps]),
        left_out=left_out,
        **more,
    )


def pressing(name: str, forces: np.ndarray) -> np.ndarray:
    """Normal forces, which press.

    Raises:
        ValueError: for one that pulls: normals or forces point the other way than the format says.
    """
    bad = np.flatnonzero(forces < -PULL * np.abs(forces).max(initial=0))
    if len(bad):
        raise ValueError(
            f"{name}[{bad[0]}] pulls with {-forces[bad[0]]:.3g}: expected normals and forces into the object"
        )
    return np.maximum(forces, 0)
