"""``jaxgrasp contacts``: where hands or grippers touch a mesh, as a file for ``jaxgrasp evaluate``.

Output of the commands that make files of contacts: the file, and the lines about it on screen.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import save_grasps
from jaxgrasp.cli.arguments import FindContacts
from jaxgrasp.cli.machine import compiling, set_up_jax
from jaxgrasp.cli.terminal import show
from jaxgrasp.files.replace import check_writable
from jaxgrasp.hand.filling import cell_size, filling_error, sphere_tree
from jaxgrasp.hand.human_hand import human_hand
from jaxgrasp.hand.mesh import load_mesh, mass_properties
from jaxgrasp.hand.parallel_jaw import parallel_jaw
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.interop.acronym import read_acronym
from jaxgrasp.interop.file_records import GraspPoses
from jaxgrasp.interop.grasp_fields import read_npz_poses
from jaxgrasp.interop.posed_contacts import contacts_of_poses
from jaxgrasp.model.hand import Hand
from jaxgrasp.model.wrench import weight_wrench
from jaxgrasp.validation.checked import check_not_negative, check_positive


def write_contacts(
    out: Path,
    contacts: ContactSets,
    labels: Mapping[str, np.ndarray],
    left_out: Mapping[str, np.ndarray],
    dropped: int = 0,
    hint: str = "",
) -> int:
    """Write the grasps that can be used, and say what was found; returns the exit code.

    Args:
        out: the file.
        contacts: all grasps.
        labels: of each grasp.
        left_out: which grasps cannot be used, for each reason.
        dropped: contacts beyond the deepest of each grasp.
        hint: what may be wrong where no grasp can be used.
    """
    usable = ~np.any(list(left_out.values()), axis=0)
    words = _left_out_words(left_out)
    if not usable.any():
        raise ValueError(f"none of the {len(contacts)} grasps can be used: {'; '.join(words)}{hint}")
    sets = replace(contacts, labels=labels).rows(np.flatnonzero(usable))
    out.parent.mkdir(parents=True, exist_ok=True)
    save_grasps(out, sets)
    sizes = Counter(sets.sizes.tolist())
    shares = ", ".join(f"{count} with {size}" for size, count in sorted(sizes.items()))
    show("\n".join([f"{len(sets)} grasps by their number of contacts: {shares}", *words]))
    if dropped:
        show(f"dropped: {dropped} contacts beyond the deepest of each grasp")
    show(f"written: {out}")
    return 0


def _left_out_words(left_out: Mapping[str, np.ndarray]) -> list[str]:
    """Format a line for each reason: the number of grasps left out, and the indices of the first five."""
    return [
        f"left out: {chosen.sum()} {reason} (the first: {', '.join(map(str, np.flatnonzero(chosen)[:5]))})"
        for reason, chosen in left_out.items()
        if chosen.any()
    ]


def weight_wrenches(
    mass: float, centers: np.ndarray, gravity: Sequence[float], objects: np.ndarray | None = None
) -> np.ndarray:
    """Compute the wrenches ``(N, 6)`` that hold objects with centres of mass ``(N, 3)`` in their meshes' frames."""
    if objects is not None:
        centers = points_in_world(objects, centers)
    return np.asarray(weight_wrench(mass, jnp.asarray(centers), jnp.asarray(gravity)))


def points_in_world(objects: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transform points ``(N, 3)``, one in the frame of each mesh ``(N, 4, 4)``, to the world."""
    return objects[:, :3, 3] + np.einsum("nij,nj->ni", objects[:, :3, :3], points)


class _Object(NamedTuple):
    """Object that the hands touch: its spheres, centre of mass [m], friction and mass [kg]."""

    tree: SphereTree
    center: np.ndarray
    friction: float
    mass: float


def contacts_command(arguments: FindContacts) -> int:
    """Find the contacts, write them, and say what was found."""
    _check(arguments)
    check_writable(arguments.out.parent)
    poses = _poses(arguments.file)
    set_up_jax("float64")
    hand = _hand(arguments)
    if poses.angles is not None and poses.angles.shape[1] != len(hand.joints):
        raise ValueError(
            f"{poses.path}: angles has {poses.angles.shape[1]} columns: expected {len(hand.joints)}, "
            f"the joints of the {arguments.hand} hand"
        )
    object_ = _object(arguments, poses)
    with compiling("the hand and its contacts"):
        # The tree has the mesh's scale already.
        posed = contacts_of_poses(
            replace(poses, scales=None, objects=None),
            hand,
            object_.tree,
            friction=object_.friction,
            stiffness=arguments.stiffness,
            depth=arguments.depth,
            max_contacts=arguments.max_contacts,
        )
    sets = ContactSets.from_grasp(
        posed.grasp, weight_wrenches(object_.mass, object_.center[None], arguments.gravity)[0]
    )
    return write_contacts(
        arguments.out,
        sets,
        {"name": np.array([f"{poses.path.stem} {name}" for name in poses.names])},
        {"whose hand starts inside the object": posed.is_inside, "that touch nothing": sets.sizes == 0},
        posed.dropped,
        "; is the scale right?",
    )


def _check(arguments: FindContacts) -> None:
    check_positive(arguments, "mass", "stiffness", "depth", "scale")
    check_not_negative(arguments, "friction")
    if not np.all(np.isfinite(arguments.gravity)):
        raise ValueError(f"gravity is {arguments.gravity}: expected finite numbers [m/s^2]")
    if arguments.out.suffix != ".npz":
        raise ValueError(f"out is {arguments.out}: expected a file that ends in .npz")


def _poses(path: Path) -> GraspPoses:
    if not path.is_file():
        raise ValueError(f"{path}: no such file; expected .npz, .h5 or .hdf5")
    suffix = path.suffix.lower()
    if suffix not in (".npz", ".h5", ".hdf5"):
        raise ValueError(f"{path} ends in {suffix!r}: expected .npz, .h5 or .hdf5")
    return read_npz_poses(path) if suffix == ".npz" else read_acronym(path)


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
    file_scale = None if poses.scales is None else float(poses.scales[0])
    mesh = load_mesh(path, next(value for value in (arguments.scale, file_scale, 1.0) if value is not None))
    friction, mass = (_required(name, getattr(arguments, name), poses) for name in ("friction", "mass"))
    tree = sphere_tree(mesh, arguments.levels)
    left_out = filling_error(tree, mesh)
    show(
        f"{path.name}: {left_out.balls} balls in cells of {1e3 * cell_size(mesh, arguments.levels):.2g} mm leave out "
        f"{1e3 * left_out.mean:.2g} mm of the surface in the mean, {1e3 * left_out.largest:.2g} mm at most"
    )
    center = poses.center_of_mass if poses.center_of_mass is not None else mass_properties(mesh).center
    return _Object(tree, center, friction, mass)


def _required(name: str, option: float | None, poses: GraspPoses) -> float:
    """Return the number that the user gave as ``option``, else the file's; raise ValueError without either."""
    value = option if option is not None else getattr(poses, name)
    if value is None:
        raise ValueError(f"{poses.path} does not say the object's {name}: give it by --{name}")
    return value
