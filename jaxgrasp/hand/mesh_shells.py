"""Closed shells of a triangle mesh: their winding, their nesting, and a check that they do not meet.

The solid of a mesh is where its shells wind once around a point: the volume of an outer shell, less that of cavities
whose triangles face into them. Shells that cross or lie in one another without such a cavity would count twice.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

MEETING = 1e-9
"""Share of a mesh's extent below which an edge and a triangle touch."""
CHUNK = 200_000
"""Pairs of an edge and a triangle that are looked at together."""


class OverlapError(ValueError):
    """Pieces of a mesh that have a part, a face or an edge in common."""


class Edges(NamedTuple):
    """Undirected edges of a mesh, each with its two faces."""

    ends: np.ndarray
    """``(E, 2)`` vertices."""
    faces: np.ndarray
    """``(E, 2)``"""
    is_consistent: np.ndarray
    """``(E,)``: the two faces run along the edge in opposite directions, as neighbours of one winding do."""


def orient_shells(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the faces, wound so that the normals of the solid point out.

    A shell that is wound in two ways is made one, a shell that lies in no other is turned to face out together with all
    that lies in it, and the winding of the others is kept.

    Args:
        vertices: ``(V, 3)``, each of which appears once.
        faces: ``(F, 3)``

    Raises:
        OverlapError: for edges with more than two faces, and shells that cross or touch.
        ValueError: for edges with one face, shells that cannot be wound, and a shell in another that faces the same
            way.
    """
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(1)]  # of two equal corners, without area
    edges = find_edges(vertices, faces)
    count, shell = connected_components(_matrix(edges.faces, len(faces)), directed=False)
    faces, was_mixed = _wind(faces, edges, shell, count)
    if count == 1:
        return faces if _volumes(vertices, faces, shell, 1)[0] >= 0 else faces[:, ::-1]
    _check_apart(vertices, faces, edges, shell)
    return _turn_nested(vertices, faces, shell, count, was_mixed)


def find_edges(vertices: np.ndarray, faces: np.ndarray) -> Edges:
    """Return the edges of a closed mesh.

    Raises:
        OverlapError: for edges with more than two faces.
        ValueError: for edges with one face.
    """
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    owner = np.repeat(np.arange(len(faces)), 3)
    ends, index, counts = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    index = index.ravel()
    single, many = counts == 1, counts > 2
    if many.any():
        raise OverlapError(
            f"{many.sum()} of the mesh's edges have more than two faces, the first has {counts[many][0]}, "
            f"{_between(vertices, ends[many][0])}: expected solids that do not share an edge or a face; unite those "
            "that do, as trimesh.boolean.union does"
        )
    if single.any():
        raise ValueError(
            f"the mesh does not close: {single.sum()} edges have a face on one side only, the first "
            f"{_between(vertices, ends[single][0])}; expected a solid"
        )
    order = np.argsort(index, kind="stable").reshape(-1, 2)
    forward = directed[order, 0] == ends[:, None, 0]
    return Edges(ends, owner[order], forward[:, 0] != forward[:, 1])


def _between(vertices: np.ndarray, ends: np.ndarray) -> str:
    first, second = (", ".join(f"{x:.6g}" for x in vertices[end]) for end in ends)
    return f"from ({first}) to ({second})"


def _matrix(pairs: np.ndarray, size: int) -> Any:
    return coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (size, size)).tocsr()


def _wind(faces: np.ndarray, edges: Edges, shell: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the faces with one winding for each shell, and which shells had two.

    Raises:
        ValueError: for a shell that has none, such as a Klein bottle.
    """
    was_mixed = np.zeros(count, bool)
    was_mixed[shell[edges.faces[~edges.is_consistent, 0]]] = True
    is_flipped = np.zeros(len(faces), bool)
    if was_mixed.any():
        differs = {
            pair: not is_consistent
            for first, second, is_consistent in zip(*edges.faces.T.tolist(), edges.is_consistent.tolist(), strict=True)
            for pair in ((first, second), (second, first))
        }
        graph = _matrix(edges.faces, len(faces))
        for number in np.flatnonzero(was_mixed):
            start = int(np.argmax(shell == number))
            order, predecessor = breadth_first_order(graph, start, directed=False)
            for face in order[1:].tolist():
                is_flipped[face] = is_flipped[predecessor[face]] ^ differs[face, int(predecessor[face])]
        first, second = edges.faces.T
        if np.any((is_flipped[first] ^ is_flipped[second]) == edges.is_consistent):
            raise ValueError("the mesh has a shell with one side only, such as a Klein bottle: expected a solid")
    return np.where(is_flipped[:, None], faces[:, ::-1], faces), was_mixed


def _volumes(vertices: np.ndarray, faces: np.ndarray, shell: np.ndarray, count: int) -> np.ndarray:
    """Compute the signed volumes ``(S,)`` of the shells."""
    a, b, c = np.moveaxis((vertices - vertices.mean(0))[faces], 1, 0)
    return np.bincount(shell, np.einsum("fi,fi->f", a, np.cross(b, c)) / 6, count)


def _check_apart(vertices: np.ndarray, faces: np.ndarray, edges: Edges, shell: np.ndarray) -> None:
    """Raise OverlapError where an edge of one shell meets a triangle of another."""
    edge_shell = shell[edges.faces[:, 0]]
    ends, corners = vertices[edges.ends], vertices[faces]
    middles, centers = ends.mean(1), corners.mean(1)
    halves = np.linalg.norm(ends[:, 0] - middles, axis=1)
    reaches = np.linalg.norm(corners - centers[:, None], axis=2).max(1)
    tolerance = MEETING * float(np.ptp(vertices, axis=0).max())
    near = _near_other_shells(ends, corners, edge_shell, shell, tolerance)
    edge_index = np.flatnonzero(near[0])
    # Triangles of like sizes together, or one large triangle would make all of them candidates.
    size_classes = np.ceil(np.log2(np.maximum(reaches, tolerance)))
    for size_class in np.unique(size_classes[near[1]]):
        triangles = np.flatnonzero(near[1] & (size_classes == size_class))
        tree = cKDTree(centers[triangles])
        for part in np.array_split(edge_index, max(1, len(edge_index) // 1000)):
            lists = tree.query_ball_point(middles[part], halves[part] + reaches[triangles].max() + tolerance)
            edge = np.repeat(part, [len(size_class) for size_class in lists])
            face = triangles[np.concatenate([*lists, []]).astype(int)]
            is_other = edge_shell[edge] != shell[face]
            _check_pairs(vertices, faces, edges.ends, shell, edge_shell, edge[is_other], face[is_other], tolerance)


def _near_other_shells(
    ends: np.ndarray, corners: np.ndarray, edge_shell: np.ndarray, shell: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return which edges and which triangles reach into the box about another shell."""
    count = int(shell.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, shell, corners.min(1))
    np.maximum.at(high, shell, corners.max(1))
    meets = np.all((low[:, None] <= high + tolerance) & (low <= high[:, None] + tolerance), axis=-1)
    np.fill_diagonal(meets, False)
    masks = []
    for points, owner in ((ends, edge_shell), (corners, shell)):
        lowest, highest = points.min(1), points.max(1)
        mask = np.zeros(len(points), bool)
        for number in range(count):
            other_shells = np.flatnonzero(meets[number])
            if len(other_shells):
                inside = (lowest <= high[number] + tolerance) & (highest >= low[number] - tolerance)
                mask |= inside.all(1) & np.isin(owner, other_shells)
        masks.append(mask)
    return masks[0], masks[1]


def _check_pairs(
    vertices: np.ndarray,
    faces: np.ndarray,
    ends: np.ndarray,
    shell: np.ndarray,
    edge_shell: np.ndarray,
    edge: np.ndarray,
    face: np.ndarray,
    tolerance: float,
) -> None:
    for start in range(0, len(edge), CHUNK):
        e, f = edge[start : start + CHUNK], face[start : start + CHUNK]
        # Two shells may share a vertex.
        apart = ~(ends[e][:, :, None] == faces[f][:, None, :]).any((1, 2))
        e, f = e[apart], f[apart]
        meet = _meets(vertices[ends[e]], vertices[faces[f]], tolerance)
        if meet.any():
            i = int(np.argmax(meet))
            first, second = sorted((int(edge_shell[e[i]]), int(shell[f[i]])))
            midpoint = ", ".join(f"{x:.6g}" for x in vertices[ends[e[i]]].mean(0))
            raise OverlapError(
                f"shells {first} and {second} of the mesh overlap or touch near ({midpoint}): their common part "
                "would count twice; unite them, as trimesh.boolean.union does"
            )


def _meets(ends: np.ndarray, corners: np.ndarray, tolerance: float) -> np.ndarray:
    """Tell ``(P,)`` whether edges ``(P, 2, 3)`` reach or cross triangles ``(P, 3, 3)`` (Moller and Trumbore 1997)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    direction = ends[:, 1] - ends[:, 0]
    first, second = b - a, c - a
    across = np.cross(direction, second)
    determinant = np.einsum("pi,pi->p", first, across)
    start = ends[:, 0] - a
    lengths = np.linalg.norm(direction, axis=1)
    area = np.linalg.norm(np.cross(first, second), axis=1)
    parallel = np.abs(determinant) <= 1e-12 * lengths * area
    safe = np.where(parallel, 1.0, determinant)
    u = np.einsum("pi,pi->p", start, across) / safe
    start_cross_first = np.cross(start, first)
    v = np.einsum("pi,pi->p", direction, start_cross_first) / safe
    t = np.einsum("pi,pi->p", second, start_cross_first) / safe
    span = np.sqrt(np.maximum(area, 1e-300))
    slack, reach = tolerance / span, tolerance / np.maximum(lengths, 1e-300)
    inside = (u >= -slack) & (v >= -slack) & (u + v <= 1 + slack)
    return ~parallel & inside & (t >= -reach) & (t <= 1 + reach)


def _turn_nested(
    vertices: np.ndarray, faces: np.ndarray, shell: np.ndarray, count: int, was_mixed: np.ndarray
) -> np.ndarray:
    """Return the faces with outermost shells facing out, each turned with all that lies in it.

    Raises:
        ValueError: where a shell does not face the other way than the shell about it.
    """
    signs = np.sign(_volumes(vertices, faces, shell, count))
    inside = _nesting(vertices, faces, shell, count)
    depth = inside.sum(1)
    turn = np.zeros(count, bool)
    for number in np.argsort(depth):
        around = np.flatnonzero(inside[number])
        if not len(around):
            turn[number] = signs[number] < 0
            signs[number] = 1
            continue
        nearest, outermost = around[np.argmax(depth[around])], around[np.argmin(depth[around])]
        # Of an outermost shell that was wound in two ways, the sign says nothing of those in it.
        turn[number] = turn[outermost] and not was_mixed[outermost]
        signs[number] *= -1 if turn[number] else 1
        if was_mixed[number] or signs[number] == signs[nearest]:
            cause = "is wound in two ways" if was_mixed[number] else "faces the same way"
            raise ValueError(
                f"shell {number} of the mesh lies in shell {nearest} and {cause}: it could be a cavity or a second "
                "solid; expected triangles of a cavity to face into it, and no solid inside a solid"
            )
    return np.where(turn[shell][:, None], faces[:, ::-1], faces)


def _nesting(vertices: np.ndarray, faces: np.ndarray, shell: np.ndarray, count: int) -> np.ndarray:
    """Tell ``(S, S)`` whether the shell of each row lies in that of each column; shells do not cross."""
    inside = np.zeros((count, count), bool)
    triangles = [vertices[faces[shell == number]] for number in range(count)]
    low = np.array([corners.min((0, 1)) for corners in triangles])
    high = np.array([corners.max((0, 1)) for corners in triangles])
    for inner in range(count):
        # The middle of a face, which no other shell touches; a vertex may be shared.
        point = triangles[inner][0].mean(0)
        for outer in np.flatnonzero(np.all((low <= low[inner]) & (high >= high[inner]), axis=1)):
            if outer != inner:
                inside[inner, outer] = abs(winding_number(triangles[outer], point)) > 0.5
    return inside


def winding_number(triangles: np.ndarray, point: np.ndarray) -> float:
    """Return how often triangles ``(F, 3, 3)`` wind around a point (Van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    lengths = [np.linalg.norm(vectors, axis=1) for vectors in (a, b, c)]
    dots = [np.einsum("fi,fi->f", *pair) for pair in ((a, b), (b, c), (c, a))]
    volume = np.einsum("fi,fi->f", a, np.cross(b, c))
    denominator = (
        lengths[0] * lengths[1] * lengths[2] + dots[0] * lengths[2] + dots[1] * lengths[0] + dots[2] * lengths[1]
    )
    return float(np.sum(np.arctan2(volume, denominator)) / (2 * np.pi))
