"""Isaac Sim's grasp files: where a gripper stands in an object's frame, by the names of its joints.

A file in YAML has ``format: isaac_grasp``, ``grasps`` by name, and of each grasp ``position`` [m] and ``orientation``
``{w, xyz}``, a unit quaternion, of the gripper's frame in the object's. Which frames these are is up to whoever wrote
the file (``object_frame`` and ``gripper_frame``, or ``..._link``, name them for people). ``cspace_position`` has joints
[rad, m] by their names, closed on the object, ``pregrasp_cspace_position`` open. Files of planners may lack both.
Normals and forces there are none.

Of grippers with two jaws the joints are not used: the jaws close by themselves. Of the Robotiq grippers in the example
files of Isaac Sim, which the file's side grasps of a can show, the 2F-85 looks along its z axis and closes along x.

Source: Isaac Sim's documentation of the Grasp Editor, and Isaac ROS's of the Isaac Grasp File (format version 1.0).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.files.printable import shortened
from jaxgrasp.interop.file_records import by_name, field, frame, numbers, read_each, read_text, rotation
from jaxgrasp.interop.grasp_poses import GraspPoses
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import optional_library

MISSING = "isaac_grasp files need PyYAML: pip install 'jaxgrasp[mesh]'"

DEEPEST = 20
"""Levels of a file; this format has five."""


class _Grasp(NamedTuple):
    transform: np.ndarray
    angles: np.ndarray | None


@checked
def read_isaac_grasp(path: str | Path, joints: Sequence[str] | None = None, *, keep_going: bool = False) -> GraspPoses:
    """The grasps of a file.

    Args:
        path: a ``.yaml`` file.
        joints: names of a hand's joints, in its order, which ``cspace_position`` then must have; None of jaws.
        keep_going: leave bad grasps out and say what is wrong with them, instead of stopping at the first.

    Returns:
        Poses in the object's frame.

    Raises:
        ImportError: without PyYAML.
        ValueError: for a file that is none of this format, and for its first bad grasp.
        OSError: for a file that cannot be read.
    """
    whole = _yaml(path)
    if not isinstance(whole, dict) or whole.get("format") != "isaac_grasp":
        said = whole.get("format") if isinstance(whole, dict) else whole
        raise ValueError(f"{path} has the format {shortened(said)}: expected 'isaac_grasp'")
    grasps = whole.get("grasps")
    if not isinstance(grasps, dict) or not grasps:
        raise ValueError(f"{path} has no grasps: expected them by their names")
    each = ((str(name), record) for name, record in grasps.items())
    found, left_out = read_each(path, each, lambda record: _grasp(record, joints), keep_going, "grasp")
    return GraspPoses(
        Path(path),
        tuple(name for name, _ in found),
        np.stack([one.transform for _, one in found]),
        None if joints is None else np.stack([one.angles for _, one in found if one.angles is not None]),
        left_out=left_out,
    )


def _yaml(path: str | Path) -> Any:
    yaml = optional_library("yaml", missing=MISSING)
    text = read_text(path)
    try:
        depth = 0
        for event in yaml.parse(text, yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise ValueError("it is nested too deeply")
            # What refers to itself, or to the same a billion times, is small as a text alone.
            if isinstance(event, yaml.AliasEvent):
                raise ValueError("it refers to parts of itself")
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(f"{path} is no YAML of ours: {' '.join(str(error).split())}") from None


def _grasp(record: Any, joints: Sequence[str] | None) -> _Grasp:
    orientation = field(record, "orientation")
    imaginary = numbers("orientation.xyz", field(orientation, "xyz"), (3,))
    real = numbers("orientation.w", field(orientation, "w"), ())
    place = frame(numbers("position", field(record, "position"), (3,)), rotation("orientation", [real, *imaginary]))
    if joints is None:
        return _Grasp(place, None)
    given = field(record, "cspace_position")
    if not isinstance(given, dict):
        raise ValueError(f"cspace_position is {shortened(given)}: expected joints by their names")
    return _Grasp(place, by_name(given, joints, "cspace_position"))
