"""MJCF files of hands as data sets carry them: made for older MuJoCos, and without all of their meshes.

A hand needs joints and what touches. What only pictures and solvers need is left out where a file is not accepted as
it is: options, sizes, textures, materials, and geoms whose mesh is not there.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    import mujoco

NEEDLESS = ("option", "size", "visual", "statistic", "sensor", "actuator", "tendon", "equality", "contact", "keyframe")
"""Elements of a file that say nothing of joints and shapes."""


@checked
def load_mjcf(path: str | Path, *, capsules: bool = False) -> mujoco.MjModel:
    """The model in an MJCF file, without what this MuJoCo does not know or find, where there is such.

    Args:
        path: of the file.
        capsules: make capsules of meshes, as long and as wide as these are, so that a Hand of the model touches there
            too.

    Raises:
        ImportError: without MuJoCo.
        ValueError: for a file that is no model even so.
        OSError: for a file that cannot be read.
    """
    mujoco = import_mujoco("load_mjcf")
    text = Path(path).read_bytes()
    try:
        return _compiled(mujoco, mujoco.MjSpec.from_file(str(path)), capsules)
    except ValueError:
        pass
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"{path} is no MJCF: {error}") from None
    _strip(root, Path(path).parent)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
        return _compiled(mujoco, spec, capsules)
    except ValueError as error:
        raise ValueError(f"{path} is no model that MuJoCo takes: {error}") from None


def _compiled(mujoco: Any, spec: mujoco.MjSpec, capsules: bool) -> mujoco.MjModel:
    # By their extents: a capsule of the same inertia is a seventh thinner than a finger, and misses what that touches.
    spec.compiler.fitaabb = capsules or spec.compiler.fitaabb
    for geom in spec.geoms if capsules else ():
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    return spec.compile()


def _strip(root: ElementTree.Element, folder: Path) -> None:
    for element in [one for one in root if one.tag in NEEDLESS]:
        root.remove(element)
    compiler = root.find("compiler")
    meshes = folder
    if compiler is not None:
        meshes = folder / compiler.attrib.pop("meshdir", ".")
        compiler.attrib.pop("texturedir", None)
    there = set()
    for asset in root.findall("asset"):
        for element in list(asset):
            file = meshes / element.get("file", "")
            if element.tag == "mesh" and file.is_file():
                element.set("file", str(file.resolve()))
                there.add(element.get("name") or file.stem)
            else:
                asset.remove(element)
    for parent in list(root.iter()):
        for geom in parent.findall("geom"):
            geom.attrib.pop("material", None)
            if geom.get("mesh", "") not in there | {""} or (geom.get("type") == "mesh" and geom.get("mesh") is None):
                parent.remove(geom)
        for site in parent.findall("site"):
            parent.remove(site)
