"""Writers of grasp poses for other programs: Isaac Sim's isaac_grasp files, and GraspGen's.

The readers of this package read back what they write. Sources of the formats are in
[`read_isaac_grasp`][jaxgrasp.interop.read_isaac_grasp] and [`read_graspgen`][jaxgrasp.interop.read_graspgen].
"""

import json
import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxgrasp.files.printable import message_line, shortened
from jaxgrasp.files.replace import replace_file
from jaxgrasp.interop.file_records import GraspPoses, numbers, positive, transform
from jaxgrasp.interop.isaac_grasp import MISSING, YAML_FLOAT
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import optional_library

HELD = 0.5
"""Least confidence of a grasp that holds."""
LARGEST_MARGIN = 2.0


@checked
def hold_confidence(margin: Float[np.ndarray, "..."]) -> np.ndarray:
    r"""Compute the confidence of isaac_grasp files, from 0 to 1, from the margin of [`jaxgrasp.quality.hold_margin`][].

    $$c = \tfrac12 + \tfrac14 \min(m, 2) \text{ for } m > 0, \qquad c = 0 \text{ otherwise}$$

    At least 0.5 exactly where the margin is positive, that is where the constrained optimum holds the object, and never
    smaller for a larger margin. Linear above, so that a reader of the file gets the margin back as 4 c - 2. Zero below,
    as NVIDIA's GraspDataGen writes it for grasps that failed: programs that take a confidence above 0 for a success,
    and those that ask for 0.5, then agree on which grasps hold.

    Args:
        margin: ``(...)``, without unit.

    Returns:
        ``(...)`` in float64.

    Raises:
        ValueError: for a margin that is NaN, as those of invalid contacts are.
    """
    margins = np.asarray(margin, float)
    bad = np.argwhere(np.isnan(margins))
    if len(bad):
        index = f"[{', '.join(map(str, bad[0]))}]" if margins.ndim else ""
        raise ValueError(f"margin{index} is nan: expected a number, as of valid contacts")
    return np.where(margins > 0, HELD + np.clip(margins, 0, LARGEST_MARGIN) / 4, 0)


@checked
def judged_by_margin(poses: GraspPoses, margin: Float[np.ndarray, "N"]) -> GraspPoses:
    """Return the poses with ``confidence`` and ``succeeded`` from their margins.

    Args:
        poses: N grasps.
        margin: of each, by [`jaxgrasp.quality.hold_margin`][].

    Raises:
        ValueError: for another number of margins, and for one that is NaN.
    """
    if np.shape(margin) != (len(poses),):
        raise ValueError(f"margin has shape {np.shape(margin)}: expected ({len(poses)},), one for each grasp")
    confidence = hold_confidence(np.asarray(margin))
    return replace(poses, confidence=confidence, succeeded=confidence >= HELD)


@checked
def write_isaac_grasp(
    path: str | Path,
    poses: GraspPoses,
    joints: Sequence[str] | None = None,
    *,
    open_angles: Float[np.ndarray, "... J"] | None = None,
    object_frame: str = "object",
    gripper_frame: str = "gripper",
) -> None:
    """Write poses as an isaac_grasp file, which Isaac Sim's grasp editor reads.

    Args:
        path: a ``.yaml`` file; one that is there is replaced once the new one is complete.
        poses: their ``confidence`` is written, or 1 and 0 by ``succeeded``. Without both, no confidence.
        joints: names of the columns of ``poses.angles``; None leaves the joints out.
        open_angles: joints before the grasp ``(J,)`` or ``(N, J)`` [rad, m]. Those of the grasp where not given, as
            files have it that do not say which way the gripper closes.
        object_frame: name of the object's frame, for people.
        gripper_frame: name of the gripper's frame, for people.

    Warns:
        UserWarning: naming what the poses have and this format has no place for.

    Raises:
        ImportError: without PyYAML.
        ValueError: for the first entry that cannot be written, before anything is written.
        OSError: for a path that cannot be written.
    """
    yaml = optional_library("yaml", missing=MISSING)
    path = _path(path, ".yaml", ".yml")
    placed = _in_object_frame(poses)
    angles, before = _angles(poses, joints, open_angles)
    content: dict[str, Any] = {"format": "isaac_grasp", "format_version": 1.0, "created_with": "jaxgrasp"}
    content |= {"object_frame": object_frame, "gripper_frame": gripper_frame}
    scale = _scale(poses)
    content |= {} if poses.mesh is None else {"object_file": poses.mesh}
    content |= {} if scale is None else {"object_scale": scale}
    confidence = _confidence(poses)
    quaternions = Rotation.from_matrix(placed[:, :3, :3]).as_quat(scalar_first=True)
    content["grasps"] = {}
    for i, name in enumerate(poses.names):
        w, *xyz = quaternions[i].tolist()
        content["grasps"][name] = {
            **({} if confidence is None or np.isnan(confidence[i]) else {"confidence": float(confidence[i])}),
            "position": placed[i, :3, 3].tolist(),
            "orientation": {"w": w, "xyz": xyz},
            "cspace_position": dict(zip(joints or (), angles[i].tolist(), strict=True)),
            "pregrasp_cspace_position": dict(zip(joints or (), before[i].tolist(), strict=True)),
        }
    _warn_unwritten("isaac_grasp", poses, () if joints else ("angles",))
    # A name such as 1e-5 is text in YAML 1.1 and a number in 1.2: it is quoted for readers of both.
    Dumper: Any = type("Dumper", (getattr(yaml, "CSafeDumper", yaml.SafeDumper),), {})
    Dumper.add_implicit_resolver("tag:yaml.org,2002:float", YAML_FLOAT, list("-+0123456789."))
    text = yaml.dump(content, Dumper=Dumper, sort_keys=False, default_flow_style=None, width=10_000, allow_unicode=True)
    replace_file(path, lambda stream: stream.write(text.encode()))


@checked
def write_graspgen(path: str | Path, poses: GraspPoses) -> None:
    """Write poses as a file of GraspGen's data set.

    Args:
        path: a ``.json`` file; one that is there is replaced once the new one is complete.
        poses: with ``mesh``, the mesh's path in the data set, and ``succeeded``, which becomes ``object_in_gripper``.
            The scale is 1 where they have none.

    Warns:
        UserWarning: naming what the poses have and this format has no place for.

    Raises:
        ValueError: for the first entry that cannot be written, before anything is written.
        OSError: for a path that cannot be written.
    """
    path = _path(path, ".json")
    placed = _in_object_frame(poses)
    if poses.mesh is None:
        raise ValueError("poses.mesh is None: expected the mesh's path, which the format requires")
    if poses.succeeded is None:
        raise ValueError("poses.succeeded is None: expected which grasps hold, which the format requires")
    scale = _scale(poses)
    content = {
        "object": {"file": poses.mesh, "scale": 1.0 if scale is None else scale},
        "grasps": {"transforms": placed.tolist(), "object_in_gripper": _flags(poses).tolist()},
    }
    numbered = tuple(map(str, range(len(poses))))
    _warn_unwritten("GraspGen", poses, ("angles", "confidence", *(() if poses.names == numbered else ("names",))))
    replace_file(path, lambda stream: stream.write(json.dumps(content).encode()))


def _path(path: str | Path, *endings: str) -> Path:
    if Path(path).suffix.lower() not in endings:
        raise ValueError(f"path is {os.fspath(path)}: expected a name that ends in {' or '.join(endings)}")
    return Path(path)


def _in_object_frame(poses: GraspPoses) -> np.ndarray:
    """Check the poses, and return them in the object's frame ``(N, 4, 4)``."""
    count = len(poses.transforms)
    if count == 0:
        raise ValueError("poses is empty: expected at least one grasp")
    if len(poses.names) != count:
        raise ValueError(f"poses.names has {len(poses.names)} entries: expected {count}, one for each transform")
    first: dict[str, int] = {}
    for i, name in enumerate(poses.names):
        if first.setdefault(name, i) != i:
            raise ValueError(f"poses.names[{i}] is {shortened(name)}, as is [{first[name]}]: expected different names")
    placed = np.stack([transform(f"poses.transforms[{i}]", pose) for i, pose in enumerate(poses.transforms)])
    if poses.objects is None:
        return placed
    if len(poses.objects) != count:
        raise ValueError(f"poses.objects has {len(poses.objects)} entries: expected {count}, one for each transform")
    objects = np.stack([transform(f"poses.objects[{i}]", pose) for i, pose in enumerate(poses.objects)])
    return np.linalg.solve(objects, placed)


def _scale(poses: GraspPoses) -> float | None:
    """Return the one scale of all grasps [m]."""
    if poses.scales is None:
        return None
    scales = numbers("poses.scales", poses.scales, (len(poses),))
    differing = np.flatnonzero(scales != scales[0])
    if len(differing):
        raise ValueError(
            f"poses.scales[{differing[0]}] is {scales[differing[0]]:g}: expected {scales[0]:g} as of [0], since the "
            "format has one scale for all grasps: write a file for each"
        )
    return positive("poses.scales[0]", scales[0])


def _flags(poses: GraspPoses) -> np.ndarray:
    flags = np.asarray(poses.succeeded)
    if flags.shape != (len(poses),) or flags.dtype != bool:
        raise ValueError(f"poses.succeeded is {flags.dtype} {flags.shape}: expected ({len(poses)},) of true or false")
    return flags


def _confidence(poses: GraspPoses) -> np.ndarray | None:
    if poses.confidence is None:
        return None if poses.succeeded is None else _flags(poses).astype(float)
    confidence = np.asarray(poses.confidence, float)
    numbers("poses.confidence", np.nan_to_num(confidence), (len(poses),))
    bad = np.flatnonzero((confidence < 0) | (confidence > 1))
    if len(bad):
        raise ValueError(f"poses.confidence[{bad[0]}] is {confidence[bad[0]]:g}: expected a number from 0 to 1")
    return confidence


def _angles(
    poses: GraspPoses, joints: Sequence[str] | None, open_angles: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return joints at the grasp and before it ``(N, J)``, without columns where there are no names."""
    count = len(poses)
    if joints is None:
        if open_angles is not None:
            raise ValueError("open_angles were given without joints: expected the names of their columns")
        return np.zeros((count, 0)), np.zeros((count, 0))
    if poses.angles is None:
        raise ValueError(f"joints names {len(joints)} joints, but poses.angles is None: expected their positions")
    repeated = [name for i, name in enumerate(joints) if name in joints[:i]]
    if repeated:
        raise ValueError(f"joints has {shortened(repeated[0])} twice: expected different names")
    angles = numbers("poses.angles", poses.angles, (count, len(joints)))
    if open_angles is None:
        return angles, angles
    shape = (count, len(joints)) if np.ndim(open_angles) == 2 else (len(joints),)
    return angles, np.broadcast_to(numbers("open_angles", open_angles, shape), angles.shape)


def _warn_unwritten(kind: str, poses: GraspPoses, without_place: tuple[str, ...]) -> None:
    """Warn by name of the fields of the poses that are not in the file."""
    names = ("mass", "friction", "center_of_mass", *without_place)
    unwritten = [name for name in names if getattr(poses, name) is not None]
    if unwritten:
        warnings.warn(message_line(f"{kind}: not in the file: {', '.join(unwritten)}"), stacklevel=4)
