"""``jaxgrasp export``: grasps for other programs, judged by the hold margin."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import load_grasps
from jaxgrasp.cli.interop_arguments import ExportGraspGen, ExportIsaacGrasp, ExportLeRobot, ExportPoses
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.printable import shortened
from jaxgrasp.files.replace import check_writable
from jaxgrasp.force.reachable import reachable_wrench
from jaxgrasp.interop.acronym import read_acronym
from jaxgrasp.interop.file_records import GraspPoses
from jaxgrasp.interop.grasp_fields import read_npz_poses
from jaxgrasp.interop.grasp_writers import judged_by_margin, write_graspgen, write_isaac_grasp
from jaxgrasp.interop.graspgen import read_graspgen
from jaxgrasp.interop.isaac_grasp import joints_of_isaac_grasp, read_isaac_grasp
from jaxgrasp.interop.lerobot import ContactFrames, write_lerobot
from jaxgrasp.quality.hold_margin import hold_margin
from jaxgrasp.validation.checked import check_positive

READ = ".npz, .h5, .hdf5, .json, .yaml or .yml"


def export_isaac_grasp(arguments: ExportIsaacGrasp) -> int:
    """Read, judge by the contacts, write, and say what is not in the file."""
    _check(arguments, ".yaml", ".yml")
    joints = arguments.joints
    if not joints and arguments.poses.suffix.lower() in (".yaml", ".yml"):
        joints = joints_of_isaac_grasp(arguments.poses)
    poses = _with_labels(arguments, _poses(arguments.poses, joints))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    write_isaac_grasp(
        arguments.out,
        poses,
        joints or None,
        object_frame=arguments.object_frame,
        gripper_frame=arguments.gripper_frame,
    )
    if joints:
        show("joints of the open hand are not carried over: pregrasp_cspace_position is as cspace_position")
    return _say(arguments, poses)


def export_graspgen(arguments: ExportGraspGen) -> int:
    """Read, judge by the contacts, write, and say what is not in the file."""
    _check(arguments, ".json")
    poses = _with_labels(arguments, _poses(arguments.poses, ()))
    if arguments.mesh is not None:
        poses = replace(poses, mesh=arguments.mesh)
    if poses.mesh is None:
        raise ValueError(f"{arguments.poses} names no mesh, which the format requires: give its path by --mesh")
    if poses.succeeded is None:
        raise ValueError(f"{arguments.poses} does not say which grasps hold: give their contacts by --contacts")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    write_graspgen(arguments.out, poses)
    return _say(arguments, poses)


def export_lerobot(arguments: ExportLeRobot) -> int:
    """Compute forces and margins, write, and say what is not in the data set."""
    check_positive(arguments, "fps")
    if not arguments.contacts.is_file():
        raise ValueError(f"{arguments.contacts}: no such file")
    check_writable(arguments.out.parent)
    set_up_jax("float64")
    sets = load_grasps(arguments.contacts)
    grasp_of_frame = np.repeat(np.arange(len(sets)), sets.wrenches)
    grasp = sets.rows(grasp_of_frame).padded(max(1, sets.largest))
    wrench = sets.wrench.reshape(-1, 6)
    with compiling("the forces and the hold margin"):
        reachable = reachable_wrench(grasp, wrench)
        margin = np.asarray(hold_margin(grasp, wrench))
    frames = ContactFrames(
        grasp,
        wrench,
        np.asarray(reachable.forces),
        margin,
        grasp_of_frame if sets.wrenches > 1 else np.zeros(len(wrench), int),
        None if reachable.moments is None else np.asarray(reachable.moments),
        arguments.fps,
    )
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    write_lerobot(arguments.out, frames, task=arguments.task)
    missing = [*_limits(sets), *sets.labels]
    show(f"not in the data set: {', '.join(['actions, images and the state of a robot', *missing])}")
    if np.any(margin <= 0):
        show(f"{np.sum(margin <= 0)} frames do not hold: their forces exert what is nearest to the wrench")
    show(
        f"{arguments.out}: {frames.episodes[-1] + 1} episodes, {len(wrench)} frames, {np.sum(margin > 0)} of which hold"
    )
    return 0


def _check(arguments: ExportIsaacGrasp | ExportGraspGen, *endings: str) -> None:
    if arguments.out.suffix.lower() not in endings:
        raise ValueError(f"out is {arguments.out}: expected a file that ends in {' or '.join(endings)}")
    for path in (arguments.poses, arguments.contacts):
        if path is not None and not path.is_file():
            raise ValueError(f"{path}: no such file")
    if arguments.out.exists() and arguments.out.samefile(arguments.poses):
        raise ValueError(f"out is {arguments.out}, which is the file of poses: expected another file")
    check_writable(arguments.out.parent)


def _poses(path: Path, joints: tuple[str, ...]) -> GraspPoses:
    match path.suffix.lower():
        case ".npz":
            return read_npz_poses(path)
        case ".h5" | ".hdf5":
            return read_acronym(path)
        case ".json":
            return read_graspgen(path)
        case ".yaml" | ".yml":
            return read_isaac_grasp(path, joints or None)
    raise ValueError(f"{path} ends in {path.suffix!r}: expected {READ}")


def _with_labels(arguments: ExportPoses, poses: GraspPoses) -> GraspPoses:
    """Return the poses that have contacts, with labels by their margins; the poses as they are without contacts."""
    if arguments.contacts is None:
        return poses
    set_up_jax("float64")
    sets = load_grasps(arguments.contacts)
    rows = _rows(arguments.contacts, sets, poses)
    chosen = np.flatnonzero(rows >= 0)
    with compiling("the hold margin"):
        margin = _margins(sets.rows(rows[chosen]))
    _say_what_is_left_out(arguments, poses, rows, sets)
    return judged_by_margin(poses.rows(chosen), margin)


def _rows(path: Path, sets: ContactSets, poses: GraspPoses) -> np.ndarray:
    """Return the row of each pose in the file of contacts, by name, ``(N,)``; -1 where there is none."""
    if "name" not in sets.labels:
        raise ValueError(f"{path} has no names: expected contacts of these poses, by jaxgrasp import or contacts")
    row_of: dict[str, int] = {}
    for row, name in enumerate(sets.labels["name"].tolist()):
        if row_of.setdefault(name, row) != row:
            raise ValueError(f"{path}: grasps {row_of[name]} and {row} are both named {shortened(name)}")
    names = [f"{poses.path.stem} {name}" for name in poses.names]
    rows = np.array([row_of.get(name, -1) for name in names])
    if np.all(rows < 0):
        example = shortened(next(iter(row_of), ""))
        raise ValueError(f"{path} has no grasp named {shortened(names[0])}, but such as {example}: are they these?")
    return rows


def _margins(sets: ContactSets) -> np.ndarray:
    """Return the least hold margin over the wrenches of each grasp ``(N,)``."""
    grasp = sets.padded(max(1, sets.largest))
    return np.min([np.asarray(hold_margin(grasp, sets.wrench[:, w])) for w in range(sets.wrenches)], axis=0)


def _limits(sets: ContactSets) -> list[str]:
    """Return the names of the limits that contacts have, which the hold margin does not know."""
    return [name for name in ("normal_min", "normal_max", "torque_max") if getattr(sets, name) is not None]


def _say_what_is_left_out(arguments: ExportPoses, poses: GraspPoses, rows: np.ndarray, sets: ContactSets) -> None:
    missing = np.flatnonzero(rows < 0)
    if len(missing):
        first = ", ".join(shortened(poses.names[i]) for i in missing[:5])
        show(f"left out: {len(missing)} poses without contacts in {arguments.contacts} (the first: {first})")
    if limits := _limits(sets):
        show(f"not part of the margin: {', '.join(limits)}")
    soft = ", and the torsion of soft fingers" if sets.torsion is not None else ""
    show(f"not in the file: contacts, friction, squeeze and wrenches{soft}; they are in the margin alone")


def _say(arguments: ExportIsaacGrasp | ExportGraspGen, poses: GraspPoses) -> int:
    by = "their file" if arguments.contacts is None else "the hold margin"
    held = "" if poses.succeeded is None else f", {poses.succeeded.sum()} of them held according to {by}"
    show(f"{arguments.out}: {len(poses)} grasps{held}")
    return 0
