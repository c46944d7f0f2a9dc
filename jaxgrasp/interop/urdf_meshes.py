"""Collision meshes of a URDF: as MuJoCo reads them, by trimesh where it does not, or left out by name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrasp.interop.left_out import LeftOut
from jaxgrasp.interop.urdf_file import leave_out
from jaxgrasp.validation.optional_library import optional_library

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
        loaded = trimesh.load_mesh(file, process=False)  # or it drops vertices that are no numbers
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
