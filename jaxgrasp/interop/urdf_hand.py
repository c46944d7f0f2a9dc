"""A robot's hand out of a URDF file, as ROS packages have it: MuJoCo compiles it, and its hinges become a Hand's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from jaxgrasp.interop.left_out import LeftOut
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.interop.mujoco_hand import MujocoHand, hand_from_mujoco
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    import mujoco

PACKAGE = "package://"
KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
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
"""How MuJoCo is to read the file."""


@checked
def hand_from_urdf(
    path: str | Path,
    wrist: str,
    *,
    locked: Mapping[str, float] | None = None,
    names: Mapping[str, tuple[str, str]] | None = None,
    keep_going: bool = False,
) -> MujocoHand:
    """The hand that hangs on a link of a URDF file.

    Collision geometry alone counts. A mesh becomes a capsule of the same inertia, as MuJoCo fits it: right for a
    phalanx, rough for a palm. Links joined by a fixed joint touch each by itself.

    Args:
        path: of the file. Its meshes are found beside it, or for ``package://NAME/...`` in a folder called NAME above
            it.
        wrist: name of the link that is the wrist; its frame is the Hand's.
        locked: joints that stay at an angle [rad] or a place [m], by name.
        names: finger and phalanx of a link, by its name, such as ``{"link_3.0": ("index", "distal")}``.
        keep_going: leave out shapes whose mesh is missing, instead of stopping at the first.

    Returns:
        The Hand, and the MuJoCo model that it came from. Its largest torques are the joints' ``effort``; one of zero
        says nothing, as in most files that have it.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for a file or a mesh that is not there, a kind of joint that URDF does not have, what MuJoCo
            cannot read, and as [`jaxgrasp.interop.hand_from_mujoco`][] does.
    """
    mujoco = import_mujoco("hand_from_urdf")
    model, notes = compile_urdf(mujoco, Path(path), keep_going)
    found = hand_from_mujoco(model, wrist, locked=locked, names=names)
    return replace(found, left_out=(*(note.part for note in notes if note.missing), *found.left_out))


def compile_urdf(mujoco: Any, path: Path, keep_going: bool) -> tuple[mujoco.MjModel, tuple[LeftOut, ...]]:
    """The file's model, and what became of its meshes; those that are missing may be left out."""
    robot = _read(path)
    for joint in robot.iterfind("joint"):
        if joint.get("type") not in KINDS:
            raise ValueError(
                f"path is {str(path)!r}: joint {joint.get('name', '')!r} has the type {joint.get('type')!r}: "
                f"expected one of {', '.join(KINDS)}"
            )
    notes = [note for link in robot.iterfind("link") for note in _find_meshes(path, link, keep_going)]
    try:
        return _model(mujoco, path, robot), tuple(notes)
    except RecursionError:
        raise ValueError(f"path is {str(path)!r}: its elements are nested too deeply for a hand") from None


def _find_meshes(path: Path, link: ElementTree.Element, keep_going: bool) -> Iterator[LeftOut]:
    """Write into a link where its meshes are, and say of each what becomes of it."""
    for collision in link.findall("collision"):
        for mesh in collision.iterfind("geometry/mesh"):
            part = f"mesh {mesh.get('filename', '')!r} of link {link.get('name', '')!r}"
            try:
                mesh.set("filename", str(_mesh_file(path, link.get("name", ""), mesh.get("filename", ""))))
                yield LeftOut(part, "touches as a capsule of the same inertia")
            except ValueError as error:
                if not keep_going:
                    raise
                link.remove(collision)
                yield LeftOut(part, str(error).rpartition(": ")[2], missing=True)


def _model(mujoco: Any, path: Path, robot: ElementTree.Element) -> mujoco.MjModel:
    extension = _child(robot, "mujoco")
    _child(extension, "compiler").attrib.update(COMPILER)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
        for geom in spec.geoms:
            if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
                geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
        return spec.compile()
    except ValueError as error:
        said = " ".join(str(error).split())
        raise ValueError(f"path is {str(path)!r}: expected a URDF that MuJoCo can read; it says: {said}") from None


def _read(path: Path) -> ElementTree.Element:
    """The file's ``robot`` element."""
    if not path.is_file():
        raise ValueError(f"path is {str(path)!r}: expected a URDF file, but there is none")
    try:
        robot = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"path is {str(path)!r}: expected a URDF file, but it is no XML: {error}") from None
    if robot.tag != "robot":
        raise ValueError(f"path is {str(path)!r}: expected a URDF file, whose root is <robot>, not <{robot.tag}>")
    return robot


def _mesh_file(path: Path, link: str, name: str) -> Path:
    """Where a mesh is that the file names."""
    folder = path.resolve().parent
    if name.startswith(PACKAGE):
        package, _, rest = name.removeprefix(PACKAGE).partition("/")
        tried = [above / rest for above in (folder, *folder.parents) if above.name == package]
        where = f"below a folder {package!r} that holds the URDF"
    else:
        tried, where = [folder / name.removeprefix("file://")], "beside the URDF"
    for file in tried:
        if file.is_file():
            return file
    raise ValueError(f"link {link!r} has the mesh {name!r}: expected that file {where}, but there is none")


def _child(parent: ElementTree.Element, tag: str) -> ElementTree.Element:
    """The first child of a tag, made where there is none."""
    found = parent.find(tag)
    return ElementTree.SubElement(parent, tag) if found is None else found
