"""MJCF files of hands as data sets carry them: made for older MuJoCos, and without all of their meshes.

A hand needs joints and what touches. What only pictures and solvers need is left out where a file is not accepted as
it is: options, sizes, textures, materials, and geoms whose mesh is not there; inertias where that is not enough, and
then motors and tendons.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from jaxgrasp.interop.bounded_xml import read_xml
from jaxgrasp.interop.left_out import LeftOut
from jaxgrasp.interop.mjcf_bounds import check_bounds
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    import mujoco

NEEDLESS = ("option", "size", "visual", "statistic", "sensor", "contact", "keyframe")
"""Elements of a file that say nothing of joints and shapes."""
MOTORS = ("actuator", "tendon", "equality")
"""Elements that drive and couple joints: left out only where the file is not accepted with them."""

REFUSALS = (ValueError, RuntimeError, MemoryError)
"""Errors by which MuJoCo refuses a file: the second where it caught an exception that it does not know."""


@checked
def load_mjcf(path: str | Path, *, capsules: bool = False) -> mujoco.MjModel:
    """Load the model in an MJCF file, without elements that the installed MuJoCo does not know or find.

    [`jaxgrasp.interop.read_hand`][] lists the parts that were left out.

    Args:
        path: of the file.
        capsules: make capsules of meshes, as long and as wide as these are, so that a Hand of the model touches there
            too.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for a file that is no model even so, and before MuJoCo sees it for one that makes more than 10,000
            elements or 2,000 bodies, with replicates and included files, has height fields and textures of more than
            2^25 cells together, is nested more than 200 deep, or attaches itself.
        OSError: for a file that cannot be read.
    """
    return read_mjcf(import_mujoco("load_mjcf"), Path(path), capsules)[0]


def read_mjcf(mujoco: Any, path: Path, capsules: bool = False) -> tuple[mujoco.MjModel, tuple[LeftOut, ...]]:
    """Read the model of an MJCF file; return it with the parts that were left out."""
    root = read_xml(path, "an MJCF file")
    check_bounds(root, path)
    try:
        return _compiled(mujoco, mujoco.MjSpec.from_file(str(path)), capsules), ()
    except REFUSALS as error:
        refused = " ".join(str(error).split())
    text = ElementTree.tostring(root)
    for needless, has_masses in ((NEEDLESS, True), (NEEDLESS, False), ((*NEEDLESS, *MOTORS), False)):
        root = ElementTree.fromstring(text)
        left_out = _strip(root, path.parent, needless, refused)
        if not has_masses:
            left_out = (*left_out, *_strip_inertias(root, refused))
        try:
            spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
            return _compiled(mujoco, spec, capsules), left_out
        except REFUSALS as error:
            problem = " ".join(str(error).split())
    raise ValueError(f"{path} is not a model that MuJoCo can read: {problem}")


def _compiled(mujoco: Any, spec: mujoco.MjSpec, capsules: bool) -> mujoco.MjModel:
    # Capsules take the meshes' extents: a capsule of the same inertia is a seventh thinner than a finger, and misses
    # contacts of it.
    spec.compiler.fitaabb = capsules or spec.compiler.fitaabb
    for geom in spec.geoms if capsules else ():
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    return spec.compile()


def _strip(root: ElementTree.Element, folder: Path, needless: tuple[str, ...], refused: str) -> tuple[LeftOut, ...]:
    """Take out of a file what it can do without; what went is said, but for what only pictures need."""
    taken = [element for element in root if element.tag in needless]
    for element in taken:
        root.remove(element)
    tags = list(dict.fromkeys(element.tag for element in taken))
    notes = [LeftOut(f"elements {', '.join(tags)}", f"MuJoCo refuses the file as it is: {refused}")] if tags else []
    compiler = root.find("compiler")
    meshes = folder
    if compiler is not None:
        meshes = folder / compiler.attrib.pop("meshdir", ".")
        compiler.attrib.pop("texturedir", None)
    loadable = set()
    for asset in root.findall("asset"):
        for element in list(asset):
            file = meshes / element.get("file", "")
            if element.tag == "mesh" and file.is_file():
                element.set("file", str(file.resolve()))
                loadable.add(element.get("name") or file.stem)
            else:
                asset.remove(element)
                if element.tag == "mesh":
                    part = f"mesh {element.get('name') or file.stem!r}"
                    notes.append(LeftOut(part, f"the file {str(file)!r} does not exist", missing=True))
    return (*notes, *_strip_geoms(root, loadable), *_strip_motors(root))


def _strip_geoms(root: ElementTree.Element, meshes: set[str]) -> Iterator[LeftOut]:
    """Take out geoms without their mesh, and sites; materials are no longer there."""
    for parent in list(root.iter()):
        for geom in parent.findall("geom"):
            geom.attrib.pop("material", None)
            mesh = geom.get("mesh", "")
            # A class of defaults may say "mesh" for all of its geoms, each of which then names its own.
            absent = mesh not in meshes | {""} or (geom.get("type") == "mesh" and not mesh)
            if absent and parent.tag != "default":
                parent.remove(geom)
                name = f"geom {geom.get('name', '')!r} of {parent.tag} {parent.get('name', '')!r}"
                yield LeftOut(name, f"its mesh {mesh!r} is missing")
        for site in parent.findall("site"):
            parent.remove(site)


def _strip_inertias(root: ElementTree.Element, refused: str) -> Iterator[LeftOut]:
    """Take out inertias, of which a Hand has none, and take flat meshes for shells."""
    taken = [(parent, inertial) for parent in root.iter() for inertial in parent.findall("inertial")]
    for parent, inertial in taken:
        parent.remove(inertial)
    compiler = root.find("compiler")
    compiler = ElementTree.SubElement(root, "compiler") if compiler is None else compiler
    compiler.attrib.update(balanceinertia="true", boundmass="1e-9", boundinertia="1e-12", inertiafromgeom="true")
    for mesh in root.iterfind("asset/mesh"):
        mesh.set("inertia", "shell")
    if taken:
        yield LeftOut(f"inertias of {len(taken)} bodies", f"MuJoCo refuses the file as it is: {refused}")


def _strip_motors(root: ElementTree.Element) -> Iterator[LeftOut]:
    """Take out motors of joints that the file has no longer."""
    joints = {joint.get("name") for joint in root.iterfind(".//joint")}
    for actuator in root.findall("actuator"):
        for motor in list(actuator):
            if motor.get("joint") is not None and motor.get("joint") not in joints:
                actuator.remove(motor)
                yield LeftOut(f"motor {motor.get('name', '')!r}", f"the file has no joint {motor.get('joint')!r}")
