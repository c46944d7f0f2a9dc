"""Watertight triangle meshes: reading and checking them, and the point of their surface nearest to a given one."""

from __future__ import annotations

import warnings
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxgrasp.files.printable import message_line
from jaxgrasp.model.faults import entries
from jaxgrasp.model.hand import Pose
from jaxgrasp.validation.checked import checked
from jaxgrasp.validation.optional_library import optional_library

MISSING = "meshes need trimesh, manifold3d and scipy: pip install 'jaxgrasp[mesh]'"
CHUNK = 4096
"""Points looked up at a time, which bounds the memory of their candidate triangles."""
FLAT = 1e-9
"""Share of its extent, or volume, below which a solid counts as none."""


class Mesh(NamedTuple):
    """Triangles, wound so that their normals point out."""

    vertices: np.ndarray
    """``(V, 3)`` [m]"""
    faces: np.ndarray
    """``(F, 3)`` indices of vertices."""


class MassProperties(NamedTuple):
    """Volume, centre of mass and inertia of a solid of uniform density."""

    volume: float
    """[m^3]"""
    center: np.ndarray
    """``(3,)`` of mass [m]."""
    inertia: np.ndarray
    """``(3, 3)`` by unit of mass, about the centre of mass [m^2]."""


@checked
def load_mesh(path: Path | str, scale: float = 1.0) -> Mesh:
    """Return the mesh in any file that trimesh reads, checked by [`jaxgrasp.hand.check_mesh`][].

    Solids that overlap or touch, such as the convex pieces of a decomposed object, are united by manifold3d, with a
    warning that says so.

    Args:
        path: of an .obj, .stl, .ply, .off ... file.
        scale: metres for one unit of the file.

    Raises:
        ImportError: without the extra `mesh`.
        FileNotFoundError, ValueError: for a file that is not there, or holds no closed solid, or pieces that overlap
            and are not solids each.
    """
    trimesh = _import_trimesh()
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; expected a mesh")
    try:
        loaded = read_triangles(trimesh, path)
        vertices, faces = np.asarray(loaded.vertices, float), np.asarray(loaded.faces, int)
    except Exception as error:  # readers of many formats fail in as many ways
        raise ValueError(f"{path} cannot be read as a mesh: {error}") from None
    if not (np.isfinite(scale) and scale > 0):
        raise ValueError(f"scale is {scale}: expected a positive number of metres for one unit of the file")
    # Imported here, with SciPy, which those without a mesh do not wait for.
    from jaxgrasp.hand.mesh_shells import OverlapError

    mesh = Mesh(vertices * scale, faces)
    try:
        try:
            return check_mesh(mesh)
        except OverlapError as error:
            united, pieces = _united(trimesh, mesh, error)
            united = check_mesh(united)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    warnings.warn(
        message_line(
            f"{path}: {pieces} pieces of the mesh overlap or touch; they are united to one solid of "
            f"{mass_properties(united).volume:.4g} m^3 (their sum is {_volume_sum(mesh):.4g} m^3)"
        ),
        stacklevel=3,
    )
    return united


def _united(trimesh: Any, mesh: Mesh, error: ValueError) -> tuple[Mesh, int]:
    """Return the union of a mesh's pieces, and their number.

    Raises:
        ImportError: without manifold3d.
        ValueError: the given error, where the pieces are not solids each.
    """
    optional_library("manifold3d", missing=MISSING)
    # By the file's own corners first: pieces that share a face have theirs twice. Some formats repeat every corner.
    for process in (False, True):
        pieces = trimesh.Trimesh(*mesh, process=process).split(only_watertight=False)
        if len(pieces) > 1 and all(piece.is_watertight and piece.is_winding_consistent for piece in pieces):
            break
    else:
        raise error
    inward = [piece.volume < 0 for piece in pieces]
    if any(inward) and not all(inward):
        # A cavity is no solid to be united.
        raise error
    for piece in pieces if all(inward) else ():
        piece.invert()
    union = trimesh.boolean.union(list(pieces), engine="manifold")
    return Mesh(np.asarray(union.vertices, float), np.asarray(union.faces, int)), len(pieces)


def _volume_sum(mesh: Mesh) -> float:
    return abs(float(_import_trimesh().Trimesh(*mesh, process=False).volume))


@checked
def check_mesh(mesh: Mesh) -> Mesh:
    """Return the mesh, wound outwards.

    The winding of shells inside others is kept, so that a cavity stays one; a shell that lies in no other is turned
    outwards together with all that lies in it.

    Raises:
        ImportError: without the extra `mesh`.
        ValueError: for a mesh that does not close around a volume, has a vertex that is no finite number, an edge with
            more than two faces, shells that overlap or touch, or a shell inside another that faces the same way.
    """
    trimesh = _import_trimesh()
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(
            f"vertices and faces have shapes {vertices.shape} and {faces.shape}: expected (V, 3) and (F, 3)"
        )
    if not len(vertices) or not len(faces):
        raise ValueError(f"the mesh has {len(vertices)} vertices and {len(faces)} faces: expected a closed surface")
    strange = (faces < 0) | (faces >= len(vertices))
    for fault in chain(
        entries("vertices", vertices, ~np.isfinite(vertices), "a finite number [m]"),
        entries("faces", faces, strange, f"the index of one of {len(vertices)} vertices"),
    ):
        raise ValueError(str(fault))
    if np.linalg.matrix_rank(vertices - vertices[0], tol=FLAT * np.ptp(vertices, axis=0).max()) < 3:
        raise ValueError("the mesh is flat: expected a solid, which can be touched")
    solid = trimesh.Trimesh(vertices, faces)  # merges vertices that formats like .stl repeat
    vertices, faces = np.asarray(solid.vertices, float), np.asarray(solid.faces, int)
    # Imported here, with SciPy, which those without a mesh do not wait for.
    from jaxgrasp.hand.mesh_shells import orient_shells

    solid = trimesh.Trimesh(vertices, orient_shells(vertices, faces), process=False)
    if not solid.volume > FLAT * float(np.prod(solid.extents)):
        raise ValueError(f"the mesh has a volume of {solid.volume:.3g} m^3: expected a solid, which can be touched")
    return Mesh(np.asarray(solid.vertices, float), np.asarray(solid.faces, int))


def mass_properties(mesh: Mesh) -> MassProperties:
    """Compute the volume, the centre of mass, and the inertia about it, of a checked mesh."""
    solid = _import_trimesh().Trimesh(*mesh, process=False)
    return MassProperties(
        float(solid.volume), np.asarray(solid.center_mass), np.asarray(solid.moment_inertia) / solid.volume
    )


@checked
def principal_frame(mesh: Mesh) -> tuple[Mesh, Pose]:
    """Return the mesh in the frame of its principal axes at its centre of mass, and this frame's pose in the old.

    The z axis is the longest, that of the least moment of inertia, and y the shortest.
    """
    _, center, inertia = mass_properties(mesh)
    # Moments ascend: of the longest, the middle and the shortest axis.
    axes = np.linalg.eigh(inertia)[1][:, [1, 2, 0]]
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return Mesh((mesh.vertices - center) @ axes, mesh.faces), Pose(center, axes)


def sample_surface(mesh: Mesh, count: int, seed: int) -> np.ndarray:
    """Sample points ``(count, 3)`` evenly over the surface."""
    trimesh = _import_trimesh()
    return np.asarray(trimesh.sample.sample_surface(trimesh.Trimesh(*mesh, process=False), count, seed=seed)[0])


class NearestPoints(NamedTuple):
    """Distance of a surface, its nearest point and its normal there, for each point of a batch."""

    distance: np.ndarray
    """``(P,)``: to the surface, negative inside [m]."""
    foot: np.ndarray
    """``(P, 3)``: its nearest point."""
    normal: np.ndarray
    """``(P, 3)``: a way out at the foot, of any length; at an edge between those of its faces."""


class MeshSurface:
    """Exact search for the nearest points of a checked mesh.

    The mesh is cut into triangles no longer than ``size``. The nearest of their centres bounds the distance, and
    with it which triangles can hold the nearest point.
    """

    def __init__(self, mesh: Mesh, size: float):
        self._trimesh = _import_trimesh()
        solid = self._trimesh.Trimesh(*mesh, process=False).subdivide_to_size(size, max_iter=20)
        self._solid = self._trimesh.Trimesh(solid.vertices, solid.faces)
        self._triangles = np.asarray(self._solid.triangles)
        self._centers = self._triangles.mean(1)
        self._reach = float(np.linalg.norm(self._triangles - self._centers[:, None], axis=-1).max())

    @cached_property
    def _tree(self) -> Any:
        return optional_library("scipy.spatial", missing=MISSING).cKDTree(self._centers)

    def nearest(self, points: np.ndarray) -> NearestPoints:
        """Compute the distances and feet of points ``(P, 3)``."""
        parts = [self._nearest(points[i : i + CHUNK]) for i in range(0, len(points), CHUNK)]
        return NearestPoints(*map(np.concatenate, zip(*parts, strict=True)))

    def _nearest(self, points: np.ndarray) -> NearestPoints:
        bound, _ = self._tree.query(points)
        lists = self._tree.query_ball_point(points, bound + self._reach * (1 + 1e-9), return_sorted=False)
        sizes = np.array([len(candidates) for candidates in lists])
        triangles, owners = np.concatenate(lists).astype(int), np.repeat(np.arange(len(points)), sizes)
        feet = self._trimesh.triangles.closest_point(self._triangles[triangles], points[owners])
        distances = np.linalg.norm(feet - points[owners], axis=1)
        order = np.lexsort((distances, owners))
        best = order[np.concatenate([[0], np.cumsum(sizes)[:-1]])]
        foot, triangle, distance = feet[best], triangles[best], distances[best]
        offset = points - foot
        normal = self._pseudonormal(foot, triangle)
        outside = np.einsum("pi,pi->p", offset, normal) >= 0
        return NearestPoints(np.where(outside, distance, -distance), foot, normal)

    def _pseudonormal(self, foot: np.ndarray, triangle: np.ndarray) -> np.ndarray:
        """Compute the vector at the foot whose side tells inside from outside: of the face, the edge, or the vertex.

        At an edge or a vertex no single face's normal tells it (Baerentzen and Aanaes 2005).
        """
        corners = self._solid.faces[triangle]
        weights = self._trimesh.triangles.points_to_barycentric(self._triangles[triangle], foot)
        at = weights > 1e-9
        count = at.sum(1)
        normal = np.array(self._solid.face_normals[triangle])
        edge = count == 2
        normal[edge] = self._edge_normals(triangle[edge], np.argmin(weights[edge], 1))
        corner = count == 1
        normal[corner] = self._solid.vertex_normals[corners[corner, np.argmax(weights[corner], 1)]]
        return normal

    def _edge_normals(self, triangle: np.ndarray, opposite: np.ndarray) -> np.ndarray:
        """Return the sum of both faces' normals at the edge of a triangle opposite a corner."""
        return self._edge_sums[triangle, opposite]

    @cached_property
    def _edge_sums(self) -> np.ndarray:
        faces, normals = np.asarray(self._solid.faces), np.asarray(self._solid.face_normals)
        # Edge k lies opposite corner k.
        endpoints = np.sort(np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], 1), -1).reshape(-1, 2)
        _, edge = np.unique(endpoints, axis=0, return_inverse=True)
        sums = np.zeros((edge.max() + 1, 3))
        np.add.at(sums, edge.ravel(), np.repeat(normals, 3, axis=0))
        return sums[edge.ravel()].reshape(-1, 3, 3)


def read_triangles(trimesh: Any, path: Path) -> Any:
    """Read a mesh file by trimesh as it stands, also with vertices that are no numbers; errors are trimesh's own."""
    with warnings.catch_warnings():
        # Its readers use what newer versions of NumPy deprecate: nothing that a user could mend.
        warnings.simplefilter("ignore", DeprecationWarning)
        return trimesh.load_mesh(path, process=False)


def _import_trimesh() -> Any:
    return optional_library("trimesh", missing=MISSING)
