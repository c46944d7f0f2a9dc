"""BODex's files: grasps of an object with their contacts, and the pressures that its own optimisation found.

A file is one pickled record of one object or several, b, each with n grasps of p contacts, in the world in which the
object stands; lengths in metres. ``contact_point`` (b, n, p, 3) lies on the object, ``contact_frame`` (b, n, p, 3, 3)
has as its column 0 the normal into the object, and as the others two tangents. ``contact_force`` (b, n, m, p, 3 or 4)
is in that frame, pressure first, for each of m wrenches that were to be exerted; a contact presses by at most 1.
``world_cfg`` says where the object's mesh stands (x, y, z and quaternion w, x, y, z), its ``scale`` and its path;
``obj_pose`` (b, 7), ``obj_scale`` (b,) and ``obj_path`` (b,) say the same of the gripped object alone, and are used
where ``world_cfg`` has other meshes too, or is not there.

The pressures here are the means over the m wrenches. Friction is not in the files; it is ``miu_coef`` of the run, 0.1
for the Shadow hand's. Grasps whose ``grasp_error`` is large are not left out. The object's centre of mass is not in the
files either: it comes from the mesh. Names of the object (``manip_name``, ``obj_code``) and ``robot_pose`` (b, n, 3, 7
+ J), the hand in pregrasp, grasp and squeeze with its ``joint_names``, the thumb's first, are not needed.

Source: Chen, Ke and Wang, BODex, 2025; https://github.com/JYChen18/BODex, ``example_grasp/plan_batch_env.py``,
``src/curobo/util/save_helper.py`` and ``src/curobo/rollout/cost/grasp_energy``.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.files.plain_pickle import load_plain
from jaxgrasp.files.printable import shortened
from jaxgrasp.interop.file_records import (
    ContactRecords,
    OneGrasp,
    contact_records,
    field,
    numbers,
    pose,
    pressing,
    read_each,
    rigid_axes,
    warn_unused,
)
from jaxgrasp.validation.checked import checked

USED = ("contact_point", "contact_frame", "contact_force", "world_cfg", "obj_pose", "obj_scale", "obj_path")
NOT_NEEDED = (
    "robot_pose",
    "joint_names",
    "grasp_error",
    "dist_error",
    "pene_error",
    "scene_path",
    "manip_name",
    "obj_code",
)
"""Fields about the hand and the search for the grasp; a warning names whatever else a record has."""


class _Object(NamedTuple):
    transform: np.ndarray
    scale: np.ndarray
    mesh: str


@checked
def read_bodex(path: str | Path, *, keep_going: bool = False) -> ContactRecords:
    """Read the grasps of a BODex file.

    Args:
        path: a ``.npy`` file.
        keep_going: leave bad grasps out and say what is wrong with them, instead of stopping at the first.

    Returns:
        Contacts in the file's world. The unit of pressures is the largest pressure of a contact. Objects, scales and
        mesh are None where the file does not have one mesh for each b, all of one path.

    Warns:
        UserWarning: naming the fields that are not used.

    Raises:
        ValueError: for a file that is none of BODex's, and for its first bad grasp.
        OSError: for a file that cannot be read.
    """
    record = load_plain(path)
    try:
        points, frames, forces = (_array(record, name) for name in ("contact_point", "contact_frame", "contact_force"))
        _check_shapes(points, frames, forces)
        objects = _objects(record, len(points))
    except ValueError as error:
        raise ValueError(f"{path} is not a BODex file: {error}") from None

    def contact_arrays() -> Iterator[tuple[str, Any]]:
        for index in np.ndindex(points.shape[:2]):
            yield ", ".join(map(str, index)), (points[index], frames[index], forces[index])

    grasps, left_out = read_each(path, contact_arrays(), _grasp, keep_going)
    warn_unused("BODex", record, (*USED, *NOT_NEEDED))
    if objects is None:
        return contact_records(path, grasps, left_out)
    object_of_grasp = [objects[int(name.split(",")[0])] for name, _ in grasps]
    return contact_records(
        path,
        grasps,
        left_out,
        objects=np.stack([object_.transform for object_ in object_of_grasp]),
        scales=np.stack([object_.scale for object_ in object_of_grasp]),
        mesh=object_of_grasp[0].mesh,
    )


def _array(record: Any, name: str) -> np.ndarray:
    array = field(record, name)
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise ValueError(f"{name} is not an array of numbers")
    return array


def _check_shapes(points: np.ndarray, frames: np.ndarray, forces: np.ndarray) -> None:
    if points.ndim != 4 or points.shape[3] != 3 or 0 in points.shape:
        raise ValueError(f"contact_point has the shape {points.shape}: expected (b, n, p, 3)")
    if frames.shape != (*points.shape, 3):
        raise ValueError(f"contact_frame has the shape {frames.shape}: expected {(*points.shape, 3)}")
    b, n, p, _ = points.shape
    if forces.ndim != 5 or forces.shape[:2] != (b, n) or forces.shape[3] != p or forces.shape[4] not in (3, 4):
        raise ValueError(f"contact_force has the shape {forces.shape}: expected ({b}, {n}, m, {p}, 3 or 4)")
    if not forces.shape[2]:
        raise ValueError("contact_force holds no wrench: expected at least one")


def _grasp(arrays: tuple[np.ndarray, np.ndarray, np.ndarray]) -> OneGrasp:
    points = numbers("contact_point", arrays[0], (None, 3))
    frames = rigid_axes("contact_frame", arrays[1])
    forces = numbers("contact_force", arrays[2], (None, len(points), None))
    pressures = pressing("contact_force", forces[..., 0].mean(0))
    return OneGrasp(points, frames[..., 0], pressures, np.full(3, np.nan), np.zeros(6))


def _objects(record: dict, count: int) -> list[_Object] | None:
    """Read the objects' meshes and their poses; None unless the file has a single mesh for each world."""
    objects = _objects_of_worlds(record.get("world_cfg"), count)
    if objects is None and all(record.get(name) is not None for name in ("obj_pose", "obj_scale", "obj_path")):
        objects = _gripped_objects(record, count)
    return objects if objects is not None and len({object_.mesh for object_ in objects}) == 1 else None


def _gripped_objects(record: dict, count: int) -> list[_Object]:
    """Read the gripped objects, one for each b, from fields of their own."""
    poses, scales = numbers("obj_pose", record["obj_pose"], (count, 7)), np.asarray(record["obj_scale"])
    scales = numbers("obj_scale", scales, (count, 3) if scales.ndim == 2 else (count,))
    if not (scales > 0).all():
        raise ValueError(f"obj_scale is {scales.tolist()}: expected positive numbers")
    paths = record["obj_path"]
    if not isinstance(paths, list | tuple | np.ndarray) or len(paths) != count:
        raise ValueError(f"obj_path is {shortened(paths)}: expected {count}, one for each b")
    per_axis = scales if scales.ndim == 2 else np.repeat(scales[:, None], 3, 1)
    return [
        _Object(pose("obj_pose", values), scale, str(path))
        for values, scale, path in zip(poses, per_axis, paths, strict=True)
    ]


def _objects_of_worlds(worlds: Any, count: int) -> list[_Object] | None:
    if not isinstance(worlds, list | tuple) or len(worlds) != count:
        return None
    objects = []
    for world in worlds:
        meshes = world.get("mesh") if isinstance(world, dict) else None
        if not isinstance(meshes, dict) or len(meshes) != 1:
            return None
        ((name, mesh),) = meshes.items()
        scale = np.asarray(field(mesh, "scale"))
        scale = np.full(3, scale) if scale.ndim == 0 else scale
        scale = numbers(f"world_cfg mesh {str(name)[:40]!r} scale", scale, (3,))
        if not (scale > 0).all():
            raise ValueError(f"world_cfg has the scale {scale}: expected positive numbers")
        objects.append(_Object(pose("world_cfg pose", field(mesh, "pose")), scale, str(field(mesh, "file_path"))))
    return objects
