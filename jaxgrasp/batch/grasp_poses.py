"""Files that say where hands stand instead of where they touch: ``.npz`` arrays, and HDF5 in the manner of ACRONYM."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.batch.file_error import GraspFileError
from jaxgrasp.hand.posture_limits import is_rotation
from jaxgrasp.model.faults import entries

MISSING = "HDF5 files need h5py: pip install 'jaxgrasp[mesh]'"
ROUNDING = 1e-4
"""How far a rotation in a file may be from orthonormal: many are written in single precision."""
HDF5_NAMES = {
    "transforms": "grasps/transforms",
    "angles": "grasps/angles",
    "mass": "object/mass",
    "friction": "object/friction",
    "center_of_mass": "object/com",
    "scale": "object/scale",
    "mesh": "object/file",
}
"""Where an HDF5 file holds what an ``.npz`` file holds under the plain name; ``angles`` is ours."""


@dataclass(frozen=True)
class GraspPoses:
    """N grasps of one object; what the file does not say is None."""

    path: Path
    transforms: np.ndarray
    """``(N, 4, 4)``: of the wrist in the mesh's frame, lengths in metres."""
    angles: np.ndarray | None
    """``(N, J)`` [rad, m]"""
    mass: float | None
    """Mass of the object [kg]."""
    friction: float | None
    center_of_mass: np.ndarray | None
    """``(3,)`` in the mesh's frame [m]."""
    scale: float | None
    """Metres for one unit of the mesh."""
    mesh: str | None
    """The mesh's path as the file has it."""

    def __len__(self) -> int:
        return len(self.transforms)

    def mesh_path(self) -> Path | None:
        """The mesh, looked for beside the file and in the folders above it."""
        if self.mesh is None:
            return None
        for folder in self.path.resolve().parents:
            for name in (self.mesh, Path(self.mesh).name):
                if (folder / name).is_file():
                    return folder / name
        return None


def read_poses(path: Path) -> GraspPoses:
    """Read and check a file of poses.

    Raises:
        ImportError: for an HDF5 file without the extra `mesh`.
        GraspFileError: for a file that is not there or not of these kinds, naming the entry that is wrong.
    """
    if not path.is_file():
        raise GraspFileError(path, "no such file; expected .npz, .h5 or .hdf5")
    kind = path.suffix.lower()
    if kind not in (".npz", ".h5", ".hdf5"):
        raise GraspFileError(path, f"files end in .npz, .h5 or .hdf5, not in {kind!r}")
    fields = _read_npz(path) if kind == ".npz" else _read_hdf5(path)
    if fields.get("transforms") is None:
        wanted = "transforms" if kind == ".npz" else HDF5_NAMES["transforms"]
        raise GraspFileError(path, f"it has no {wanted}: expected wrist poses (N, 4, 4) in the mesh's frame")
    poses = GraspPoses(
        path,
        _transforms(path, fields["transforms"]),
        _array(path, "angles", fields, (None, None)),
        _number(path, "mass", fields),
        _number(path, "friction", fields),
        _array(path, "center_of_mass", fields, (3,)),
        _number(path, "scale", fields),
        _text(fields.get("mesh")),
    )
    if poses.angles is not None and len(poses.angles) != len(poses):
        raise GraspFileError(
            path, f"angles has {len(poses.angles)} rows: expected {len(poses)}, one for each transform"
        )
    return poses


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in HDF5_NAMES if name in file.files}
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise GraspFileError(path, f"it cannot be read as .npz: {error}") from None


def _read_hdf5(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise ImportError(MISSING) from None
    try:
        with h5py.File(path, "r") as file:
            return {name: file[place][()] for name, place in HDF5_NAMES.items() if place in file}
    except (OSError, KeyError, TypeError) as error:
        raise GraspFileError(path, f"it cannot be read as HDF5: {error}") from None


def _transforms(path: Path, array: Any) -> np.ndarray:
    poses = _numbers(path, "transforms", array)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not len(poses):
        raise GraspFileError(path, f"transforms has shape {poses.shape}: expected (N, 4, 4), N at least 1")
    proper = is_rotation(poses[:, :3, :3], ROUNDING) & np.all(poses[:, 3] == [0, 0, 0, 1], axis=1)
    bad = np.flatnonzero(~proper)
    if len(bad):
        raise GraspFileError(
            path,
            f"transforms[{bad[0]}] is no pose: expected a rotation and an origin above the row 0 0 0 1"
            + (f" ({len(bad)} of {len(poses)} are none)" if len(bad) > 1 else ""),
        )
    return poses


def _numbers(path: Path, name: str, array: Any) -> np.ndarray:
    array = np.asarray(array)
    if not (np.issubdtype(array.dtype, np.floating) or np.issubdtype(array.dtype, np.integer)):
        raise GraspFileError(path, f"{name} holds {array.dtype}: expected numbers")
    array = array.astype(float)
    for fault in entries(name, array, ~np.isfinite(array), "a finite number"):
        raise GraspFileError(path, str(fault))
    return array


def _array(path: Path, name: str, fields: dict[str, Any], shape: tuple[int | None, ...]) -> np.ndarray | None:
    if fields.get(name) is None:
        return None
    array = _numbers(path, name, fields[name])
    if array.ndim != len(shape) or any(wanted not in (None, own) for wanted, own in zip(shape, array.shape)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise GraspFileError(path, f"{name} has shape {array.shape}: expected ({wanted})")
    return array


def _number(path: Path, name: str, fields: dict[str, Any]) -> float | None:
    if fields.get(name) is None:
        return None
    array = _numbers(path, name, fields[name])
    if array.size != 1 or not array.ravel()[0] >= 0:
        raise GraspFileError(path, f"{name} is {array.tolist()}: expected one number, 0 or more")
    return float(array.ravel()[0])


def _text(value: Any) -> str | None:
    if value is None:
        return None
    value = np.asarray(value).item()
    return value.decode() if isinstance(value, bytes) else str(value)
