"""``jaxgrasp contacts``: where hands or grippers touch a mesh, as a file for ``jaxgrasp evaluate``."""

from collections import Counter
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.grasp_poses import GraspPoses, read_poses
from jaxgrasp.batch.sources import save_grasps
from jaxgrasp.cli.contacts_arguments import FindContacts
from jaxgrasp.cli.machine import say_compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.hand.closing import close_hand
from jaxgrasp.hand.deepest import keep_deepest
from jaxgrasp.hand.detection import Contacts as Found
from jaxgrasp.hand.detection import find_contacts
from jaxgrasp.hand.filling import cell_size, filling_error, sphere_tree
from jaxgrasp.hand.human_hand import human_hand
from jaxgrasp.hand.mesh import load_mesh, mass_properties
from jaxgrasp.hand.parallel_jaw import parallel_jaw
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.to_grasp import grasp_from_contacts
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.model.wrench import weight_wrench
from jaxgrasp.validation.fields import check_not_negative, check_positive

CHUNK = 512
"""Grasps at a time."""
STRIDES = 24
"""Steps of a closing hand's first way; as many again, within the last of them, find the depth."""


@dataclass(frozen=True)
class _Object:
    """What is touched, and the wrench that holds it."""

    tree: SphereTree
    friction: float
    wrench: np.ndarray


def contacts_command(arguments: FindContacts) -> int:
    """Find the contacts, write them, and say what was found."""
    _check(arguments)
    poses = read_poses(arguments.file)
    set_up_jax("float64")
    hand = _hand(arguments)
    if poses.angles is not None and poses.angles.shape[1] != len(hand.joints):
        raise ValueError(
            f"{poses.path}: angles has {poses.angles.shape[1]} columns: expected {len(hand.joints)}, "
            f"the joints of the {arguments.hand} hand"
        )
    object_ = _object(arguments, poses)
    say_compiling("the hand and its contacts")
    parts, inside, dropped = [], [], 0
    size = min(CHUNK, len(poses))
    for first in range(0, len(poses), size):
        # The last are filled up with repeats: another size would be compiled anew.
        own = np.minimum(np.arange(first, first + size), len(poses) - 1)
        found, stuck = _touch(arguments, hand, object_.tree, poses, own)
        real = slice(len(poses) - first)
        found, stuck = jax.tree.map(lambda x, real=real: x[real], (found, stuck))
        inside.append(stuck)
        if arguments.max_contacts is not None:
            kept = keep_deepest(found, arguments.max_contacts)
            dropped += int(kept.dropped.sum())
            found = kept.contacts
        parts.append(_sets(found, object_, arguments))
    names = np.array([f"{poses.path.stem} {i}" for i in range(len(poses))])
    found_sets = joined_sets(parts, names)
    out = {
        "whose hand starts inside the object": np.concatenate(inside),
        "that touch nothing": found_sets.sizes == 0,
    }
    sets = found_sets.rows(np.flatnonzero(~np.any(list(out.values()), axis=0)))
    if not len(sets):
        raise ValueError(
            f"none of the {len(poses)} grasps can be used: {'; '.join(left_out_words(out))}; is the scale right?"
        )
    save_grasps(arguments.out, sets)
    show(found_words(sets, out, dropped))
    show(f"written: {arguments.out}")
    return 0


def _check(arguments: FindContacts) -> None:
    check_positive(arguments, "mass", "stiffness", "depth", "scale")
    check_not_negative(arguments, "friction")
    if not np.all(np.isfinite(arguments.gravity)):
        raise ValueError(f"gravity is {arguments.gravity}: expected finite numbers [m/s^2]")
    if arguments.out.suffix != ".npz":
        raise ValueError(f"out is {arguments.out}: expected a file that ends in .npz")


def _hand(arguments: FindContacts) -> Hand:
    if arguments.hand == "jaw":
        return parallel_jaw()
    return human_hand(arguments.hand_length, side="right" if arguments.hand == "human-right" else "left")


def _object(arguments: FindContacts, poses: GraspPoses) -> _Object:
    path = arguments.mesh or poses.mesh_path()
    if path is None:
        raise ValueError(
            f"{poses.path} names the mesh {poses.mesh!r}, which is not beside it: give it by --mesh"
            if poses.mesh
            else "no mesh: give it by --mesh"
        )
    mesh = load_mesh(path, next(value for value in (arguments.scale, poses.scale, 1.0) if value is not None))
    friction, mass = (_given(name, getattr(arguments, name), poses) for name in ("friction", "mass"))
    tree = sphere_tree(mesh, arguments.levels)
    left_out = filling_error(tree, mesh)
    show(
        f"{path.name}: {left_out.balls} balls in cells of {1e3 * cell_size(mesh, arguments.levels):.2g} mm leave out "
        f"{1e3 * left_out.mean:.2g} mm of the surface in the mean, {1e3 * left_out.largest:.2g} mm at most"
    )
    center = poses.center_of_mass if poses.center_of_mass is not None else mass_properties(mesh).center
    wrench = np.asarray(weight_wrench(mass, jnp.asarray(center), jnp.asarray(arguments.gravity)))
    return _Object(tree, friction, wrench)


def _given(name: str, wanted: float | None, poses: GraspPoses) -> float:
    """What the user says, else what the file does."""
    value = wanted if wanted is not None else getattr(poses, name)
    if value is None:
        raise ValueError(f"{poses.path} does not say the object's {name}: give it by --{name}")
    return value


def _touch(
    arguments: FindContacts, hand: Hand, tree: SphereTree, poses: GraspPoses, own: np.ndarray
) -> tuple[Found, np.ndarray]:
    """The contacts of some grasps, and which of them began inside the object."""
    transforms = jnp.asarray(poses.transforms[own])
    wrist = Pose(transforms[:, :3, 3], transforms[:, :3, :3])
    open_ = jnp.clip(jnp.zeros(len(hand.joints)), hand.lower, hand.upper)
    angles = jnp.broadcast_to(open_, (len(transforms), len(open_))) if poses.angles is None else poses.angles[own]
    start = Posture(wrist, jnp.asarray(angles))
    placed = Pose(jnp.zeros(3), jnp.eye(3))
    found = find_contacts(hand, start, tree, placed)
    if poses.angles is not None:
        return found, np.zeros(len(transforms), bool)
    inside = np.asarray(jnp.max(found.depths, -1) > arguments.depth)
    near, _ = close_hand(hand, start, tree, placed, arguments.depth, steps=STRIDES)
    stride = (hand.upper - start.angles) / STRIDES
    back = Posture(wrist, jnp.maximum(near.angles - stride, start.angles))
    return close_hand(hand, back, tree, placed, arguments.depth, towards=near.angles, steps=STRIDES)[1], inside


def _sets(found: Found, object_: _Object, arguments: FindContacts) -> ContactSets:
    grasp = grasp_from_contacts(found, object_.friction, arguments.stiffness)
    return ContactSets.from_grasp(jax.device_get(grasp), object_.wrench)


def joined_sets(parts: list[ContactSets], names: np.ndarray, **labels: np.ndarray) -> ContactSets:
    """Sets of contacts one after the other, and the name and other labels of each."""
    sizes = np.concatenate([part.sizes for part in parts])
    columns = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ("points", "normals", "friction")}
    return ContactSets(
        **columns,
        squeeze=np.concatenate([part.squeeze for part in parts]),
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        wrench=np.concatenate([part.wrench for part in parts]),
        labels={"name": names, **labels},
    )


def left_out_words(out: dict[str, np.ndarray]) -> list[str]:
    """How many grasps were left out for each reason, and which came first."""
    return [
        f"left out: {chosen.sum()} {reason} (the first: {', '.join(map(str, np.flatnonzero(chosen)[:5]))})"
        for reason, chosen in out.items()
        if chosen.any()
    ]


def found_words(sets: ContactSets, out: dict[str, np.ndarray], dropped: int) -> str:
    """What was found, for the screen."""
    sizes = Counter(sets.sizes.tolist())
    shares = ", ".join(f"{count} with {size}" for size, count in sorted(sizes.items()))
    lines = [f"{len(sets)} grasps by their number of contacts: {shares}", *left_out_words(out)]
    if dropped:
        lines.append(f"dropped: {dropped} contacts beyond the deepest of each grasp")
    return "\n".join(lines)
