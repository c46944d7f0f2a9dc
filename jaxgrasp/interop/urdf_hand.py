"""A robot's hand out of a URDF file, as ROS packages have it: MuJoCo compiles it, and its hinges become a Hand's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from jaxgrasp.interop.left_out import LeftOut
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.interop.mujoco_hand import MujocoHand, hand_from_mujoco
from jaxgrasp.interop.urdf_file import drop_impossible_inertias, drop_impossible_shapes, read_urdf
from jaxgrasp.interop.urdf_meshes import UrdfMeshes, fill
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    import mujoco

COMPILER = {
    "strippath": "false",
    "meshdir": "",
    "discardvisual": "true",
    # Fixed joints keep their links apart, so that each can touch, and the wrist keeps its name.
    "fusestatic": "false",
    # Many a URDF has inertias that no body can have; a Hand has none.
    "balanceinertia": "true",
    "boundmass": "1e-9",
    "boundinertia": "1e-12",
}
"""MuJoCo's compiler options for the file."""


@checked
def hand_from_urdf(
    path: str | Path,
    wrist: str,
    *,
    locked: Mapping[str, float] | None = None,
    names: Mapping[str, tuple[str, str]] | None = None,
    keep_going: bool = False,
) -> MujocoHand:
    """Build the hand that hangs on a link of a URDF file.

    Collision geometry alone counts. A mesh becomes a capsule of the same inertia, as MuJoCo fits it: right for a
    phalanx, rough for a palm. Collada and other formats that MuJoCo does not read are read by trimesh (extra ``mesh``).
    Links joined by a fixed joint touch each by itself. A mass or inertia that no body can have is dropped: a Hand has
    none, and the model's is then made up from the shapes.

    Args:
        path: of the file. Its meshes are found beside it, or for ``package://NAME/...`` in a folder called NAME above
            it.
        wrist: name of the link that is the wrist; its frame is the Hand's.
        locked: joints that stay at an angle [rad] or a place [m], by name.
        names: finger and phalanx of a link, by its name, such as ``{"link_3.0": ("index", "distal")}``.
        keep_going: leave out shapes whose mesh is missing, flat or cannot be read, and shapes without a size, instead
            of stopping at the first.

    Returns:
        The Hand, and the MuJoCo model that it came from. Its largest torques are the joints' ``effort``; one of zero
        says nothing, as in most files that have it.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for a file or a mesh that is not there, a xacro that was not expanded, a name that two links or two
            joints have, links that make no tree, a kind of joint that URDF does not have, what MuJoCo cannot read, and
            as [`jaxgrasp.interop.hand_from_mujoco`][] does.
    """
    mujoco = import_mujoco("hand_from_urdf")
    model, notes = compile_urdf(mujoco, Path(path), keep_going)
    mujoco_hand = hand_from_mujoco(model, wrist, locked=locked, names=names)
    return replace(mujoco_hand, left_out=(*(note.part for note in notes if note.missing), *mujoco_hand.left_out))


def compile_urdf(mujoco: Any, path: Path, keep_going: bool) -> tuple[mujoco.MjModel, tuple[LeftOut, ...]]:
    """Return the file's model, and what became of its meshes and of what no body can have.

    Raises:
        ValueError: as [`jaxgrasp.interop.hand_from_urdf`][] does.
    """
    robot, meshes = read_urdf(path), UrdfMeshes(mujoco, path)
    try:
        notes = (
            *drop_impossible_inertias(robot),
            *drop_impossible_shapes(robot, keep_going),
            *meshes.prepare(robot, keep_going),
        )
    except ValueError as error:
        raise ValueError(f"path is {str(path)!r}: {error}") from None
    return _model(mujoco, path, robot, meshes), notes


def _model(mujoco: Any, path: Path, robot: ElementTree.Element, meshes: UrdfMeshes) -> mujoco.MjModel:
    extension = _child(robot, "mujoco")
    for element in list(extension):
        if element.tag != "compiler":
            extension.remove(element)
    _child(extension, "compiler").attrib.update(COMPILER)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
        for mesh in spec.meshes:
            fill(mesh, Path(mesh.file), meshes.converted.get(mesh.file))
        for geom in spec.geoms:
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
        return spec.compile()
    except (ValueError, RuntimeError, MemoryError) as error:
        problem = " ".join(str(error).split())
        raise ValueError(f"path is {str(path)!r}: expected a URDF that MuJoCo can read; it says: {problem}") from None


def _child(parent: ElementTree.Element, tag: str) -> ElementTree.Element:
    """Return the first child of a tag, made where there is none."""
    child = parent.find(tag)
    return ElementTree.SubElement(parent, tag) if child is None else child
