"""``jaxgrasp import`` of formats that say where hands and grippers stand."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import numpy as np

from jaxgrasp.cli.contacts_found import write_contacts
from jaxgrasp.cli.grippers import gripper
from jaxgrasp.cli.import_arguments import (
    ACRONYM,
    DexGraspBench,
    GraspGen,
    GraspIt,
    ImportGrippers,
    ImportHands,
    ImportPoses,
)
from jaxgrasp.cli.import_files import FRICTION, MASS, check_import, read_files
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.posed_contacts import PlacedGrasps, Touched, Touching, joined_grasps, joined_sets, touch, weights
from jaxgrasp.cli.terminal import show
from jaxgrasp.hand.filling import sphere_tree
from jaxgrasp.hand.mesh import Mesh, load_mesh, mass_properties
from jaxgrasp.interop.acronym import read_acronym
from jaxgrasp.interop.dexgraspbench import read_dexgraspbench
from jaxgrasp.interop.dexgraspnet import read_dexgraspnet
from jaxgrasp.interop.grasp_poses import GraspPoses
from jaxgrasp.interop.graspgen import read_graspgen
from jaxgrasp.interop.graspit import read_graspit
from jaxgrasp.interop.isaac_grasp import read_isaac_grasp
from jaxgrasp.interop.mjcf_file import load_mjcf
from jaxgrasp.interop.mujoco_hand import hand_from_mujoco
from jaxgrasp.model.hand import Hand
from jaxgrasp.validation.fields import check_not_negative, check_positive

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
    touching = Touching(arguments.stiffness, arguments.reach, arguments.max_contacts)
    return _import(arguments, reaching, poses, touching, arguments.hand.stem)


def import_grippers(arguments: ImportGrippers) -> int:
    """Read, close the jaws, write, and say what was found."""
    _check(arguments)
    check_positive(arguments, "depth", "opening")
    set_up_jax("float64")
    jaw, turned = gripper(arguments)
    poses = _with_meshes(arguments, lambda path: _of_gripper(arguments, turned, path))
    touching = Touching(arguments.stiffness, arguments.depth, arguments.max_contacts)
    return _import(arguments, jaw, poses, touching, arguments.gripper)


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


def _of_gripper(arguments: ImportGrippers, turned: np.ndarray, path: Path) -> GraspPoses:
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
    return replace(poses, transforms=poses.transforms @ turned, angles=None)


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


def _import(
    arguments: ImportPoses, hand: Hand, by_mesh: dict[Path, list[GraspPoses]], touching: Touching, hand_name: str
) -> int:
    meshes = {path: load_mesh(path) for path in by_mesh}
    with compiling("the hand and its contacts"):
        touched = [_touched(arguments, hand, meshes[path], several, touching) for path, several in by_mesh.items()]
    in_order = [(path, poses) for path, several in by_mesh.items() for poses in several]
    names = [f"{poses.path.stem} {name}" for _, poses in in_order for name in poses.names]
    objects = [_object_name(path) for path, poses in in_order for _ in poses.names]
    sets = joined_sets([part.sets for part in touched])
    labels = {"source": type(arguments).__name__, "hand": hand_name}
    left_out = {"that touch nothing": sets.sizes == 0}
    if isinstance(arguments, ImportGrippers):
        left_out = {"whose jaws start inside the object": np.concatenate([part.inside for part in touched]), **left_out}
    return write_contacts(
        arguments.out,
        sets,
        {"name": np.array(names), "object": np.array(objects)}
        | {name: np.full(len(names), text) for name, text in labels.items()},
        left_out,
        sum(part.dropped for part in touched),
        "; is the scale right?",
    )


def _object_name(path: Path) -> str:
    """Return the object's name: the stem of the mesh's file, or of OBJECT/mesh/FILE the name OBJECT."""
    return path.parent.parent.name if path.parent.name == "mesh" else path.stem


def _touched(arguments: ImportPoses, hand: Hand, mesh: Mesh, several: list[GraspPoses], touching: Touching) -> Touched:
    """Find the contacts of all grasps of one mesh."""
    middle = mass_properties(mesh).center
    parts = [_placed(arguments, poses, middle) for poses in several]
    return touch(hand, sphere_tree(mesh, arguments.levels), joined_grasps(parts), touching)


def _placed(arguments: ImportPoses, poses: GraspPoses, middle: np.ndarray) -> PlacedGrasps:
    count = len(poses)
    file_scales = np.ones(count) if poses.scales is None else poses.scales
    scales = file_scales if arguments.scale is None else np.full(count, arguments.scale)
    file_center = poses.center_of_mass
    centers = scales[:, None] * middle if file_center is None else np.tile(file_center, (count, 1))
    mass, friction = (
        next(value for value in values if value is not None)
        for values in ((arguments.mass, poses.mass, MASS), (arguments.friction, poses.friction, FRICTION))
    )
    return PlacedGrasps(
        poses.transforms,
        poses.angles,
        poses.objects,
        scales,
        np.full(count, friction),
        weights(mass, centers, arguments.gravity, poses.objects),
    )
