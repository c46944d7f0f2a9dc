"""Contacts of posed hands and closing grippers with a mesh, for any number of grasps, computed in chunks."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.hand.closing import close_hand, flexed
from jaxgrasp.hand.detection import Contacts as Found
from jaxgrasp.hand.detection import find_contacts, keep_deepest
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.hand.to_grasp import grasp_from_contacts
from jaxgrasp.model.hand import Hand, Pose, Posture
from jaxgrasp.model.wrench import weight_wrench

CHUNK = 512
"""Grasps at a time."""
STRIDES = 24
"""Steps of a closing hand's first way; as many again, within the last of them, find the depth."""


@dataclass(frozen=True)
class PlacedGrasps:
    """N grasps of one mesh."""

    transforms: np.ndarray
    """``(N, 4, 4)``: of the wrist."""
    angles: np.ndarray | None
    """``(N, J)``; None where the hand is to close."""
    objects: np.ndarray | None
    """``(N, 4, 4)``: where the mesh stands; at the origin where None."""
    scales: np.ndarray
    """``(N,)``: by how much the tree is to be made larger."""
    friction: np.ndarray
    """``(N,)``"""
    wrenches: np.ndarray
    """``(N, 6)``"""

    def posture(self, hand: Hand, indices: np.ndarray) -> Posture:
        """Return the postures of the grasps with these ``indices``; open where the hand is to close."""
        open_ = jnp.clip(jnp.zeros(len(hand.joints)), hand.lower, hand.upper)
        angles = jnp.broadcast_to(open_, (len(indices), len(open_))) if self.angles is None else self.angles[indices]
        return Posture(_pose(self.transforms[indices]), jnp.asarray(angles))

    def placed(self, indices: np.ndarray) -> Pose:
        """Return the mesh's poses for the grasps with these ``indices``; one identity where ``objects`` is None."""
        return Pose(jnp.zeros(3), jnp.eye(3)) if self.objects is None else _pose(self.objects[indices])


def joined_grasps(parts: Sequence[PlacedGrasps]) -> PlacedGrasps:
    """Concatenate grasps of several files of one format, which all have a field or none has it."""
    columns: dict[str, Any] = {}
    for column in fields(PlacedGrasps):
        arrays = [getattr(part, column.name) for part in parts]
        columns[column.name] = None if arrays[0] is None else np.concatenate(arrays)
    return PlacedGrasps(**columns)


class Touching(NamedTuple):
    """Stiffness, depth and number of contacts by which hands touch."""

    stiffness: float
    """K of eq. 6 [N/m]."""
    depth: float
    """Depth to which a closing hand presses into the mesh [m]."""
    max_contacts: int | None
    """The most contacts of a grasp."""


class Touched(NamedTuple):
    """Contacts of N grasps, in the order of the grasps."""

    sets: ContactSets
    """All N grasps, those without contacts too."""
    inside: np.ndarray
    """``(N,)``: which hands began inside the object."""
    dropped: int
    """Contacts beyond the deepest of each grasp."""


def weights(
    mass: float, centers: np.ndarray, gravity: Sequence[float], objects: np.ndarray | None = None
) -> np.ndarray:
    """Compute the wrenches ``(N, 6)`` that hold objects with centres of mass ``(N, 3)`` in their meshes' frames."""
    if objects is not None:
        centers = in_world(objects, centers)
    return np.asarray(weight_wrench(mass, jnp.asarray(centers), jnp.asarray(gravity)))


def in_world(objects: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transform points ``(N, 3)``, one in the frame of each mesh ``(N, 4, 4)``, to the world."""
    return objects[:, :3, 3] + np.einsum("nij,nj->ni", objects[:, :3, :3], points)


def touch(hand: Hand, tree: SphereTree, grasps: PlacedGrasps, touching: Touching) -> Touched:
    """Find the contacts of all grasps, one scale of the object after the other; the result keeps the grasps' order."""
    sizes, scale_index, counts = np.unique(grasps.scales, return_inverse=True, return_counts=True)
    size = min(CHUNK, int(counts.max()))
    order, parts, inside, dropped = [], [], [], 0
    for number, scale in enumerate(sizes):
        chosen = np.flatnonzero(scale_index == number)
        sized = tree.scaled(float(scale))
        for first in range(0, len(chosen), size):
            # The last are filled up with repeats: another size would be compiled anew.
            indices = chosen[np.minimum(np.arange(first, first + size), len(chosen) - 1)]
            contacts, stuck = _find(hand, sized, grasps, indices, touching.depth)
            indices = indices[: len(chosen) - first]
            contacts, stuck = jax.tree.map(lambda x, indices=indices: x[: len(indices)], (contacts, stuck))
            if touching.max_contacts is not None:
                deepest = keep_deepest(contacts, touching.max_contacts)
                dropped += int(deepest.dropped.sum())
                contacts = deepest.contacts
            grasp = grasp_from_contacts(contacts, grasps.friction[indices, None], touching.stiffness)
            parts.append(ContactSets.from_grasp(jax.device_get(grasp), grasps.wrenches[indices]))
            order.append(indices)
            inside.append(stuck)
    back = np.argsort(np.concatenate(order))
    return Touched(joined_sets(parts).rows(back), np.concatenate(inside)[back], dropped)


def _find(
    hand: Hand, tree: SphereTree, grasps: PlacedGrasps, indices: np.ndarray, depth: float
) -> tuple[Found, np.ndarray]:
    """Find the contacts of the grasps with these ``indices``, and a mask of the hands that began inside the object."""
    start, placed = grasps.posture(hand, indices), grasps.placed(indices)
    contacts = find_contacts(hand, start, tree, placed)
    if grasps.angles is not None:
        return contacts, np.zeros(len(indices), bool)
    inside = np.asarray(jnp.max(contacts.depths, -1) > depth)
    # Said here as well, so that both ways are one program.
    direction = flexed(hand, start.angles)
    near, _ = close_hand(hand, start, tree, placed, depth, towards=direction, steps=STRIDES)
    stride = (hand.upper - start.angles) / STRIDES
    back = Posture(start.wrist, jnp.maximum(near.angles - stride, start.angles))
    return close_hand(hand, back, tree, placed, depth, towards=near.angles, steps=STRIDES)[1], inside


def _pose(transforms: np.ndarray) -> Pose:
    matrices = jnp.asarray(transforms)
    return Pose(matrices[:, :3, 3], matrices[:, :3, :3])


def joined_sets(parts: Sequence[ContactSets]) -> ContactSets:
    """Concatenate sets of contacts, without labels."""
    columns: dict[str, Any] = {
        name: np.concatenate([part.columns[name] for part in parts]) for name in parts[0].columns
    }
    columns["wrench"] = np.concatenate([part.wrench for part in parts])
    sizes = np.concatenate([part.sizes for part in parts])
    return ContactSets(**columns, offsets=np.concatenate([[0], np.cumsum(sizes)]))
