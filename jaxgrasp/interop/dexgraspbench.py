"""DexGraspBench's files: a hand's posture by the order of its joints, beside an object that stands in the world.

A file is one pickled record. ``grasp_qpos`` (also ``pregrasp_qpos`` and ``squeeze_qpos``) is what MuJoCo's ``qpos`` of
the hand is set to: the place of the hand's root in the world [m], its unit quaternion w, x, y, z, and the joints'
values [rad] in the order in which the benchmark's own MJCF of the hand has them. The root is that MJCF's world, not its
first body: the benchmark hangs the whole file on a free joint. ``obj_pose`` is the object's place in the world in the
same way, ``obj_scale`` the size of its mesh [m for one unit], ``obj_path`` the folder of its meshes, of which
``mesh/simplified.obj`` is the one that is meant. Normals and forces it has none. ``squeeze_qpos`` is where the joints
are driven to, beyond the grasp and into the object. Records that the benchmark has evaluated also have ``succ_flag``,
whether the object stayed in the hand in simulation; some have the root's place apart, as ``grasp_pose`` (7,) beside a
``grasp_qpos`` of the joints alone. The benchmark's other postures and measures are not needed.

Of the order no name is in the file: count and limits of the joints are checked, and that is all that can be.

Source: Chen, Ke and Wang, BODex, 2025; https://github.com/JYChen18/DexGraspBench, ``src/util/hand_util.py``,
``src/task/convert_format.py`` and ``src/task/eval_func/base.py``.
"""

from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxgrasp.files.plain_pickle import load_plain
from jaxgrasp.files.printable import shortened
from jaxgrasp.interop.file_records import GraspPoses, by_order, field, numbers, pose, positive, read_each, warn_unused
from jaxgrasp.model.hand import Hand
from jaxgrasp.validation.checked import checked

MESH = "mesh/simplified.obj"
POSTURES = ("grasp", "pregrasp", "squeeze")
USED = (
    *("obj_pose", "obj_scale", "obj_path", "succ_flag"),
    *(f"{posture}_{part}" for posture in POSTURES for part in ("qpos", "pose")),
)
"""Fields of a record that are read, as far as the posture asks for them."""
NOT_NEEDED = (
    *("approach_qpos", "lift_qpos", "delta_pos", "delta_angle"),
    *("ho_pene", "self_pene", "contact_num", "contact_dist", "contact_consis"),
)
"""Postures before and after the grasp, and measures of the benchmark; a warning names whatever else a record has."""


class _Grasp(NamedTuple):
    transform: np.ndarray
    angles: np.ndarray


@checked
def read_dexgraspbench(
    path: str | Path,
    hand: Hand,
    *,
    posture: Literal["pregrasp", "grasp", "squeeze"] = "grasp",
    keep_going: bool = False,
) -> GraspPoses:
    """Read the grasp of a DexGraspBench file, or its grasps where it holds several postures ``(n, 7 + J)``.

    Args:
        path: a ``.npy`` file.
        hand: of the MJCF that the file was made with, from its world on
            (``hand_from_mujoco(load_mjcf(path, capsules=True), "world").hand``: some of its links are meshes).
        posture: which of the file's postures; the limits of the joints are looked at in the grasp's.
        keep_going: leave bad postures out and say what is wrong with them, instead of stopping at the first.

    Returns:
        Poses in the world, where the object stands too, and which succeeded, where the file says so.

    Warns:
        UserWarning: naming the fields that are not used.

    Raises:
        ValueError: for a file that is none of DexGraspBench's, and for its first bad posture.
        OSError: for a file that cannot be read.
    """
    record = load_plain(path)
    try:
        object_ = pose("obj_pose", field(record, "obj_pose"))
        scale = positive("obj_scale", field(record, "obj_scale"))
        arrays = {name: _posture(record, name) for name in dict.fromkeys(("grasp", posture))}
        succeeded = record.get("succ_flag")
        if succeeded is not None and (np.ndim(succeeded) or succeeded not in (0, 1)):
            raise ValueError(f"succ_flag is {shortened(succeeded)}: expected true or false")
    except ValueError as error:
        raise ValueError(f"{path} is not a DexGraspBench grasp: {error}") from None
    metrics = (name for name in record if str(name).endswith("_metric"))
    warn_unused("DexGraspBench", record, (*USED, *NOT_NEEDED, *metrics))
    rows = len(arrays["grasp"])
    postures = ((str(i), {name: several[i : i + 1] for name, several in arrays.items()}) for i in range(rows))
    poses, left_out = read_each(path, postures, lambda grasp: _grasp(grasp, hand, posture), keep_going)
    object_path = record.get("obj_path")
    return GraspPoses(
        Path(path),
        tuple(name for name, _ in poses),
        np.stack([grasp.transform for _, grasp in poses]),
        np.stack([grasp.angles for _, grasp in poses]),
        np.full(len(poses), scale),
        np.tile(object_, (len(poses), 1, 1)),
        f"{object_path}/{MESH}" if isinstance(object_path, str) else None,
        mesh_parts=3,
        succeeded=None if succeeded is None else np.full(len(poses), bool(succeeded)),
        left_out=left_out,
    )


def _posture(record: Any, name: str) -> np.ndarray:
    """Return the rows of a posture: the root's pose, from a field of its own where there is one, and the joints."""
    joints, root = np.atleast_2d(field(record, f"{name}_qpos")), record.get(f"{name}_pose")
    if root is None:
        return joints
    root = np.atleast_2d(root)
    if root.shape != (len(joints), 7) or joints.ndim != 2:
        raise ValueError(f"{name}_pose has the shape {root.shape}: expected ({len(joints)}, 7)")
    return np.concatenate([root, joints], 1)


def _grasp(record: dict[str, Any], hand: Hand, posture: str) -> _Grasp:
    size = 7 + len(hand.joints)
    rows = {name: _row(name, several, size) for name, several in record.items()}
    by_order("grasp_qpos[7:]", rows["grasp"][7:], hand)
    return _Grasp(pose(f"{posture}_qpos[:7]", rows[posture][:7]), rows[posture][7:])


def _row(name: str, several: np.ndarray, size: int) -> np.ndarray:
    if several.ndim != 2 or several.shape != (1, size):
        raise ValueError(
            f"{name}_qpos has {several.size} numbers: expected {size}, the root's 7 and the hand's {size - 7} joints"
        )
    return numbers(f"{name}_qpos", several[0], (size,))
