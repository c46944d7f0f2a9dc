"""DexGraspNet's files: grasps of the Shadow hand by the names of its joints.

A file is a pickled array of records ``{qpos, scale}``. ``qpos`` has each joint's angle [rad] by its name in the hand's
MJCF, and where the hand's root stands in the object's frame: WRJTx, y, z [m], and WRJRx, y, z [rad], turned about the
fixed axes x, y, z one after the other. ``scale`` is the size of the object's mesh [m for one unit]. Normals and forces
it has none: contacts come from the geometry of hand and mesh. Grasps that the project has not validated yet also have
``qpos_st``, the hand's posture at the start of the search, which is not needed, and the energies of the search, of
which ``E_pen`` tells how far the hand penetrates the object; a warning names these and whatever else a record has.

Source: Wang et al., DexGraspNet: a large-scale robotic dexterous grasp dataset for general objects, 2023;
https://github.com/PKU-EPIC/DexGraspNet, ``grasp_generation/scripts``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.files.plain_pickle import load_plain
from jaxgrasp.interop.file_records import GraspPoses, by_name, frame, positive, read_each, warn_unused
from jaxgrasp.validation.checked import checked

PLACES = ("WRJTx", "WRJTy", "WRJTz")
TURNS = ("WRJRx", "WRJRy", "WRJRz")
USED = ("qpos", "scale", "qpos_st")
"""Fields of a record that are read, or that say nothing about the grasp."""


@checked
def read_dexgraspnet(path: str | Path, joints: Sequence[str], *, keep_going: bool = False) -> GraspPoses:
    """Read the grasps of a DexGraspNet file.

    Args:
        path: a ``.npy`` file.
        joints: names of the hand's joints, in its order; the file's are found by their names.
        keep_going: leave bad records out and say what is wrong with them, instead of stopping at the first.

    Warns:
        UserWarning: naming the fields that are not used.

    Raises:
        ValueError: for a file that is none of DexGraspNet's, and for its first bad record.
        OSError: for a file that cannot be read.
    """
    records = load_plain(path)
    if not isinstance(records, np.ndarray) or records.dtype != object or records.ndim != 1 or not len(records):
        raise ValueError(f"{path} holds no list of records: expected those of DexGraspNet")
    named_records = ((str(number), record) for number, record in enumerate(records))
    named_rows, left_out = read_each(path, named_records, lambda record: _row(record, joints), keep_going)
    warn_unused("DexGraspNet", (name for record in records if isinstance(record, dict) for name in record), USED)
    rows = np.stack([row for _, row in named_rows])
    count = len(joints)
    return GraspPoses(
        Path(path),
        tuple(name for name, _ in named_rows),
        frame(rows[:, count : count + 3], _about_fixed_axes(rows[:, count + 3 : count + 6])),
        rows[:, :count],
        rows[:, -1],
        left_out=left_out,
    )


def _row(record: Any, joints: Sequence[str]) -> np.ndarray:
    """Read the joint angles, position, turns and scale of a record into one row."""
    if not isinstance(record, dict) or not isinstance(record.get("qpos"), dict) or "scale" not in record:
        raise ValueError("it has no qpos and scale")
    return np.append(by_name(record["qpos"], (*joints, *PLACES, *TURNS), "qpos"), positive("scale", record["scale"]))


def _about_fixed_axes(turns: np.ndarray) -> np.ndarray:
    """Compute rotations ``(N, 3, 3)`` about the fixed axes x, then y, then z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(turns).T, np.sin(turns).T
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
