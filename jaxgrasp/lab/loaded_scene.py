"""Scenes whose hand is described in a separate file."""

from jaxgrasp.grip.scene_file import GrippedScene, SceneFile, gripped_scene
from jaxgrasp.interop.hand_file import read_hand
from jaxgrasp.validation.checked import checked


@checked
def loaded_scene(file: SceneFile) -> GrippedScene:
    """Close the hand that a scene names on the object, as by ``gripped_scene``.

    Raises:
        ValueError: as ``gripped_scene`` does, and for a file without a hand.
        ImportError: for a hand from a file without the extra `hands`, and for a mesh without `mesh`.
        OSError: for a file that cannot be read.
    """
    if file.hand.file is None:
        return gripped_scene(file)
    return gripped_scene(file, read_hand(file.hand.file, file.hand.wrist).mujoco_hand.hand)
