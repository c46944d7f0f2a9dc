"""``jaxgrasp import``: a data set's grasps as a file for ``jaxgrasp evaluate``."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import save_grasps
from jaxgrasp.cli.contacts import CHUNK, found_words, joined_sets, left_out_words
from jaxgrasp.cli.import_arguments import ImportGrasps
from jaxgrasp.cli.machine import say_compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.hand.deepest import keep_deepest
from jaxgrasp.hand.detection import find_contacts
from jaxgrasp.hand.filling import sphere_tree
from jaxgrasp.hand.mesh import load_mesh, mass_properties
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.to_grasp import grasp_from_contacts
from jaxgrasp.interop.dexgraspnet import HandPoses, read_dexgraspnet
from jaxgrasp.interop.mjcf_file import load_mjcf
from jaxgrasp.interop.mujoco_hand import hand_from_mujoco
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.model.wrench import weight_wrench
from jaxgrasp.validation.fields import check_not_negative, check_positive


def import_command(arguments: ImportGrasps) -> int:
    """Read, find what touches, write, and say what was found."""
    _check(arguments)
    hand = _hand(arguments)
    poses = [(path, read_dexgraspnet(path, hand.joints, keep_going=arguments.keep_going)) for path in arguments.files]
    mesh = load_mesh(arguments.object)
    set_up_jax("float64")
    say_compiling("the hand and its contacts")
    tree, middle = sphere_tree(mesh, arguments.levels), mass_properties(mesh).center
    hand = eqx.tree_at(lambda hand: hand.skin.radii, hand, hand.skin.radii + arguments.reach)
    parts, names, dropped = [], [], 0
    for path, own in poses:
        for scale in np.unique(own.scales):
            chosen = np.flatnonzero(own.scales == scale)
            weight = weight_wrench(arguments.mass, jnp.asarray(scale * middle), jnp.asarray(arguments.gravity))
            found, more = _touching(arguments, hand, tree.scaled(float(scale)), own, chosen, np.asarray(weight))
            parts += found
            dropped += more
            names += [f"{path.stem} {number}" for number in own.numbers[chosen]]
    for line in (wrong for _, own in poses for wrong in own.left_out):
        show(f"left out: {line}")
    return _write(arguments, parts, np.array(names), dropped)


def _write(arguments: ImportGrasps, parts: list[ContactSets], names: np.ndarray, dropped: int) -> int:
    given = {"source": "DexGraspNet", "object": arguments.object.stem, "hand": arguments.hand.stem}
    found = joined_sets(parts, names, **{name: np.full(len(names), text) for name, text in given.items()})
    out = {"that touch nothing": found.sizes == 0}
    sets = found.rows(np.flatnonzero(found.sizes))
    if not len(sets):
        raise ValueError(f"none of the {len(names)} grasps can be used: {'; '.join(left_out_words(out))}")
    save_grasps(arguments.out, sets)
    show(found_words(sets, out, dropped))
    show(f"written: {arguments.out}")
    return 0


def _check(arguments: ImportGrasps) -> None:
    check_positive(arguments, "mass", "stiffness", "levels", "max_contacts")
    check_not_negative(arguments, "friction", "reach")
    if not np.all(np.isfinite(arguments.gravity)):
        raise ValueError(f"gravity is {arguments.gravity}: expected finite numbers [m/s^2]")
    if not arguments.files:
        raise ValueError("files are none: expected one at least")
    if arguments.out.suffix not in (".npz", ".csv"):
        raise ValueError(f"out is {arguments.out}: expected a file that ends in .npz or .csv")
    for path in (*arguments.files, arguments.hand, arguments.object):
        if not Path(path).is_file():
            raise ValueError(f"{path} is no file")


def _hand(arguments: ImportGrasps) -> Hand:
    model = load_mjcf(arguments.hand)
    if model.nbody < 2:
        raise ValueError(f"{arguments.hand} has no bodies: expected a hand")
    return hand_from_mujoco(model, model.body(1).name if arguments.root is None else arguments.root).hand


def _touching(
    arguments: ImportGrasps, hand: Hand, tree: SphereTree, poses: HandPoses, chosen: np.ndarray, weight: np.ndarray
) -> tuple[list[ContactSets], int]:
    """Contacts of the chosen grasps, and how many were dropped beyond the deepest."""
    parts, dropped = [], 0
    for first in range(0, len(chosen), CHUNK):
        # All of one size: another would be compiled anew.
        own = chosen[np.minimum(np.arange(first, first + CHUNK), len(chosen) - 1)]
        wrist = Pose(jnp.asarray(poses.positions[own]), jnp.asarray(poses.rotations[own]))
        found = find_contacts(hand, Posture(wrist, jnp.asarray(poses.angles[own])), tree, Pose(np.zeros(3), np.eye(3)))
        found = jax.tree.map(lambda x, first=first: x[: len(chosen) - first], found)
        if arguments.max_contacts is not None:
            kept = keep_deepest(found, arguments.max_contacts)
            dropped += int(kept.dropped.sum())
            found = kept.contacts
        grasp = grasp_from_contacts(found, arguments.friction, arguments.stiffness)
        parts.append(ContactSets.from_grasp(jax.device_get(grasp), weight))
    return parts, dropped
