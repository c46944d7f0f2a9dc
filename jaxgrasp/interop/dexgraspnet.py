"""DexGraspNet's files: grasps of the Shadow hand by the names of its joints.

A file is a pickled array of records ``{qpos, scale}``. ``qpos`` has each joint's angle [rad] by its name in the hand's
MJCF, and where the hand's root stands in the object's frame: WRJTx, y, z [m], and WRJRx, y, z [rad], turned about the
fixed axes x, y, z one after the other. ``scale`` is the size of the object's mesh [m for one unit]. Normals and forces
it has none: contacts come from the geometry of hand and mesh.

Source: Wang et al., DexGraspNet: a large-scale robotic dexterous grasp dataset for general objects, 2023.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxgrasp.files.plain_pickle import load_plain
from jaxgrasp.files.toml_fields import nearest
from jaxgrasp.validation.checked import checked

PLACES = ("WRJTx", "WRJTy", "WRJTz")
TURNS = ("WRJRx", "WRJRy", "WRJRz")


class HandPoses(NamedTuple):
    """Where a hand stands at N grasps of an object, as a file has it."""

    numbers: np.ndarray
    """``(N,)``: of each record in its file."""
    angles: Float[np.ndarray, "N J"]
    """By the hand's joints [rad]."""
    positions: Float[np.ndarray, "N 3"]
    """Of the hand's root in the object's frame [m]."""
    rotations: Float[np.ndarray, "N 3 3"]
    """Its axes in that frame, as columns."""
    scales: Float[np.ndarray, "N"]
    """Metres for one unit of the object's mesh."""
    left_out: tuple[str, ...]
    """What was wrong with the records that are not among them."""


@checked
def read_dexgraspnet(path: str | Path, joints: Sequence[str], *, keep_going: bool = False) -> HandPoses:
    """The grasps of a file.

    Args:
        path: a ``.npy`` file.
        joints: names of the hand's joints, in its order; the file's are found by their names.
        keep_going: leave bad records out and say what is wrong with them, instead of stopping at the first.

    Raises:
        ValueError: for a file that is none of DexGraspNet's, and for its first bad record.
        OSError: for a file that cannot be read.
    """
    records = load_plain(path)
    if not isinstance(records, np.ndarray) or records.dtype != object or records.ndim != 1 or not len(records):
        raise ValueError(f"{path} holds no list of records: expected those of DexGraspNet")
    found: list[tuple[int, np.ndarray]] = []
    left_out = []
    for number, record in enumerate(records):
        try:
            found.append((number, _row(record, joints)))
        except ValueError as error:
            wrong = f"{path}: record {number}: {error}"
            if not keep_going:
                raise ValueError(wrong) from None
            left_out.append(wrong)
    if not found:
        raise ValueError(f"{left_out[0]}, and none of the {len(records)} records is better")
    rows = np.stack([row for _, row in found])
    count = len(joints)
    return HandPoses(
        numbers=np.array([number for number, _ in found]),
        angles=rows[:, :count],
        positions=rows[:, count : count + 3],
        rotations=_about_fixed_axes(rows[:, count + 3 : count + 6]),
        scales=rows[:, -1],
        left_out=tuple(left_out),
    )


def _row(record: Any, joints: Sequence[str]) -> np.ndarray:
    """Angles, position, turns and scale of a record."""
    if not isinstance(record, dict) or not isinstance(record.get("qpos"), dict) or "scale" not in record:
        raise ValueError("it has no qpos and scale")
    given = record["qpos"]
    wanted = (*joints, *PLACES, *TURNS)
    known = set(wanted)
    for name in given:
        if name not in known:
            raise ValueError(
                f"qpos has the joint {str(name)[:40]!r}, which the hand has not{nearest(str(name), wanted)}"
            )
    for name in wanted:
        if name not in given:
            raise ValueError(f"qpos has no {name!r}, which the hand has")
    values = [(name, given[name]) for name in wanted] + [("scale", record["scale"])]
    row = np.array([_number(name, value) for name, value in values])
    if not row[-1] > 0:
        raise ValueError(f"scale is {row[-1]:g}: expected a positive number")
    return row


def _number(name: str, value: Any) -> float:
    array = np.asarray(value)
    if array.shape != () or array.dtype.kind not in "fiu" or not np.isfinite(array):
        raise ValueError(f"{name} is {str(value)[:40]}: expected a finite number")
    return float(array)


def _about_fixed_axes(turns: np.ndarray) -> np.ndarray:
    """``(N, 3, 3)``: turned about x, then about y, then about z, axes that do not turn with it."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(turns).T, np.sin(turns).T
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
