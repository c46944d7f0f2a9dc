"""GraspGen's files: poses of a gripper's base in the frame of an object's mesh.

A file in JSON has ``object`` ``{file, scale}``, the mesh's path in the data set and the size of its unit [m], and
``grasps`` ``{transforms, object_in_gripper}``: ``transforms`` (N, 4, 4) of the gripper's base link in the mesh's frame,
already at that scale [m], and which of them held in simulation. The gripper looks along its z axis and closes along x.
Which gripper it is the file does not say: of suction cups, which have no jaws, nothing here finds contacts.
Normals, forces and joints there are none.

Source: Murali et al., GraspGen, 2025; https://github.com/NVlabs/GraspGen, ``docs/GRASP_DATASET_FORMAT.md`` and
``docs/GRIPPER_DESCRIPTION.md``.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxgrasp.files.printable import shortened
from jaxgrasp.interop.file_records import GraspPoses, field, positive, read_each, read_text, transform, warn_unused
from jaxgrasp.validation.checked import checked

USED = ("object", "object.file", "object.scale", "grasps", "grasps.transforms", "grasps.object_in_gripper")
"""Fields of a file that are read."""


@checked
def read_graspgen(path: str | Path, *, keep_going: bool = False) -> GraspPoses:
    """Read the grasps of a GraspGen file.

    Args:
        path: a ``.json`` file.
        keep_going: leave bad grasps out and say what is wrong with them, instead of stopping at the first.

    Returns:
        Poses in the mesh's frame.

    Raises:
        ValueError: for a file that is none of GraspGen's, and for its first bad grasp.
        OSError: for a file that cannot be read.
    """
    content = _json(path)
    try:
        object_, grasps = field(content, "object"), field(content, "grasps")
        mesh, scale = field(object_, "file"), positive("object.scale", field(object_, "scale"))
        transforms = field(grasps, "transforms")
        if not isinstance(transforms, list) or not transforms:
            raise ValueError(f"grasps.transforms is {shortened(transforms)}: expected a list of poses")
        succeeded = _flags(grasps.get("object_in_gripper"), len(transforms))
    except ValueError as error:
        raise ValueError(f"{path} is not a GraspGen file: {error}") from None
    names = [*content, *(f"object.{name}" for name in object_), *(f"grasps.{name}" for name in grasps)]
    warn_unused("GraspGen", names, USED)
    named_transforms = ((str(number), pose) for number, pose in enumerate(transforms))
    named_poses, left_out = read_each(
        path, named_transforms, lambda pose: transform("transforms", pose), keep_going, "grasp"
    )
    indices = np.array([int(name) for name, _ in named_poses])
    return GraspPoses(
        Path(path),
        tuple(name for name, _ in named_poses),
        np.stack([pose for _, pose in named_poses]),
        scales=np.full(len(named_poses), scale),
        mesh=mesh if isinstance(mesh, str) else None,
        succeeded=None if succeeded is None else succeeded[indices],
        left_out=left_out,
    )


def _json(path: str | Path) -> Any:
    text = read_text(path)
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError(f"{path} is nested too deeply: expected the JSON of a GraspGen file") from None
    except ValueError as error:
        raise ValueError(f"{path} is not JSON: {error}") from None


def _flags(raw: Any, count: int) -> np.ndarray | None:
    if raw is None:
        return None
    if not isinstance(raw, list) or len(raw) != count or any(flag not in (0, 1) for flag in raw):
        raise ValueError(f"grasps.object_in_gripper is {shortened(raw)}: expected {count} of true or false")
    return np.array(raw, bool)
