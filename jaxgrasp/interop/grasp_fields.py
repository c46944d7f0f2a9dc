"""Grasps in arrays by their names: our own ``.npz`` files of poses, and whatever else holds the same."""

import tokenize
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.interop.file_records import ROUNDING, GraspPoses, numbers, warn_unused
from jaxgrasp.model.faults import entries
from jaxgrasp.numerics.geometry import is_rotation

NAMES = {
    name: name for name in ("transforms", "angles", "mass", "friction", "center_of_mass", "scale", "mesh", "succeeded")
}


def read_npz_poses(path: Path) -> GraspPoses:
    """Read poses from a file of the package's own format.

    Warns:
        UserWarning: naming the arrays that are not used.

    Raises:
        ValueError: for a file that is none, naming the entry that is wrong.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            fields = {name: file[name] for name in NAMES if name in file.files}
            array_names = file.files
    except (ValueError, OSError, zipfile.BadZipFile, SyntaxError, tokenize.TokenError) as error:
        raise ValueError(f"{path}: it cannot be read as .npz: {error}") from None
    warn_unused("poses", array_names, NAMES)
    return poses_of_fields(path, fields, NAMES)


def poses_of_fields(
    path: Path, fields: Mapping[str, Any], file_names: Mapping[str, str], keep_going: bool = False
) -> GraspPoses:
    """Check arrays and build grasps from them.

    Args:
        path: of the file, for messages.
        fields: arrays by our names; what the file does not say is missing.
        file_names: what the file itself calls them.
        keep_going: leave bad poses out and say what is wrong with them, instead of stopping at the first.

    Raises:
        ValueError: naming the entry that is wrong.
    """
    try:
        if fields.get("transforms") is None:
            raise ValueError(
                f"it has no {file_names['transforms']}: expected wrist poses (N, 4, 4) in the mesh's frame"
            )
        transforms, valid, messages = _transforms(fields["transforms"], keep_going)
        count, scale = len(transforms), _number("scale", fields)
        angles = _array("angles", fields, (None, None))
        if angles is not None and len(angles) != count:
            raise ValueError(f"angles has {len(angles)} rows: expected {count}, one for each transform")
        poses = GraspPoses(
            path,
            tuple(map(str, range(count))),
            transforms,
            angles,
            None if scale is None else np.full(count, scale),
            None,
            _text(fields.get("mesh")),
            mass=_number("mass", fields),
            friction=_number("friction", fields),
            center_of_mass=_array("center_of_mass", fields, (3,)),
            succeeded=_flags(fields, count),
            left_out=tuple(f"{path}: {message}" for message in messages),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return poses if len(valid) == count else poses.rows(valid)


def _transforms(raw: Any, keep_going: bool) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return all poses, the indices of the valid ones, and messages on the others."""
    poses = np.asarray(raw)
    if poses.dtype.kind not in "fiu":
        raise ValueError(f"transforms holds {poses.dtype}: expected numbers")
    poses = poses.astype(float)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not len(poses):
        raise ValueError(f"transforms has shape {poses.shape}: expected (N, 4, 4), N at least 1")
    if not keep_going:
        for fault in entries("transforms", poses, ~np.isfinite(poses), "a finite number"):
            raise ValueError(str(fault))
    proper = is_rotation(poses[:, :3, :3], ROUNDING) & np.all(poses[:, 3] == [0, 0, 0, 1], axis=1)
    proper &= np.isfinite(poses).all((1, 2))
    bad = np.flatnonzero(~proper)
    expected = "expected a rotation and an origin above the row 0 0 0 1"
    if len(bad) and (len(bad) == len(poses) or not keep_going):
        more = f" ({len(bad)} of {len(poses)} are not poses)" if len(bad) > 1 else ""
        raise ValueError(f"transforms[{bad[0]}] is not a pose: {expected}{more}")
    return poses, np.flatnonzero(proper), [f"transforms[{index}] is not a pose: {expected}" for index in bad]


def _array(name: str, fields: Mapping[str, Any], shape: tuple[int | None, ...]) -> np.ndarray | None:
    return None if fields.get(name) is None else numbers(name, fields[name], shape)


def _number(name: str, fields: Mapping[str, Any]) -> float | None:
    if fields.get(name) is None:
        return None
    array = np.asarray(fields[name])
    if array.size != 1 or not numbers(name, array.ravel(), (1,))[0] >= 0:
        raise ValueError(f"{name} is {array.tolist()}: expected one number, 0 or more")
    return float(array.ravel()[0])


def _flags(fields: Mapping[str, Any], count: int) -> np.ndarray | None:
    if fields.get("succeeded") is None:
        return None
    array = np.asarray(fields["succeeded"])
    if array.shape != (count,) or array.dtype.kind not in "biuf":
        raise ValueError(f"succeeded has shape {array.shape} of {array.dtype}: expected ({count},) of true or false")
    return array > 0.5


def _text(value: Any) -> str | None:
    if value is None:
        return None
    array = np.asarray(value)
    if array.size != 1 or not isinstance(text := array.item(), str | bytes):
        raise ValueError(f"mesh is of {array.dtype} {array.shape}: expected one text")
    return text.decode(errors="replace") if isinstance(text, bytes) else text
