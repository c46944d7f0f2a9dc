"""Isaac Sim's grasp files: where a gripper stands in an object's frame, by the names of its joints.

A file in YAML has ``format: isaac_grasp``, ``grasps`` by name, and of each grasp ``position`` [m] and ``orientation``
``{w, xyz}``, a unit quaternion, of the gripper's frame in the object's. Which frames these are is up to whoever wrote
the file (``object_frame`` and ``gripper_frame``, or ``..._link``, name them for people). ``cspace_position`` has joints
[rad, m] by their names, closed on the object, ``pregrasp_cspace_position`` open. Files of planners may lack both. There
are no normals and no forces. ``object_file`` names the mesh and ``object_scale`` its unit [m], as in the files of
GraspDataGen, whose ``confidence`` is 0 for grasps that failed in simulation, and whose ``approach_axis`` says along
which axis of its frame the gripper looks, 2 for z, as grippers do here. Fields of other names are not used, and a
warning names them, but for when and with what the file was made, and where the gripper stood before the grasp.

Of grippers with two jaws the joints are not used: the jaws close by themselves. Of the Robotiq grippers in the example
files of Isaac Sim, which the file's side grasps of a can show, the 2F-85 looks along its z axis and closes along x.

Source: Isaac Sim's documentation of the Grasp Editor, and Isaac ROS's of the Isaac Grasp File (format version 1.0);
GraspDataGen's writer of such files.
"""

import re
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.files.printable import message_line, shortened
from jaxgrasp.interop.file_records import (
    GraspPoses,
    by_name,
    field,
    frame,
    number,
    numbers,
    positive,
    read_each,
    read_text,
    rotation,
)
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import optional_library

MISSING = "isaac_grasp files need PyYAML: pip install 'jaxgrasp[mesh]'"

DEEPEST = 20
"""Levels of a file; this format has five."""
FILE_FIELDS = {
    *("format", "format_version", "object_frame", "object_frame_link", "gripper_frame", "gripper_frame_link"),
    *("object_file", "object_scale", "grasps", "approach_axis", "created_with", "created_at"),
}
GRASP_FIELDS = {
    *("confidence", "position", "orientation", "cspace_position"),
    *("pregrasp_cspace_position", "pregrasp_position", "pregrasp_orientation", "pregrasp_bite_point"),
}
"""Fields that are read, or that only name a frame for people or say how the file was made; those of ``pregrasp`` are of
the open hand before the grasp."""
LOOKS_ALONG = 2
"""Axis of its frame along which a gripper is taken to look: z."""
YAML_FLOAT = re.compile(r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$")
"""Numbers with an exponent (YAML 1.2.2, 10.3.2). PyYAML follows YAML 1.1, where 1e-05, without a point, is text."""


class _Grasp(NamedTuple):
    transform: np.ndarray
    angles: np.ndarray | None
    confidence: float | None


@checked
def read_isaac_grasp(path: str | Path, joints: Sequence[str] | None = None, *, keep_going: bool = False) -> GraspPoses:
    """Read the grasps of a file.

    Args:
        path: a ``.yaml`` file.
        joints: names of a hand's joints, in its order, which ``cspace_position`` then must have; None of jaws.
        keep_going: leave bad grasps out and say what is wrong with them, instead of stopping at the first.

    Returns:
        Poses in the object's frame, with the mesh, its unit, and which grasps succeeded, where the file says so. A
        grasp without ``confidence`` among others that have one counts as successful.

    Warns:
        UserWarning: naming the fields that are not used.

    Raises:
        ImportError: without PyYAML.
        ValueError: for a file that is none of this format, and for its first bad grasp.
        OSError: for a file that cannot be read.
    """
    content = _yaml(path)
    if not isinstance(content, dict) or content.get("format") != "isaac_grasp":
        format_ = content.get("format") if isinstance(content, dict) else content
        raise ValueError(f"{path} has the format {shortened(format_)}: expected 'isaac_grasp'")
    grasps = content.get("grasps")
    if not isinstance(grasps, dict) or not grasps:
        raise ValueError(f"{path} has no grasps: expected them by their names")
    mesh, scale = _mesh(path, content)
    named_records = ((str(name), record) for name, record in grasps.items())
    grasps_read, left_out = read_each(path, named_records, lambda record: _grasp(record, joints), keep_going, "grasp")
    _warn_unused(path, content, grasps.values())
    confidences = [grasp.confidence for _, grasp in grasps_read]
    succeeded = np.array([confidence is None or confidence > 0 for confidence in confidences])
    has_confidence = any(confidence is not None for confidence in confidences)
    return GraspPoses(
        Path(path),
        tuple(name for name, _ in grasps_read),
        np.stack([grasp.transform for _, grasp in grasps_read]),
        None if joints is None else np.stack([grasp.angles for _, grasp in grasps_read if grasp.angles is not None]),
        scales=None if scale is None else np.full(len(grasps_read), scale),
        mesh=mesh,
        succeeded=succeeded if has_confidence else None,
        confidence=np.array([np.nan if c is None else c for c in confidences]) if has_confidence else None,
        left_out=left_out,
    )


def joints_of_isaac_grasp(path: str | Path) -> tuple[str, ...]:
    """Return the names of the joints that the first grasp of a file has; empty where it has none."""
    content = _yaml(path)
    grasps = content.get("grasps") if isinstance(content, dict) else None
    first = next(iter(grasps.values()), None) if isinstance(grasps, dict) else None
    positions = first.get("cspace_position") if isinstance(first, dict) else None
    return tuple(map(str, positions)) if isinstance(positions, dict) else ()


def _mesh(path: str | Path, content: dict) -> tuple[str | None, float | None]:
    """Return the mesh's path and its unit [m], None where the file has none."""
    mesh, scale = content.get("object_file"), content.get("object_scale")
    try:
        if mesh is not None and not isinstance(mesh, str):
            raise ValueError(f"object_file is {shortened(mesh)}: expected the path of a mesh")
        if isinstance(scale, list):
            sides = numbers("object_scale", scale, (3,))
            if np.ptp(sides) > 0:
                raise ValueError(f"object_scale is {shortened(scale)}: expected one scale for all three axes")
            scale = sides[0]
        return mesh, None if scale is None else positive("object_scale", scale)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _warn_unused(path: str | Path, content: dict, records: Iterable[Any]) -> None:
    """Warn of the fields of a file, and of its grasps, that nothing here reads."""
    unused = {str(name) for name in content} - FILE_FIELDS
    for record in records:
        unused |= {str(name) for name in record} - GRASP_FIELDS if isinstance(record, dict) else set()
    axis = content.get("approach_axis", LOOKS_ALONG)
    if axis != LOOKS_ALONG:
        warnings.warn(
            message_line(
                f"{path}: approach_axis is {shortened(axis)}, and is not used: grippers are taken to look along z, "
                f"which is axis {LOOKS_ALONG}"
            ),
            stacklevel=4,
        )
    if unused:
        warnings.warn(message_line(f"{path}: fields that are not used: {', '.join(sorted(unused))}"), stacklevel=4)


def _yaml(path: str | Path) -> Any:
    yaml = optional_library("yaml", missing=MISSING)
    text = read_text(path)

    Loader: Any = type("Loader", (yaml.SafeLoader,), {})
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", YAML_FLOAT, list("-+0123456789."))
    try:
        depth = 0
        for event in yaml.parse(text, yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise ValueError("it is nested too deeply")
            # A value that refers to itself, or to the same value a billion times, is small as a text alone.
            if isinstance(event, yaml.AliasEvent):
                raise ValueError("it refers to parts of itself")
        return yaml.load(text, Loader)
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f"{path} is not readable YAML: {' '.join(str(error).split())}") from None


def _grasp(record: Any, joints: Sequence[str] | None) -> _Grasp:
    orientation = field(record, "orientation")
    imaginary = numbers("orientation.xyz", field(orientation, "xyz"), (3,))
    real = numbers("orientation.w", field(orientation, "w"), ())
    transform = frame(numbers("position", field(record, "position"), (3,)), rotation("orientation", [real, *imaginary]))
    confidence = None if record.get("confidence") is None else number("confidence", record["confidence"])
    if joints is None:
        return _Grasp(transform, None, confidence)
    joint_values = field(record, "cspace_position")
    if not isinstance(joint_values, dict):
        raise ValueError(f"cspace_position is {shortened(joint_values)}: expected joints by their names")
    return _Grasp(transform, by_name(joint_values, joints, "cspace_position"), confidence)
