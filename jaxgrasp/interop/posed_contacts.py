"""Contacts of posed hands and closing grippers with an object, for any number of grasps, in chunks of equal size."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxgrasp.hand.closing import close_hand, flexed
from jaxgrasp.hand.detection import Contacts, find_contacts, keep_deepest
from jaxgrasp.hand.parallel_jaw import parallel_jaw
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.to_grasp import grasp_from_contacts
from jaxgrasp.interop.file_records import GraspPoses
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.validation.checked import checked

CHUNK = 512
"""Number of grasps of a compiled call."""
STRIDES = 24
"""Steps of a closing hand's first way; as many again, within the last of them, find the depth."""
DEFAULT_FRICTION = 0.5
"""Friction where neither the caller nor the file gives one."""


class PosedContacts(NamedTuple):
    """Contacts of N grasps, in the order of their poses."""

    grasp: Grasp
    """Contacts ``(N, n)`` as NumPy arrays, in the world of the poses; ``present`` is 1 where a link touches."""
    is_inside: Bool[np.ndarray, "N"]
    """True where a hand that was to close started inside the object: its contacts mean nothing."""
    dropped: int
    """Number of contacts beyond the deepest of each grasp."""


class Gripper(NamedTuple):
    """Two parallel jaws and the frame in which a file has its poses."""

    hand: Hand
    frame: Float[np.ndarray, "4 4"]
    """Transform from the jaws' frame to the file's: ``transforms @ frame`` are the poses of the jaws."""


class _Jaws(NamedTuple):
    opening: float
    pads: tuple[float, float]


GripperName = Literal["franka", "robotiq-2f-85", "robotiq-2f-140"]
JAWS: dict[str, _Jaws] = {
    "franka": _Jaws(0.08, (0.0941, 0.1122)),
    "robotiq-2f-85": _Jaws(0.085, (0.1125, 0.1475)),
    "robotiq-2f-140": _Jaws(0.136, (0.165, 0.225)),
}
"""[m]: of the Franka hand in ACRONYM's frame; of the Robotiq grippers in that of their base, where GraspGen has the
regions in which they close. Their pads swing as they close, here they slide."""


@checked
def gripper_by_name(
    name: GripperName,
    *,
    opening: float | None = None,
    pads: tuple[float, float] | None = None,
    closes_along: Literal["x", "y"] = "x",
) -> Gripper:
    """Return a two-jaw gripper as a hand, for poses of ACRONYM, GraspGen or isaac_grasp files.

    Args:
        name: of the gripper whose opening and pads are the defaults; it looks along z.
        opening: distance between the open pads [m].
        pads: begin and end of the pads along z [m].
        closes_along: axis of the file's frame along which the jaws close.

    Raises:
        ValueError: for an unknown name, or sizes that are not positive.
    """
    jaws = JAWS[name]
    hand = parallel_jaw(jaws.opening if opening is None else opening, reach=jaws.pads if pads is None else pads)
    frame = np.eye(4)
    if closes_along == "y":
        frame[:2, :2] = [[0, -1], [1, 0]]
    return Gripper(hand, frame)


@checked
def contacts_of_poses(
    poses: GraspPoses,
    hand: Hand,
    tree: SphereTree,
    *,
    friction: float | Float[np.ndarray, "N"] | None = None,
    stiffness: float = 1000.0,
    depth: float = 1e-3,
    max_contacts: int | None = None,
) -> PosedContacts:
    """Find the contacts of a file's hands or grippers with their object.

    A hand whose joint angles the file gives touches where it stands. One without angles starts open and closes until
    it presses to the depth. Grasps are worked on 512 at a time, so that one compiled program serves any number.

    Args:
        poses: of one object, as the readers of this package return them; ``scales`` and ``objects`` are respected.
        hand: the file's hand; of a gripper from [`jaxgrasp.interop.gripper_by_name`][] multiply the poses by its frame.
        tree: the object, by [`jaxgrasp.hand.sphere_tree`][] of its mesh, in the mesh's units.
        friction: coefficient, one for all grasps or ``(N,)``; the file's where not given, else 0.5.
        stiffness: squeezing force for each metre of depth (eq. 6) [N/m].
        depth: of penetration to which a closing hand presses [m].
        max_contacts: largest number of contacts of a grasp, the deepest; all where not given.

    Returns:
        Contacts in the frame of the poses; [`jaxgrasp.weight_wrench`][] gives the wrench that holds the object.

    Raises:
        ValueError: for angles that are not one for each joint of the hand, or numbers that are not positive.

    Example:
        ::

            poses = interop.read_acronym("Mug_8.h5")
            jaws = interop.gripper_by_name("franka")
            mesh = hand.load_mesh(poses.mesh_path())
            at_jaws = dataclasses.replace(poses, transforms=poses.transforms @ jaws.frame)
            touched = interop.contacts_of_poses(at_jaws, jaws.hand, hand.sphere_tree(mesh))
    """
    count = len(poses)
    for name, value in (("stiffness", stiffness), ("depth", depth)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}: expected a positive number")
    if max_contacts is not None and max_contacts < 1:
        raise ValueError(f"max_contacts is {max_contacts}: expected at least 1")
    if poses.angles is not None and poses.angles.shape[1] != len(hand.joints):
        raise ValueError(
            f"angles has {poses.angles.shape[1]} columns: expected {len(hand.joints)}, one for each joint of the hand"
        )
    if count == 0:
        raise ValueError("poses is empty: expected at least one grasp")
    if friction is None:
        friction = DEFAULT_FRICTION if poses.friction is None else poses.friction
    if np.ndim(friction) and len(np.asarray(friction)) != count:
        raise ValueError(f"friction has {len(np.asarray(friction))} entries: expected one, or {count}")
    coefficients = np.broadcast_to(np.asarray(friction, float), (count,))
    scales, scale_index, counts = np.unique(
        np.ones(count) if poses.scales is None else poses.scales, return_inverse=True, return_counts=True
    )
    size = min(CHUNK, int(counts.max()))
    order, parts, inside, dropped = [], [], [], 0
    for number, scale in enumerate(scales):
        chosen = np.flatnonzero(scale_index == number)
        scaled = tree.scaled(float(scale))
        for first in range(0, len(chosen), size):
            # The last chunk is filled up with repeats: another size would be compiled anew.
            indices = chosen[np.minimum(np.arange(first, first + size), len(chosen) - 1)]
            contacts, is_inside = _find(poses, hand, scaled, indices, depth)
            n_valid = len(chosen) - first
            indices, contacts, is_inside = jax.tree.map(lambda x, n=n_valid: x[:n], (indices, contacts, is_inside))
            if max_contacts is not None:
                deepest = keep_deepest(contacts, max_contacts)
                dropped += int(deepest.dropped.sum())
                contacts = deepest.contacts
            grasp = grasp_from_contacts(contacts, coefficients[indices, None], stiffness)
            parts.append(jax.device_get(grasp))
            order.append(indices)
            inside.append(is_inside)
    back = np.argsort(np.concatenate(order))
    grasp = jax.tree.map(lambda *leaves: np.concatenate(leaves)[back], *parts)
    return PosedContacts(grasp, np.concatenate(inside)[back], dropped)


def join_poses(parts: Sequence[GraspPoses]) -> GraspPoses:
    """Concatenate the grasps of several files of one format and object; all of them have a field, or none has."""
    columns: dict[str, Any] = {}
    for name in ("transforms", "angles", "scales", "objects"):
        arrays = [getattr(part, name) for part in parts]
        columns[name] = None if arrays[0] is None else np.concatenate(arrays)
    return replace(
        parts[0], names=tuple(name for part in parts for name in part.names), succeeded=None, confidence=None, **columns
    )


def _find(
    poses: GraspPoses, hand: Hand, tree: SphereTree, indices: np.ndarray, depth: float
) -> tuple[Contacts, np.ndarray]:
    """Find the contacts of the grasps with these ``indices``, and a mask of the hands that started in the object."""
    start = _posture(poses, hand, indices)
    placed = Pose(jnp.zeros(3), jnp.eye(3)) if poses.objects is None else _pose(poses.objects[indices])
    contacts = find_contacts(hand, start, tree, placed)
    if poses.angles is not None:
        return contacts, np.zeros(len(indices), bool)
    is_inside = np.asarray(jnp.max(contacts.depths, -1) > depth)
    # Passed here as well, so that both ways are one program.
    direction = flexed(hand, start.angles)
    near, _ = close_hand(hand, start, tree, placed, depth, towards=direction, steps=STRIDES)
    stride = (hand.upper - start.angles) / STRIDES
    back = Posture(start.wrist, jnp.maximum(near.angles - stride, start.angles))
    return close_hand(hand, back, tree, placed, depth, towards=near.angles, steps=STRIDES)[1], is_inside


def _posture(poses: GraspPoses, hand: Hand, indices: np.ndarray) -> Posture:
    """Return the postures of the grasps with these ``indices``; open where the hand is to close."""
    open_ = jnp.clip(jnp.zeros(len(hand.joints)), hand.lower, hand.upper)
    angles = jnp.broadcast_to(open_, (len(indices), len(open_))) if poses.angles is None else poses.angles[indices]
    return Posture(_pose(poses.transforms[indices]), jnp.asarray(angles))


def _pose(transforms: np.ndarray) -> Pose:
    matrices = jnp.asarray(transforms)
    return Pose(matrices[:, :3, 3], matrices[:, :3, :3])
