"""Scenes whose hand is described in a separate file, or is the linkage of a glove."""

import equinox as eqx
import jax.numpy as jnp

from jaxgrasp.grip.scene_file import GrippedScene, SceneFile, gripped_scene
from jaxgrasp.hand.detection import find_contacts
from jaxgrasp.hand.doglove_hand import doglove_hand, linkage_angles
from jaxgrasp.hand.to_grasp import GripType, balanced_contributions, contributions_of
from jaxgrasp.interop.hand_file import read_hand
from jaxgrasp.model.hand import Posture
from jaxgrasp.validation.checked import checked

MIN_CONTRIBUTION = 0.05
"""Least contribution of a cap of a linkage whose squeezing forces are balanced."""


@checked
def loaded_scene(file: SceneFile, linkage: bool = False) -> GrippedScene:
    """Close the hand that a scene names on the object, as by ``gripped_scene``.

    Args:
        file: contents of the scene file.
        linkage: put [`jaxgrasp.hand.doglove_hand`][] on that hand, a human one, in its place: caps begin where its
            fingertips were, and press as those of a precision grip, all five where its grip is a power grip.

    Raises:
        ValueError: as ``gripped_scene`` does, for a file without a hand, and for a linkage on a hand from a file.
        ImportError: for a hand from a file without the extra `hands`, and for a mesh without `mesh`.
        OSError: for a file that cannot be read.
    """
    if file.hand.file is None:
        gripped = gripped_scene(file)
        return _with_linkage(gripped, file) if linkage else gripped
    if linkage:
        raise ValueError(f"linkage is for a human hand, and the scene's hand is {file.hand.file!r}: expected no file")
    return gripped_scene(file, read_hand(file.hand.file, file.hand.wrist).mujoco_hand.hand)


def _with_linkage(gripped: GrippedScene, file: SceneFile) -> GrippedScene:
    """Return the scene with a linkage in place of its human hand."""
    scene, person = gripped.scene, gripped.scene.hand
    hand = doglove_hand(file.hand.side)
    closed = Posture(gripped.closed.wrist, linkage_angles(hand, person, gripped.closed.angles))
    contacts = find_contacts(hand, closed, scene.body.shape, gripped.placed)
    kind = GripType(5 if file.grip.kind == "power" else int(file.grip.kind.removeprefix("precision-")))
    contributions = contributions_of(hand, kind)
    if file.grip.contributions == "balanced":
        balanced = balanced_contributions(contacts, contributions, gripped.placed.origin)
        # A cap that touches first has to hold alone, and the closed form shares nothing over a weight of zero.
        contributions = jnp.maximum(balanced, MIN_CONTRIBUTION)
    scene = eqx.tree_at(lambda s: (s.hand, s.contributions), scene, (hand, contributions))
    return gripped._replace(
        scene=scene, closed=closed, open=linkage_angles(hand, person, gripped.open), contacts=contacts, kind=kind
    )
