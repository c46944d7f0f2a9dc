"""The surfaces of hand, object and table as triangles, each in its body's own frame, and an arrow's."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.hand.mesh import Mesh
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Shifted, Sphere
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.model.hand import Hand, Pose
from jaxgrasp.report.grasp_in_3d import across

SIDES = 16
"""Directions around a link; there are half as many from its one end to the other."""
ROUND = 48
"""Corners of a cylinder's rim."""
BALL_SIDES = 8
"""Directions around each of the many balls that stand for a mesh."""
ARROW_SIDES = 8
SHAFT, HEAD = 0.13, 0.36
"""Radii of an arrow, as shares of its head's length."""


class DrawnSurface(NamedTuple):
    """Triangles, and lines over them, which show the rotation of a round body."""

    corners: np.ndarray
    """``(V, 3)`` [m]"""
    faces: np.ndarray
    """``(F, 3)`` indices of corners, counter-clockwise from outside."""
    lines: np.ndarray = np.zeros((0, 3))
    """``(E, 3)`` [m]: each line is ended by NaN."""


def link_surfaces(hand: Hand) -> list[DrawnSurface]:
    """Return the surface of each link, in the link's frame: the hull of its skin's spheres."""
    centers, radii = np.asarray(hand.skin.centers), np.asarray(hand.skin.radii)
    return [hull(link_centers, sizes) for link_centers, sizes in zip(centers, radii, strict=True)]


def hull(centers: np.ndarray, radii: np.ndarray, sides: int = SIDES) -> DrawnSurface:
    """Return the convex hull of spheres from its support points in all directions. Spheres of radius 0 are ignored."""
    centers, radii = centers[radii > 0], radii[radii > 0]
    if not len(radii):
        return DrawnSurface(np.zeros((0, 3)), np.zeros((0, 3), int))
    axis = centers[np.linalg.norm(centers - centers[0], axis=1).argmax()] - centers[0]
    size = np.linalg.norm(axis)
    directions, faces = _globe(axis / size if size > 0 else np.array([0.0, 0.0, 1.0]), sides)
    touched = (centers @ directions.T + radii[:, None]).argmax(0)
    return DrawnSurface(centers[touched] + radii[touched, None] * directions, faces)


def shape_surface(shape: Shape) -> DrawnSurface:
    """Return the surface of a shape, in the object's frame.

    Raises:
        TypeError: for a shape that has no triangles here.
    """
    match shape:
        case Sphere(radius=radius):
            return _rounded(float(radius), 0.0)
        case Capsule(radius=radius, height=height):
            return _rounded(float(radius), float(height))
        case Cylinder(radius=radius, height=height):
            return _prism(float(radius) * circle(ROUND), float(height), ROUND // 4)
        case Box(length=length, width=width, height=height):
            square = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
            return _prism(square * [float(length) / 2, float(width) / 2], float(height), 1)
        case Shifted(solid=solid, x=x, y=y, z=z):
            surface, shift = shape_surface(solid), np.array([x, y, z], float)
            return surface._replace(corners=surface.corners + shift, lines=surface.lines + shift)
        case SphereTree(balls=balls):
            return _balls(np.asarray(balls.centers), np.asarray(balls.radii))
    raise TypeError(f"a {type(shape).__name__} cannot be drawn")


def mesh_surface(mesh: Mesh) -> DrawnSurface:
    """Return the surface of a mesh, with its vertices [m] and faces unchanged."""
    return DrawnSurface(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, int))


def arrow() -> DrawnSurface:
    """Return the template of an arrow: two coordinates across it, the share of its length, the share of its head.

    A corner (u, v, s, h) stands at tail + size (u e1 + v e2) + (s length + h size) d for an arrow along d, whose
    head has the length ``size``.
    """
    ring = circle(ARROW_SIDES)
    profile = [(SHAFT, 0, 0), (SHAFT, 1, -1), (HEAD, 1, -1), (0, 1, 0)]
    rings = [np.column_stack([radius * ring, np.tile([s, h], (ARROW_SIDES, 1))]) for radius, s, h in profile]
    return DrawnSurface(np.concatenate(rings), bands(len(profile), ARROW_SIDES))


def arrows(tails: np.ndarray, vectors: np.ndarray, head: float) -> DrawnSurface:
    """Return arrows from their tails, as long as their vectors; heads at most ``head`` [m] and half an arrow long."""
    template = arrow()
    lengths = np.linalg.norm(vectors, axis=1)
    tails, vectors, lengths = tails[lengths > 0], vectors[lengths > 0], lengths[lengths > 0]
    directions = vectors / lengths[:, None]
    first, second = across(directions)
    sizes = np.minimum(head, lengths / 2)
    u, v, s, h = template.corners.T[:, :, None]
    corners = sizes[:, None] * (u[..., None] * first + v[..., None] * second)
    corners = tails + corners + (s * lengths + h * sizes)[..., None] * directions
    count = len(template.corners)
    faces = template.faces + count * np.arange(len(tails))[:, None, None]
    return DrawnSurface(corners.swapaxes(0, 1).reshape(-1, 3), faces.reshape(-1, 3))


def pose_matrix(pose: Pose) -> np.ndarray:
    """Convert poses to matrices ``(..., 3, 4)``: rotation and, as the last column, origin."""
    return np.concatenate([np.asarray(pose.rotation), np.asarray(pose.origin)[..., None]], -1)


def placed(corners: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Transform corners ``(V, 3)`` of a body to the world by poses ``(..., 3, 4)``."""
    return corners @ pose[..., :3].swapaxes(-1, -2) + pose[..., None, :, 3]


def move_surface(surface: DrawnSurface, pose: np.ndarray) -> DrawnSurface:
    """Transform a body's surface to the world by the body's pose ``(3, 4)``."""
    return surface._replace(corners=placed(surface.corners, pose), lines=placed(surface.lines, pose))


def _balls(centers: np.ndarray, radii: np.ndarray) -> DrawnSurface:
    unit_ball = hull(np.zeros((1, 3)), np.ones(1), BALL_SIDES)
    corners = centers[:, None] + radii[:, None, None] * unit_ball.corners
    faces = unit_ball.faces + len(unit_ball.corners) * np.arange(len(radii))[:, None, None]
    return DrawnSurface(corners.reshape(-1, 3), faces.reshape(-1, 3))


def _globe(axis: np.ndarray, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Return directions over the unit sphere, in rings about an axis, and the triangles between them."""
    first, second = across(axis[None])
    ring, rings = circle(sides), sides // 2
    around = ring[:, :1] * first + ring[:, 1:] * second
    slopes = np.pi * (np.arange(rings) + 0.5) / rings
    # The poles are rings of no size.
    slopes = np.concatenate([[np.pi], slopes[::-1], [0.0]])[:, None, None]
    directions = np.cos(slopes) * axis + np.sin(slopes) * around
    return directions.reshape(-1, 3), bands(rings + 2, sides)


def bands(rings: int, sides: int) -> np.ndarray:
    """Return the triangles between successive rings of corners, counter-clockwise seen from outside."""
    at = np.arange(sides)
    after = (at + 1) % sides
    band = np.concatenate(
        [np.column_stack([at, after, after + sides]), np.column_stack([at, after + sides, at + sides])]
    )
    return (band + sides * np.arange(rings - 1)[:, None, None]).reshape(-1, 3)


def circle(count: int) -> np.ndarray:
    """Return points ``(count, 2)`` around a circle of radius 1."""
    angles = 2 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _rounded(radius: float, height: float) -> DrawnSurface:
    """Return a capsule about z, with two meridians and the rims of its straight part as lines."""
    ends = np.array([[0, 0, -height / 2], [0, 0, height / 2]])
    skin = hull(ends, np.full(2, radius), ROUND)
    ring = circle(ROUND)
    flat = np.zeros(ROUND)
    rims = [radius * np.column_stack([ring, flat]) + end for end in (ends if height else ends[:1])]
    upper = np.where(ring[:, 1] >= 0, height / 2, -height / 2)
    meridians = [
        np.column_stack([radius * ring[:, 0] * x, radius * ring[:, 0] * y, radius * ring[:, 1] + upper])
        for x, y in ((1, 0), (0, 1))
    ]
    return skin._replace(lines=_closed([*rims, *meridians]))


def _prism(outline: np.ndarray, height: float, edge_step: int) -> DrawnSurface:
    """Extrude an outline along z, with its edges; sides and ends share no corners, so that edges look sharp."""
    count = len(outline)
    at, after = np.arange(count), (np.arange(count) + 1) % count
    low, high = (np.column_stack([outline, np.full(count, z)]) for z in (-height / 2, height / 2))
    sides = np.stack([low, low[after], high[after], high], 1).reshape(-1, 3)
    fours = 4 * at[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    fan = np.column_stack([np.zeros(count - 2, int), at[1:-1], at[2:]])
    faces = [fours.reshape(-1, 3), 4 * count + fan[:, ::-1], 5 * count + fan]
    posts = [np.stack([low[i], high[i], np.full(3, np.nan)]) for i in range(0, count, edge_step)]
    return DrawnSurface(
        np.concatenate([sides, low, high]), np.concatenate(faces), np.vstack([_closed([low, high]), *posts])
    )


def _closed(lines: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([np.vstack([line, line[:1], np.full((1, 3), np.nan)]) for line in lines])
