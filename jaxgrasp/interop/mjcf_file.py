"""MJCF files of hands as data sets carry them: made for older MuJoCos, and without all of their meshes.

A hand needs joints and what touches. What only pictures and solvers need is left out where a file is not accepted as
it is: options, sizes, textures, materials, and geoms whose mesh is not there; inertias where that is not enough, and
then motors and tendons.

Bounds of what an MJCF file makes MuJoCo build, checked before MuJoCo sees the file.

A file of 200 bytes can ask for 10^8 bodies, or for a height field of 10^10 cells; MuJoCo then works for hours, takes
all memory, or ends the process. Counted here are elements as MuJoCo will have them, with replicates, attached models
and included files, and the sizes of arrays that attributes ask for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

from jaxgrasp.files.printable import shortened
from jaxgrasp.interop.model_file import LeftOut, read_xml
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.validation.checked import checked

if TYPE_CHECKING:
    import mujoco

MOST_ELEMENTS = 10_000
"""Most elements of a model, after replication: 10,000 geoms take MuJoCo 4.0 seven seconds; the time is quadratic."""
MOST_BODIES = 2_000
"""Most bodies of a model, after replication: 2,000 with joints take two seconds; the time is cubic."""
MOST_CELLS = 2**25
"""Most cells of all height fields, textures and camera images together."""
MOST_ENTRIES = 10_000
"""Most entries of an array whose length is an attribute."""
BEYOND_ALL = 10**12
"""Larger counts are taken for this: nested ones multiply to numbers of thousands of digits."""
MOST_FILES = 100
"""Files that a model is made of."""

LENGTHS = {
    "nkey": MOST_ENTRIES,
    "nuserdata": 10**6,
    "nuser_body": 1_000,
    "nuser_jnt": 1_000,
    "nuser_geom": 1_000,
    "nuser_site": 1_000,
    "nuser_cam": 1_000,
    "nuser_tendon": 1_000,
    "nuser_actuator": 1_000,
    "nuser_sensor": 1_000,
    "nsample": MOST_ENTRIES,
    "actdim": 1_000,
}
"""Attributes of any element that are the length of an array, and the largest that is read."""
LENGTHS_OF = {("user", "dim"): MOST_ENTRIES, ("contact", "num"): MOST_ENTRIES, ("numeric", "size"): MOST_ENTRIES}
"""Attributes that are the length of an array in a single kind of element only, and the largest that is read."""
LARGEST_PARAMETER = 200
"""Largest parameter of a built-in mesh, whose vertices grow with the square of it."""
CELLS = {"hfield": ("nrow", "ncol"), "texture": ("width", "height"), "camera": ("resolution",)}
"""Elements that are grids, and the attributes whose product is their number of cells."""
COUNTED = ("composite", "flexcomp")
"""Elements that become as many as their ``count`` multiplies to."""
BODIES = ("body", "worldbody", "link")
PNG = b"\x89PNG\r\n\x1a\n"


class _Cost(NamedTuple):
    """Elements and bodies that an element becomes."""

    elements: int
    bodies: int

    def plus(self, cost: _Cost, times: int = 1) -> _Cost:
        """Return the sum of this and so many of another, up to a number that no bound allows."""
        return _Cost(
            min(self.elements + times * cost.elements, BEYOND_ALL), min(self.bodies + times * cost.bodies, BEYOND_ALL)
        )


NOTHING = _Cost(0, 0)


def check_bounds(root: ElementTree.Element, path: Path) -> None:
    """Raise ValueError where an MJCF file makes more than a hand's model could be.

    Args:
        root: of the file.
        path: of the file; included files and attached models are found beside it.

    Raises:
        ValueError: naming the element, its attribute and the bound.
        OSError: for an included file that cannot be read.
    """
    count = _Counter(path)
    try:
        cost = count.file(root, path)
    except ValueError as error:
        raise ValueError(f"path is {str(path)!r}: {error}") from None
    for number, limit, noun in ((cost.elements, MOST_ELEMENTS, "elements"), (cost.bodies, MOST_BODIES, "bodies")):
        if number > limit:
            raise ValueError(
                f"path is {str(path)!r}: it makes {number:,} {noun}, with replicates and included files: expected at "
                f"most {limit:,}; a larger model can be compiled by mujoco.MjModel.from_xml_path and handed to "
                "hand_from_mujoco"
            )


class _Counter:
    """Counts what the files of one model become."""

    def __init__(self, path: Path) -> None:
        self.folder = path.parent.resolve()
        self.cells = 0
        self.open_files: list[Path] = []
        self.file_costs: dict[Path, _Cost] = {}

    def file(self, root: ElementTree.Element, path: Path) -> _Cost:
        """Return the cost of a file, of which an earlier answer is kept."""
        path = path.resolve()
        if path in self.open_files:
            raise ValueError(f"{shortened(path.name)} includes or attaches itself: expected files that end")
        if path not in self.file_costs:
            if len(self.file_costs) + len(self.open_files) >= MOST_FILES:
                raise ValueError(f"it is made of more than {MOST_FILES} files: expected fewer")
            self.open_files.append(path)
            for element in root.iter():
                _check_lengths(element)
                self._count_cells(element, path.parent)
            self.file_costs[path] = self._element(root, path.parent, self._largest_model(root, path.parent))
            self.open_files.pop()
        return self.file_costs[path]

    def _element(self, element: ElementTree.Element, folder: Path, attached: _Cost) -> _Cost:
        below = NOTHING
        for child in element:
            below = below.plus(self._element(child, folder, attached))
        times = 1
        if element.tag == "replicate":
            times = max(_largest_integer(element, "count"), 0)
        cost = _Cost(1, int(element.tag in BODIES)).plus(below, times)
        if element.tag == "include":
            for file in self._files(element, folder):
                cost = cost.plus(self.file(read_xml(file, "an MJCF file"), file))
        elif element.tag == "attach":
            cost = cost.plus(attached)
        elif element.tag in COUNTED:
            copies = _product(element, ("count",))
            cost = cost.plus(_Cost(copies, copies))
        return cost

    def _largest_model(self, root: ElementTree.Element, folder: Path) -> _Cost:
        """Return a bound of the cost of any model that the file can attach."""
        largest = NOTHING
        for model in root.iter("model"):
            for file in self._files(model, folder):
                cost = self.file(read_xml(file, "an MJCF or URDF file"), file)
                largest = _Cost(max(largest.elements, cost.elements), max(largest.bodies, cost.bodies))
        return largest

    def _files(self, element: ElementTree.Element, folder: Path) -> Iterator[Path]:
        """Yield the files that an element can mean: beside the file that names it, or beside the first."""
        name = element.get("file", "")
        for file in dict.fromkeys(((folder / name).resolve(), (self.folder / name).resolve())):
            if file.is_file():
                yield file
            elif name and file.exists():
                raise ValueError(f"<{element.tag} file={shortened(name)}> is not a regular file")

    def _count_cells(self, element: ElementTree.Element, folder: Path) -> None:
        if element.tag not in CELLS:
            return
        cells = _product(element, CELLS[element.tag])
        if element.tag == "texture" and "height" not in element.attrib:
            cells = min(6 * cells**2, BEYOND_ALL)  # the faces of a cube
        cells = max([cells, *(_png_cells(file) for file in self._files(element, folder))])
        self.cells += cells
        if self.cells > MOST_CELLS:
            raise ValueError(
                f"{_named(element)} has {cells:,} cells, and all have {self.cells:,}: expected at most {MOST_CELLS:,}"
            )


def _check_lengths(element: ElementTree.Element) -> None:
    for attribute in element.attrib:
        most = LENGTHS.get(attribute, LENGTHS_OF.get((element.tag, attribute)))
        if most is not None and _largest_integer(element, attribute) > most:
            raise ValueError(
                f"{_named(element)} has {attribute}={shortened(element.get(attribute))}: expected at most {most:,}"
            )
    if element.tag == "mesh" and "builtin" in element.attrib:
        for value in _numbers(element, "params"):
            if value > LARGEST_PARAMETER:
                raise ValueError(
                    f"{_named(element)} has params={shortened(element.get('params'))}: "
                    f"expected at most {LARGEST_PARAMETER} each"
                )


def _product(element: ElementTree.Element, attributes: tuple[str, ...]) -> int:
    """Return the product of the numbers in some attributes; those below one count as one."""
    values = [value for attribute in attributes for value in _numbers(element, attribute)]
    return min(math.prod(max(math.ceil(value), 1) for value in values), BEYOND_ALL)


def _largest_integer(element: ElementTree.Element, attribute: str) -> int:
    values = _numbers(element, attribute)
    return min(math.ceil(max(values)), BEYOND_ALL) if values else 0


def _numbers(element: ElementTree.Element, attribute: str) -> list[float]:
    try:
        values = [float(word) for word in element.get(attribute, "").split()]
    except ValueError:
        values = [math.nan]
    if not all(map(math.isfinite, values)):
        raise ValueError(
            f"{_named(element)} has {attribute}={shortened(element.get(attribute))}: expected finite numbers"
        )
    return values


def _png_cells(file: Path) -> int:
    """Return the pixels of an image, by its header; 1 for a file that is no PNG."""
    with file.open("rb") as stream:
        header = stream.read(24)
    if not header.startswith(PNG):
        return 1
    return int.from_bytes(header[16:20], "big") * int.from_bytes(header[20:24], "big")


def _named(element: ElementTree.Element) -> str:
    name = element.get("name")
    return f"<{element.tag}>" if name is None else f"<{element.tag} name={shortened(name)}>"


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
