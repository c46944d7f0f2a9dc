"""``jaxgrasp import``: grasps of other projects' files, with contacts or with poses of a hand or gripper."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.cli.contacts import points_in_world, weight_wrenches, write_contacts
from jaxgrasp.cli.interop_arguments import (
    ACRONYM,
    BODex,
    DexGraspBench,
    GraspGen,
    GraspIt,
    ImportContacts,
    ImportGrasps,
    ImportGrippers,
    ImportHands,
    ImportPoses,
)
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.printable import message_line
from jaxgrasp.files.replace import check_writable
from jaxgrasp.hand.filling import sphere_tree
from jaxgrasp.hand.mesh import Mesh, load_mesh, mass_properties
from jaxgrasp.interop.acronym import read_acronym
from jaxgrasp.interop.bodex import read_bodex
from jaxgrasp.interop.dexgraspbench import read_dexgraspbench
from jaxgrasp.interop.dexgraspnet import read_dexgraspnet
from jaxgrasp.interop.dexonomy import read_dexonomy
from jaxgrasp.interop.file_records import ContactRecords, GraspPoses
from jaxgrasp.interop.graspgen import read_graspgen
from jaxgrasp.interop.graspit import read_graspit
from jaxgrasp.interop.isaac_grasp import read_isaac_grasp
from jaxgrasp.interop.mjcf_file import load_mjcf
from jaxgrasp.interop.mujoco_hand import hand_from_mujoco
from jaxgrasp.interop.posed_contacts import (
    DEFAULT_FRICTION,
    PosedContacts,
    contacts_of_poses,
    gripper_by_name,
    join_poses,
)
from jaxgrasp.model.hand import Hand
from jaxgrasp.validation.checked import check_not_negative, check_positive

MASS = 0.1
"""Mass where neither the user nor the file gives one [kg]."""


Read = TypeVar("Read", GraspPoses, ContactRecords)


def check_import(arguments: ImportGrasps, *needed: Path) -> None:
    """Raise ValueError for arguments that every format refuses, and for files that are not there; OSError for an
    output that could not be written."""
    check_not_negative(arguments, "friction", "mass")
    if not np.all(np.isfinite(arguments.gravity)):
        raise ValueError(f"gravity is {arguments.gravity}: expected finite numbers [m/s^2]")
    if not arguments.files:
        raise ValueError("no input files: pass at least one")
    if arguments.out.suffix not in (".npz", ".csv"):
        raise ValueError(f"out is {arguments.out}: expected a file that ends in .npz or .csv")
    for path in (*arguments.files, *needed):
        if not path.is_file():
            try:
                os.stat(path)
            except FileNotFoundError:
                raise ValueError(f"{path}: no such file") from None
            raise ValueError(f"{path} is not a file")
    check_writable(arguments.out.parent)


def read_files(arguments: ImportGrasps, read: Callable[[Path], Read]) -> list[Read]:
    """Read all files; with ``keep_going``, list bad files and records on screen and leave them out."""
    results: list[Read] = []
    problems: list[str] = []
    for path in arguments.files:
        try:
            results.append(read(path))
            problems += results[-1].left_out
        except (ValueError, OSError) as error:
            if not arguments.keep_going:
                raise
            problems.append(str(error))
    if not results:
        raise ValueError(f"{problems[0]}; none of the {len(arguments.files)} files can be read")
    for line in problems:
        show(message_line(f"left out: {line}"))
    if problems:
        show(f"left out: {len(problems)} bad records or files in all")
    return results


def import_contacts(arguments: ImportContacts) -> int:
    """Read, write, and say what was found."""
    check_positive(arguments, "force")
    check_not_negative(arguments, "squeeze", "torsion")
    if arguments.center is not None and not np.all(np.isfinite(arguments.center)):
        raise ValueError(f"center is {arguments.center}: expected finite numbers [m]")
    object_ = arguments.object if isinstance(arguments, BODex) else None
    check_import(arguments, *([object_] if object_ is not None and not object_.is_dir() else []))
    set_up_jax("float64")
    parts = []

    def read(path: Path) -> ContactRecords:
        records = (
            read_bodex(path, keep_going=arguments.keep_going) if isinstance(arguments, BODex) else read_dexonomy(path)
        )
        parts.append(_sets(arguments, records, object_))
        return records

    files_read = read_files(arguments, read)
    names = [f"{records.path.stem} {name}" for records in files_read for name in records.names]
    sets = _joined_sets(parts)
    labels = {"name": np.array(names), "source": np.full(len(names), type(arguments).__name__)}
    return write_contacts(arguments.out, sets, labels, {"without contacts": sets.sizes == 0})


def _sets(arguments: ImportContacts, records: ContactRecords, object_: Path | None) -> ContactSets:
    """Return contacts with the wrench to be exerted: against the weight, and against the loads of the file."""
    friction = DEFAULT_FRICTION if arguments.friction is None else arguments.friction
    mass = MASS if arguments.mass is None else arguments.mass
    pressures = np.where(np.isnan(records.pressures), arguments.squeeze, arguments.force * records.pressures)
    weight = weight_wrenches(mass, _centers(arguments, records, object_), arguments.gravity)
    return ContactSets(
        records.points,
        records.normals,
        np.full(len(records.points), friction),
        pressures,
        records.offsets,
        (weight - arguments.force * records.loads)[:, None],
        torsion=None if arguments.torsion is None else np.full(len(records.points), arguments.torsion),
    )


def _centers(arguments: ImportContacts, records: ContactRecords, object_: Path | None) -> np.ndarray:
    """Return centres of mass ``(N, 3)`` in the file's world [m]: the user's, the file's, or the mesh's."""
    if arguments.center is not None:
        return np.tile(arguments.center, (len(records), 1))
    if np.isfinite(records.centers).all():
        return records.centers
    mesh = records.mesh_path(object_) if object_ is None or object_.is_dir() else object_
    if mesh is None or records.objects is None or records.scales is None:
        options = "--center or its mesh by --object" if isinstance(arguments, BODex) else "--center"
        raise ValueError(f"{records.path} does not say the object's centre of mass: give it by {options}")
    middle = records.scales * mass_properties(load_mesh(mesh)).center
    return points_in_world(records.objects, middle)


WORLD = "world"
"""MuJoCo's name of what a file's first bodies hang on."""


def import_hands(arguments: ImportHands) -> int:
    """Read, find what touches, write, and say what was found."""
    _check(arguments, arguments.hand)
    check_not_negative(arguments, "reach")
    set_up_jax("float64")
    hand = _hand(arguments)
    poses = _with_meshes(arguments, lambda path: _of_hand(arguments, hand, path))
    reaching = eqx.tree_at(lambda hand: hand.skin.radii, hand, hand.skin.radii + arguments.reach)
    return _import(arguments, reaching, poses, arguments.hand.stem)


def import_grippers(arguments: ImportGrippers) -> int:
    """Read, close the jaws, write, and say what was found."""
    _check(arguments)
    check_positive(arguments, "depth", "opening")
    set_up_jax("float64")
    gripper = gripper_by_name(
        arguments.gripper, opening=arguments.opening, pads=arguments.pads, closes_along=arguments.closes_along
    )
    poses = _with_meshes(arguments, lambda path: _of_gripper(arguments, gripper.frame, path))
    return _import(arguments, gripper.hand, poses, arguments.gripper)


def _check(arguments: ImportPoses, *needed: Path) -> None:
    check_positive(arguments, "stiffness", "levels", "max_contacts", "scale")
    object_ = arguments.object
    check_import(arguments, *needed, *([object_] if object_ is not None and not object_.is_dir() else []))


def _hand(arguments: ImportHands) -> Hand:
    model = load_mjcf(arguments.hand, capsules=True)
    if model.nbody < 2:
        raise ValueError(f"{arguments.hand} has no bodies: expected a hand")
    default_root = WORLD if isinstance(arguments, DexGraspBench) else model.body(1).name
    mujoco_hand = hand_from_mujoco(model, default_root if arguments.root is None else arguments.root)
    bare = [
        model.body(i).name for i in range(1, model.nbody) if i not in mujoco_hand.bodies and model.body_jntnum[i] > 0
    ]
    if bare:
        links = len(mujoco_hand.hand.links)
        show(f"{arguments.hand.name}: {links} links can touch; these bodies have no shape that can: {', '.join(bare)}")
    return mujoco_hand.hand


def _of_hand(arguments: ImportHands, hand: Hand, path: Path) -> GraspPoses:
    if isinstance(arguments, DexGraspBench):
        return read_dexgraspbench(path, hand, posture=arguments.posture, keep_going=arguments.keep_going)
    if isinstance(arguments, GraspIt):
        return read_graspit(path, hand, arguments.order, robot=arguments.robot)
    return read_dexgraspnet(path, hand.joints, keep_going=arguments.keep_going)


def _of_gripper(arguments: ImportGrippers, frame: np.ndarray, path: Path) -> GraspPoses:
    if isinstance(arguments, ACRONYM):
        poses = read_acronym(path, keep_going=arguments.keep_going)
    elif isinstance(arguments, GraspGen):
        poses = read_graspgen(path, keep_going=arguments.keep_going)
    else:
        poses = read_isaac_grasp(path, keep_going=arguments.keep_going)
    if arguments.successful:
        if poses.succeeded is None:
            raise ValueError(f"{path} does not say which grasps held: leave out --successful")
        if not poses.succeeded.any():
            raise ValueError(f"{path} has no grasp that held")
        poses = poses.rows(np.flatnonzero(poses.succeeded))
    return replace(poses, transforms=poses.transforms @ frame, angles=None)


def _with_meshes(arguments: ImportPoses, read: Callable[[Path], GraspPoses]) -> dict[Path, list[GraspPoses]]:
    """Read the poses of all files, grouped by the path of the object's mesh; a missing mesh is an error at once."""
    meshes = {}

    def read_both(path: Path) -> GraspPoses:
        poses = read(path)
        meshes[path] = _mesh(arguments, poses)
        return poses

    by_mesh: dict[Path, list[GraspPoses]] = {}
    for poses in read_files(arguments, read_both):
        by_mesh.setdefault(meshes[poses.path], []).append(poses)
    return by_mesh


def _mesh(arguments: ImportPoses, poses: GraspPoses) -> Path:
    option = arguments.object
    if option is not None and not option.is_dir():
        return option
    path = poses.mesh_path(option)
    if path is None:
        folder = f"under {option}" if option is not None else "beside it"
        named = f"names the mesh {poses.mesh!r}, which is not {folder}" if poses.mesh else "names no mesh"
        raise ValueError(f"{poses.path} {named}: give it by --object")
    return path


def _import(arguments: ImportPoses, hand: Hand, by_mesh: dict[Path, list[GraspPoses]], hand_name: str) -> int:
    meshes = {path: load_mesh(path) for path in by_mesh}
    with compiling("the hand and its contacts"):
        touched = [_touched(arguments, hand, meshes[path], several) for path, several in by_mesh.items()]
    in_order = [(path, poses) for path, several in by_mesh.items() for poses in several]
    names = [f"{poses.path.stem} {name}" for _, poses in in_order for name in poses.names]
    objects = [_object_name(path) for path, poses in in_order for _ in poses.names]
    sets = _joined_sets([each for each, _ in touched])
    labels = {"source": type(arguments).__name__, "hand": hand_name}
    left_out = {"that touch nothing": sets.sizes == 0}
    if isinstance(arguments, ImportGrippers):
        is_inside = np.concatenate([posed.is_inside for _, posed in touched])
        left_out = {"whose jaws start inside the object": is_inside, **left_out}
    return write_contacts(
        arguments.out,
        sets,
        {"name": np.array(names), "object": np.array(objects)}
        | {name: np.full(len(names), text) for name, text in labels.items()},
        left_out,
        sum(posed.dropped for _, posed in touched),
        "; is the scale right?",
    )


def _object_name(path: Path) -> str:
    """Return the object's name: the stem of the mesh's file, or of OBJECT/mesh/FILE the name OBJECT."""
    return path.parent.parent.name if path.parent.name == "mesh" else path.stem


def _touched(
    arguments: ImportPoses, hand: Hand, mesh: Mesh, several: list[GraspPoses]
) -> tuple[ContactSets, PosedContacts]:
    """Find the contacts of all grasps of one mesh, with the wrenches that hold its weight."""
    mesh_center = mass_properties(mesh).center
    scaled, friction, wrenches = [], [], []
    for poses in several:
        count = len(poses)
        file_scales = np.ones(count) if poses.scales is None else poses.scales
        scales = file_scales if arguments.scale is None else np.full(count, arguments.scale)
        file_center = poses.center_of_mass
        centers = scales[:, None] * mesh_center if file_center is None else np.tile(file_center, (count, 1))
        mass = next(value for value in (arguments.mass, poses.mass, MASS) if value is not None)
        coefficient = next(
            value for value in (arguments.friction, poses.friction, DEFAULT_FRICTION) if value is not None
        )
        scaled.append(replace(poses, scales=scales))
        friction.append(np.full(count, coefficient))
        wrenches.append(weight_wrenches(mass, centers, arguments.gravity, poses.objects))
    posed = contacts_of_poses(
        join_poses(scaled),
        hand,
        sphere_tree(mesh, arguments.levels),
        friction=np.concatenate(friction),
        stiffness=arguments.stiffness,
        max_contacts=arguments.max_contacts,
        **({"depth": arguments.depth} if isinstance(arguments, ImportGrippers) else {}),
    )
    return ContactSets.from_grasp(posed.grasp, np.concatenate(wrenches)), posed


def _joined_sets(parts: Sequence[ContactSets]) -> ContactSets:
    """Concatenate sets of contacts, without labels."""
    columns: dict[str, Any] = {
        name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns
    }
    columns["wrench"] = np.concatenate([part.wrench for part in parts])
    sizes = np.concatenate([part.sizes for part in parts])
    return ContactSets(**columns, offsets=np.concatenate([[0], np.cumsum(sizes)]))
