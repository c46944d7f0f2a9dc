"""A robot's hand out of a URDF file, as ROS packages have it: MuJoCo compiles it, and its hinges become a Hand's.

MuJoCo rather than yourdfpy: its fit of meshes gives a hand's capsules, and MJCF is read by the same code. What it
refuses and a Hand does not need is left out before.

A URDF file as it is before MuJoCo reads it: faults that have a name, and parts that a Hand does not need.

MuJoCo refuses a whole file for the inertia of one link, and says neither that a file is a xacro nor which name is there
twice. A Hand has no inertia, and needs of a link no more than what touches.

Collision meshes of a URDF: as MuJoCo reads them, by trimesh where it does not, or left out by name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrasp.files.printable import printable, shortened
from jaxgrasp.hand.mesh import read_triangles
from jaxgrasp.interop.model_file import LeftOut, how_to_expand, read_xml
from jaxgrasp.interop.mujoco_contacts import import_mujoco
from jaxgrasp.interop.mujoco_hand import MujocoHand, hand_from_mujoco
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import optional_library

if TYPE_CHECKING:
    import mujoco

KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
MOST_LINKS = 2_000
"""So many take MuJoCo two seconds, and the time grows with the third power."""
SIZES = {"sphere": ("radius",), "box": ("size",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}
"""Shapes of URDF, and the attributes that have to be positive."""
INERTIA = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def read_urdf(path: Path) -> ElementTree.Element:
    """Return the ``robot`` element of a URDF file whose links and joints make a tree.

    Raises:
        ValueError: for a file that is no URDF or is not there, a xacro, a name that two links or two joints have, a
            joint of an unknown type or without its links, and a link that hangs on two others or on itself.
        OSError: for a file that cannot be read.
    """
    robot = read_xml(path, "a URDF file")
    if robot.tag != "robot":
        raise ValueError(
            f"path is {str(path)!r}: expected a URDF file, whose root is <robot>, not <{printable(robot.tag)[:80]}>"
        )
    try:
        _check_expanded(robot, path)
        _check_names(robot)
        _check_tree(robot)
    except ValueError as error:
        raise ValueError(f"path is {str(path)!r}: {error}") from None
    return robot


def _check_expanded(robot: ElementTree.Element, path: Path) -> None:
    for element in robot.iter():
        namespace, _, tag = element.tag.rpartition("}")
        if "xacro" in namespace:
            raise ValueError(f"it has the element <xacro:{printable(tag)[:80]}>: {how_to_expand(path)}")
        for key, value in element.attrib.items():
            if "${" in value or "$(" in value:
                raise ValueError(f"<{element.tag}> has {key}={shortened(value)}: {how_to_expand(path)}")


def _check_names(robot: ElementTree.Element) -> None:
    for tag in ("link", "joint"):
        elements = robot.findall(tag)
        if len(elements) > MOST_LINKS:
            raise ValueError(f"it has {len(elements):,} {tag}s: expected at most {MOST_LINKS:,}")
        for name, count in Counter(element.get("name") for element in elements).items():
            if name is None:
                raise ValueError(f"it has a {tag} without a name: expected one for each")
            if count > 1:
                raise ValueError(f"{count} {tag}s have the name {shortened(name)}: expected different names")


def _check_tree(robot: ElementTree.Element) -> None:
    links = {link.get("name") for link in robot.iterfind("link")}
    parents: dict[str, str] = {}
    for joint in robot.iterfind("joint"):
        name = shortened(joint.get("name"))
        if joint.get("type") not in KINDS:
            raise ValueError(f"joint {name} has the type {joint.get('type')!r}: expected one of {', '.join(KINDS)}")
        ends = {}
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link not in links:
                raise ValueError(f"joint {name} has the {end} {shortened(link)}: expected the name of a link")
            ends[end] = str(link)
        if ends["child"] in parents:
            raise ValueError(f"joint {name} has the child {ends['child']!r}, which hangs on another joint already")
        parents[ends["child"]] = ends["parent"]
    rooted = links - parents.keys()
    for link in parents:
        trail = [link]
        while trail[-1] not in rooted:
            trail.append(parents[trail[-1]])
            if len(trail) > len(links):
                raise ValueError(f"link {trail[-1]!r} hangs on itself: expected a tree of links")
        rooted.update(trail)


def drop_impossible_inertias(robot: ElementTree.Element) -> Iterator[LeftOut]:
    """Take out masses and inertias that no body can have, and name them: MuJoCo then makes its own of the shapes."""
    for link in robot.iterfind("link"):
        for inertial in link.findall("inertial"):
            fault = _inertia_fault(inertial)
            if fault:
                link.remove(inertial)
                yield LeftOut(
                    f"inertia of link {link.get('name', '')!r}", f"{fault}: a Hand needs none, the model's is made up"
                )


def _inertia_fault(inertial: ElementTree.Element) -> str | None:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None:
        return "it has no mass"
    try:
        value = float(mass.get("value", ""))
        entries = [0.0] * 6 if inertia is None else [float(inertia.get(key, "")) for key in INERTIA]
    except ValueError:
        return "one of its entries is not a number"
    if not np.isfinite([value, *entries]).all():
        return "one of its entries is not a finite number"
    if value < 0:
        return f"the mass is {value:g} kg"
    xx, yy, zz, xy, xz, yz = entries
    least = float(np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))[0])
    # MuJoCo raises what rounding makes slightly negative, such as zero inertias.
    return f"its least principal moment is {least:.3g} kg m^2" if least < -1e-12 else None


def drop_impossible_shapes(robot: ElementTree.Element, keep_going: bool) -> Iterator[LeftOut]:
    """Check sizes of shapes; with ``keep_going`` take out those that have no volume, and name them.

    Raises:
        ValueError: for the first such shape unless ``keep_going``.
    """
    for link in robot.iterfind("link"):
        for collision in link.findall("collision"):
            for shape in collision.iterfind("geometry/*"):
                fault = _size_fault(shape)
                if fault:
                    part = f"{shape.tag} of link {link.get('name', '')!r}"
                    leave_out(link, collision, LeftOut(part, fault, missing=True), keep_going)
                    yield LeftOut(part, fault, missing=True)
                    break


def _size_fault(shape: ElementTree.Element) -> str | None:
    for key in SIZES.get(shape.tag, ()):
        text = shape.get(key, "")
        try:
            sizes = [float(word) for word in text.split()]
        except ValueError:
            sizes = []
        if not sizes or not all(np.isfinite(size) and size > 0 for size in sizes):
            return f"its {key} is {shortened(text)}: expected positive numbers [m]"
    return None


def leave_out(link: ElementTree.Element, collision: ElementTree.Element, note: LeftOut, keep_going: bool) -> None:
    """Take a shape out of its link, or raise ValueError unless ``keep_going``."""
    if not keep_going:
        raise ValueError(f"{note}; keep_going=True leaves it out")
    link.remove(collision)


PACKAGE = "package://"
OWN_FORMATS = (".obj", ".stl", ".msh")
"""Formats that MuJoCo reads."""
MISSING = "Collada and other formats that MuJoCo does not read need trimesh and pycollada: pip install 'jaxgrasp[mesh]'"


class Triangles(NamedTuple):
    """Mesh that MuJoCo cannot read from its file."""

    vertices: np.ndarray
    """``(V, 3)`` [unit of the URDF's scale]"""
    faces: np.ndarray
    """``(F, 3)``"""


class UrdfMeshes:
    """Finds the collision meshes of a URDF and tries each in MuJoCo, alone."""

    def __init__(self, mujoco: Any, path: Path) -> None:
        self.mujoco, self.path = mujoco, path
        self.converted: dict[str, Triangles] = {}
        """Meshes that MuJoCo cannot read, by the name of the file."""
        self._faults: dict[tuple[str, str], str | None] = {}

    def prepare(self, robot: ElementTree.Element, keep_going: bool) -> Iterator[LeftOut]:
        """Write into the links where their meshes are, and yield what becomes of each.

        Raises:
            ValueError: for the first mesh that is not there or cannot be used, unless ``keep_going``.
        """
        for link in robot.iterfind("link"):
            for collision in link.findall("collision"):
                for mesh in collision.findall("geometry/mesh"):
                    yield self._prepare(link, collision, mesh, keep_going)

    def _prepare(
        self, link: ElementTree.Element, collision: ElementTree.Element, mesh: ElementTree.Element, keep_going: bool
    ) -> LeftOut:
        name = mesh.get("filename", "")
        part = f"mesh {name!r} of link {link.get('name', '')!r}"
        try:
            file = _mesh_file(self.path, link.get("name", ""), name)
        except ValueError as error:
            if not keep_going:
                raise
            link.remove(collision)
            return LeftOut(part, str(error).rpartition(": ")[2], missing=True)
        mesh.set("filename", str(file))
        fault = self._fault(file, mesh.get("scale", "1 1 1"))
        if fault:
            note = LeftOut(part, fault, missing=True)
            leave_out(link, collision, note, keep_going)
            return note
        return LeftOut(part, "touches as a capsule of the same inertia")

    def _fault(self, file: Path, scale: str) -> str | None:
        """Return why a mesh cannot touch; None where it can, if need be as triangles that trimesh reads."""
        key = (str(file), scale)
        if key not in self._faults:
            self._faults[key] = self._try(file, scale)
        return self._faults[key]

    def _try(self, file: Path, scale: str) -> str | None:
        try:
            factors = [float(word) for word in scale.split()]
        except ValueError:
            factors = []
        if len(factors) != 3 or not all(np.isfinite(factors)) or 0 in factors:
            return f"its scale is {scale!r}: expected three numbers other than zero"
        fault: str | None = "MuJoCo does not read the format"
        if str(file) not in self.converted:
            if file.suffix.lower() in OWN_FORMATS:
                fault = self._compiled(factors, file, None)
                if fault is None:
                    return None
            try:
                self.converted[str(file)] = _triangles(file)
            except ImportError as error:
                return f"{fault}; {error}"
            except ValueError as error:
                return str(error)
        triangles = self.converted[str(file)]
        spans = np.ptp(triangles.vertices, axis=0)
        centered = triangles.vertices - triangles.vertices.mean(0)
        if np.linalg.matrix_rank(centered, tol=1e-9 * spans.max()) < 3:
            return "it is flat: expected a solid, which can touch"
        return self._compiled(factors, file, triangles)

    def _compiled(self, scale: list[float], file: Path, triangles: Triangles | None) -> str | None:
        """Return what MuJoCo says against the mesh; None where it fits a capsule to it."""
        spec = self.mujoco.MjSpec()
        mesh = spec.add_mesh(name="mesh", scale=scale)
        fill(mesh, file, triangles)
        spec.worldbody.add_geom(type=self.mujoco.mjtGeom.mjGEOM_CAPSULE, meshname="mesh")
        try:
            spec.compile()
        except (ValueError, RuntimeError, MemoryError) as error:
            return f"MuJoCo says: {' '.join(str(error).split()).removeprefix('Error: ').partition(' Element name')[0]}"
        return None


def fill(mesh: Any, file: Path, triangles: Triangles | None) -> None:
    """Give a mesh of an MjSpec its file, or the triangles in place of it."""
    if triangles is None:
        mesh.file = str(file)
        return
    mesh.file = ""
    mesh.uservert = triangles.vertices.ravel()
    mesh.userface = triangles.faces.ravel()


def _triangles(file: Path) -> Triangles:
    """Return the mesh in a file, as trimesh reads it; Collada in metres, by the unit that it says.

    Raises:
        ImportError: without the extra `mesh`.
        ValueError: for a file that trimesh cannot read, or that holds no triangles.
    """
    modules = ("trimesh", "collada") if file.suffix.lower() in (".dae", ".zae") else ("trimesh",)
    trimesh = optional_library(*modules, missing=MISSING)
    try:
        loaded = read_triangles(trimesh, file)
        vertices, faces = np.asarray(loaded.vertices, float), np.asarray(loaded.faces, np.int32)
        if len(modules) > 1 and loaded.units:
            vertices = vertices * trimesh.units.unit_conversion(loaded.units, "meters")
    except Exception as error:  # readers of many formats fail in as many ways
        raise ValueError(f"trimesh cannot read it: {' '.join(str(error).split())}") from None
    if not len(faces):
        raise ValueError("it holds no triangles")
    for index in np.flatnonzero(~np.isfinite(vertices).all(1))[:1]:
        raise ValueError(f"its vertex {index} is {vertices[index].tolist()}: expected finite numbers")
    return Triangles(vertices, faces)


def _mesh_file(path: Path, link: str, name: str) -> Path:
    """Return where a mesh is that the file names."""
    folder = path.resolve().parent
    if name.startswith(PACKAGE):
        package, _, relative = name.removeprefix(PACKAGE).partition("/")
        candidates = [above / relative for above in (folder, *folder.parents) if above.name == package]
        expected_folder = f"below a folder {package!r} that holds the URDF"
    else:
        candidates, expected_folder = [folder / name.removeprefix("file://")], "beside the URDF"
    for file in candidates:
        if file.is_file():
            return file
    raise ValueError(f"link {link!r} has the mesh {name!r}: expected that file {expected_folder}, but there is none")


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
