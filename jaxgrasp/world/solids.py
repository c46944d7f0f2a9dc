"""Convex solids in NumPy: their support functions, and the contact manifold of two of them, or of one with a table.

The plane between two solids is that of the largest gap over the directions that can be optimal: normals of faces, cross
products of edges, and directions towards corners, axes and balls. The manifold is the intersection of the features that
the two solids reach it with; where a face or an edge leans towards the other solid, each of its points has its own gap.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Sphere
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.numerics.geometry import tangents

FLAT = 1e-4
"""Least tolerance of the support feature: points that reach less far than the furthest by at most that belong to it
[m]."""
SIDES = 16
"""Corners of the polygon that stands for a cylinder's round face."""
CORNERS = np.array(list(np.ndindex(2, 2, 2))) - 0.5
THIN = 1e-6
"""Half the width given to a line or a point [m]."""
COINCIDENT = 1e-5
"""Distance below which points coincide [m]."""
MAX_POINTS = 8
"""Largest number of outermost points of a manifold; the closest is one more where it is not among them."""
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
CLOSEST = 8
"""Number of the shortest vectors between two solids that are candidate directions."""
ARC = 0.1
"""Largest 1 - cos of the angle on a rim between its support point and those beside it."""
STARTS = 4
"""Number of the best directions that are improved, where there is a rim."""
STEPS = 0.2 * 0.7 ** np.arange(24)
"""Step lengths of the improvement of a direction."""
TIE = 1e-9
"""Margin by which the gap across two edges must exceed that of a face [m]."""


Entry = TypeVar("Entry")


class Solid(ABC):
    """A convex solid at a pose."""

    has_rim = False
    """True if the solid has a curved edge."""

    def __init__(self, placed: Pose):
        self.origin = np.asarray(placed.origin, float)
        self.rotation = np.asarray(placed.rotation, float)

    def feature(self, direction: np.ndarray, within: float = FLAT) -> np.ndarray:
        """Return the support feature ``(k, 3)`` in the world: corners of a face, ends of an edge, or one point, which
        reach less far than the furthest by at most ``within`` [m]."""
        return self.origin + self._local_feature(direction @ self.rotation, within) @ self.rotation.T

    @abstractmethod
    def _local_feature(self, direction: np.ndarray, within: float) -> np.ndarray:
        """Return the support feature in the solid's own frame."""

    @abstractmethod
    def reach(self, directions: np.ndarray) -> np.ndarray:
        """Return the support function from the origin along directions ``(n, 3)`` in the world [m]."""

    @abstractmethod
    def extent(self) -> float:
        """Return the radius of a ball about the origin that encloses the solid [m]."""

    def axes(self) -> np.ndarray:
        """Return the normals ``(n, 3)`` of flat faces, which are directions of edges too."""
        return np.zeros((0, 3))

    @abstractmethod
    def key_points(self) -> np.ndarray:
        """Return points ``(n, 3)`` in the world that may be closest to another solid: corners, or centres of round
        parts."""

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """Return the points ``(n, 3)`` of the solid closest to given points in the world; for a round solid, points of
        its core."""
        return self.origin + self._local_nearest((points - self.origin) @ self.rotation) @ self.rotation.T

    @abstractmethod
    def _local_nearest(self, points: np.ndarray) -> np.ndarray:
        """Return the closest points in the solid's own frame."""


class BallSolid(Solid):
    """Convex hull of balls: a sphere, a capsule, or a tree's balls."""

    def __init__(self, placed: Pose, centers: np.ndarray, radii: np.ndarray):
        super().__init__(placed)
        self._centers, self._radii = centers, radii

    def _local_feature(self, direction: np.ndarray, within: float) -> np.ndarray:
        # Balls whose hull is curved are one height: no plane goes through their points.
        along = self._centers @ direction + self._radii
        is_support = along >= along.max() - FLAT
        return self._centers[is_support] + self._radii[is_support, None] * direction

    def reach(self, directions: np.ndarray) -> np.ndarray:
        return (directions @ self.rotation @ self._centers.T + self._radii).max(1)

    def extent(self) -> float:
        return float((np.linalg.norm(self._centers, axis=1) + self._radii).max())

    def key_points(self) -> np.ndarray:
        return self.origin + self._centers @ self.rotation.T

    def _local_nearest(self, points: np.ndarray) -> np.ndarray:
        distances = np.linalg.norm(points[:, None] - self._centers, axis=-1) - self._radii
        return self._centers[np.argmin(distances, 1)]


class BoxSolid(Solid):
    """A box with these edges [m]."""

    def __init__(self, placed: Pose, edges: np.ndarray):
        super().__init__(placed)
        self._corners = CORNERS * edges

    def _local_feature(self, direction: np.ndarray, within: float) -> np.ndarray:
        # The axes of a face or an edge: the fall of its points along the direction is at most ``within``.
        falls = np.abs(2 * self._corners[-1] * direction)
        across = np.argsort(falls)
        across = across[across != np.argmax(np.abs(direction))]
        is_free = np.zeros(3, bool)
        is_free[across[np.cumsum(falls[across]) <= within]] = True
        return self._corners[np.all(is_free | (self._corners * direction >= 0), 1)]

    def reach(self, directions: np.ndarray) -> np.ndarray:
        return (directions @ self.rotation @ self._corners.T).max(1)

    def extent(self) -> float:
        return float(np.linalg.norm(self._corners[0]))

    def axes(self) -> np.ndarray:
        return self.rotation.T

    def key_points(self) -> np.ndarray:
        return self.origin + self._corners @ self.rotation.T

    def _local_nearest(self, points: np.ndarray) -> np.ndarray:
        return np.clip(points, self._corners[0], self._corners[-1])


class RoundSolid(Solid):
    """A solid of revolution about its own z axis: a cylinder or a capsule."""

    def __init__(self, placed: Pose, radius: float, height: float):
        super().__init__(placed)
        self._radius, self._half = radius, height / 2

    def axes(self) -> np.ndarray:
        return self.rotation.T[2:]

    def key_points(self) -> np.ndarray:
        return self.origin + np.array([-self._half, 0, self._half])[:, None] * self.rotation[:, 2]


class CapsuleSolid(RoundSolid):
    """A capsule whose straight part has this height [m]."""

    def _local_feature(self, direction: np.ndarray, within: float) -> np.ndarray:
        ends = np.array([[0, 0, -self._half], [0, 0, self._half]])
        along = ends @ direction
        return ends[along >= along.max() - within] + self._radius * direction

    def reach(self, directions: np.ndarray) -> np.ndarray:
        return self._radius + self._half * np.abs(directions @ self.rotation[:, 2])

    def extent(self) -> float:
        return self._radius + self._half

    def _local_nearest(self, points: np.ndarray) -> np.ndarray:
        return np.clip(points, [0, 0, -self._half], [0, 0, self._half])


class CylinderSolid(RoundSolid):
    """A cylinder of this height [m]."""

    has_rim = True

    def _local_feature(self, direction: np.ndarray, within: float) -> np.ndarray:
        across = np.linalg.norm(direction[:2])
        end = np.array([0, 0, np.copysign(self._half, direction[2])])
        if 2 * self._radius * across <= max(within, FLAT) and across < abs(direction[2]):
            # A leaning face has a corner where it reaches furthest.
            first = np.arctan2(direction[1], direction[0]) if 2 * self._radius * across > FLAT else 0.0
            angles = first + 2 * np.pi * np.arange(SIDES) / SIDES
            return end + self._radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
        rim = self._radius * np.append(direction[:2] / across, 0)
        if 2 * self._half * abs(direction[2]) <= within and across >= abs(direction[2]):
            return np.stack([rim + end, rim - end])
        # A rolling rim comes down beside its lowest point: two more points that fall short by ``within``, or nearly.
        fall = float(np.clip((within - FLAT) / (self._radius * across), 0, ARC))
        if fall == 0:
            return (rim + end)[None]
        cosine, sine = 1 - fall, np.sqrt(fall * (2 - fall))
        beside = sine * np.array([-rim[1], rim[0], 0])
        return end + np.stack([rim, cosine * rim + beside, cosine * rim - beside])

    def reach(self, directions: np.ndarray) -> np.ndarray:
        local = directions @ self.rotation
        return self._radius * np.linalg.norm(local[:, :2], axis=1) + self._half * np.abs(local[:, 2])

    def extent(self) -> float:
        return float(np.hypot(self._radius, self._half))

    def _local_nearest(self, points: np.ndarray) -> np.ndarray:
        across = np.linalg.norm(points[:, :2], axis=1, keepdims=True)
        inward = np.minimum(1, self._radius / np.maximum(across, self._radius))
        return np.concatenate([points[:, :2] * inward, np.clip(points[:, 2:], -self._half, self._half)], 1)


def solid_of(shape: Shape, placed: Pose) -> Solid:
    """Build the solid of a shape at a pose; for a tree the convex hull of its balls.

    Raises:
        ValueError: for an unbounded shape, or one of another type.
    """
    if isinstance(shape, Box):
        return BoxSolid(placed, np.array([float(edge) for edge in (shape.length, shape.width, shape.height)]))
    if isinstance(shape, Cylinder):
        return CylinderSolid(placed, float(shape.radius), float(shape.height))
    if isinstance(shape, Sphere):
        return BallSolid(placed, np.zeros((1, 3)), np.array([float(shape.radius)]))
    if isinstance(shape, Capsule):
        return CapsuleSolid(placed, float(shape.radius), float(shape.height))
    if isinstance(shape, SphereTree):
        return BallSolid(placed, np.asarray(shape.balls.centers, float), np.asarray(shape.balls.radii, float))
    raise ValueError(f"a solid is a {type(shape).__name__}: expected a Sphere, Box, Cylinder, Capsule or SphereTree")


class ContactManifold(NamedTuple):
    """Contact points, normal and gap between two solids."""

    points: Float[np.ndarray, "m 3"]
    """Contact points, halfway between the solids [m]."""
    normal: Float[np.ndarray, "3"]
    """Unit normal, from the second solid into the first."""
    gaps: Float[np.ndarray, "m"]
    """Gap between the solids at each point [m]; negative for penetration."""
    gap: float
    """Gap between the solids [m], the least."""


def table_manifold(solid: Solid, table: Pose, within: float = FLAT) -> ContactManifold:
    """Compute the contact manifold of a solid and the half space below a table's top; its points are higher than the
    lowest by at most ``within`` [m]."""
    up = np.asarray(table.rotation, float)[:, 2]
    points = solid.feature(-up, within)
    heights = (points - np.asarray(table.origin)) @ up
    return _outermost(points - heights[:, None] * up, heights, up, float(heights.min()))


def manifold_between(first: Solid, second: Solid, within: float) -> ContactManifold | None:
    """Compute the contact manifold of two solids, of points with gaps up to ``within`` [m]; None for solids that are
    further apart."""
    offset = first.origin - second.origin
    if np.linalg.norm(offset) > first.extent() + second.extent() + within:
        return None
    has_rim = first.has_rim or second.has_rim

    def gaps(directions: np.ndarray) -> np.ndarray:
        return directions @ offset - first.reach(-directions) - second.reach(directions)

    directions, handicap = _directions(first, second)
    values = gaps(directions) - handicap
    order = np.argsort(-values)
    best, manifold = order[0], None
    if not has_rim or handicap[best] == 0:
        manifold = _manifold_across(first, second, within, directions[best], float(values[best]))
    # For flat faces and straight edges the direction of the largest gap is among the candidates; for a rim it is
    # improved from there. A plane in which no point is as close as the solids are along it is not that of the largest.
    if has_rim and (manifold is None or manifold.gaps.min() > manifold.gap + FLAT):
        climbed = [_climb(gaps, directions[start]) for start in order[:STARTS]]
        manifold = _manifold_across(first, second, within, *max(climbed, key=lambda result: result[1]))
    return manifold


def _manifold_across(
    first: Solid, second: Solid, within: float, normal: np.ndarray, gap: float
) -> ContactManifold | None:
    """Compute the manifold of solids with this gap along a normal; None without a point up to ``within`` [m]."""
    if gap > within:
        return None
    plane, margin = _plane_basis(normal), max(FLAT, within - gap)
    features = first.feature(-normal, margin), second.feature(normal, margin)
    flat = [feature @ plane for feature in features]
    # The direction of a rim is exact to some 5e-5 rad.
    shared = _clip_polygons(flat[0], flat[1], FLAT if first.has_rim or second.has_rim else THIN)
    if not len(shared):
        if gap > 0:
            return None
        # Deep penetration with round sides: the plane is not exactly tangent to them.
        shared = min(flat, key=len).mean(0, keepdims=True)
    # No solid reaches beyond its support feature, as planes through points beside the feature may.
    lower = np.maximum(_heights(flat[0], features[0] @ normal, shared), (features[0] @ normal).min())
    upper = np.minimum(_heights(flat[1], features[1] @ normal, shared), (features[1] @ normal).max())
    gaps = np.maximum(lower - upper, gap)
    is_near = gaps <= max(within, gap + FLAT)
    if not np.any(is_near):
        return None
    middle = (lower + upper) / 2
    points = shared @ plane.T + middle[:, None] * normal
    return _outermost(points[is_near], gaps[is_near], normal, gap)


def _heights(points: np.ndarray, heights: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Compute the heights of the plane, line or point through points ``(k, 2)`` with ``heights`` at places ``(m, 2)``.

    Of a line's points the slope is along it, of one point zero.
    """
    middle = points.mean(0)
    slope, *_ = np.linalg.lstsq(points - middle, heights - heights.mean(), rcond=1e-6)
    return heights.mean() + (places - middle) @ slope


def _climb(gaps: Callable[[np.ndarray], np.ndarray], normal: np.ndarray) -> tuple[np.ndarray, float]:
    """Improve a direction by pattern search; return it with its larger gap."""
    gap = float(gaps(normal[None])[0])
    for k, size in enumerate(STEPS):
        # The compass turns at each step, since the gap function has ridges.
        around = normal + size * _compass(float(k)) @ _plane_basis(normal).T
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        further = gaps(around)
        if further.max() > gap:
            normal, gap = around[np.argmax(further)], float(further.max())
    return normal, gap


def _directions(first: Solid, second: Solid) -> tuple[np.ndarray, np.ndarray]:
    """List unit directions from the second to the first solid as candidates, and the handicap of each [m]."""
    faces = np.concatenate([first.axes(), second.axes()])
    edges = np.cross(first.axes()[:, None], second.axes()).reshape(-1, 3)
    key_points, other_points = first.key_points(), second.key_points()
    offsets = _shortest(key_points - second.nearest(key_points)), _shortest(first.nearest(other_points) - other_points)
    candidates = np.concatenate([faces, -faces, edges, -edges, *offsets])
    length = np.linalg.norm(candidates, axis=1)
    handicap = np.where(np.arange(len(candidates)) < 2 * len(faces), 0, TIE)
    is_nonzero = length > COINCIDENT
    return candidates[is_nonzero] / length[is_nonzero, None], handicap[is_nonzero]


def _compass(offset: float) -> np.ndarray:
    """Return the directions ``(8, 2)`` of a regular compass in the plane, turned by an angle [rad]."""
    angles = offset + np.pi / 4 * np.arange(MAX_POINTS)
    return np.stack([np.cos(angles), np.sin(angles)], 1)


def _shortest(vectors: np.ndarray) -> np.ndarray:
    """Select the shortest ones of vectors from one solid to another."""
    return vectors[np.argsort(np.linalg.norm(vectors, axis=1))[:CLOSEST]]


def _plane_basis(normal: np.ndarray) -> np.ndarray:
    """Return unit vectors ``(3, 2)`` in the plane of a normal, as columns."""
    return np.stack(tangents(normal, np), 1)


def _clip_polygons(first: np.ndarray, second: np.ndarray, widening: float) -> np.ndarray:
    """Clip two convex polygons in the plane, widened by a length [m], against each other (Sutherland-Hodgman): corners
    ``(m, 2)`` of their intersection."""
    # A few corners are faster in plain Python than in NumPy.
    figure: list[list[float]] = _hull(first, widening).tolist()
    fence: list[list[float]] = _hull(second, widening).tolist()
    for start, end in zip(fence, _turned(fence), strict=True):
        east, north = end[0] - start[0], end[1] - start[1]
        inside = [east * (y - start[1]) - north * (x - start[0]) for x, y in figure]
        corners = []
        for corner, next_corner, depth, next_depth in zip(
            figure, _turned(figure), inside, _turned(inside), strict=True
        ):
            if depth >= 0:
                corners.append(corner)
            if (depth >= 0) != (next_depth >= 0):
                share = depth / (depth - next_depth)
                corners.append([a + share * (b - a) for a, b in zip(corner, next_corner, strict=True)])
        if not corners:
            return np.zeros((0, 2))
        figure = corners
    return np.array(figure)


def _turned(entries: list[Entry]) -> list[Entry]:
    """Return the entries from the second on, and then the first."""
    return entries[1:] + entries[:1]


def _hull(key_points: np.ndarray, widening: float) -> np.ndarray:
    """Return the convex hull ``(m, 2)`` of points, widened by a length [m], counterclockwise."""
    wide = (key_points[:, None] + widening * SQUARE).reshape(-1, 2)
    middle = wide.mean(0)
    return wide[_convex_order(wide)] if len(key_points) > 1 else middle + widening * SQUARE


def _convex_order(key_points: np.ndarray) -> np.ndarray:
    """Return the indices of the corners of the convex hull of points (Andrew's monotone chain)."""
    order = np.lexsort((key_points[:, 1], key_points[:, 0])).tolist()
    places: list[list[float]] = key_points.tolist()

    def chain(indices: list[int]) -> list[int]:
        hull: list[int] = []
        for index in indices:
            while len(hull) > 1 and _turn(places[hull[-2]], places[hull[-1]], places[index]) <= 0:
                hull.pop()
            hull.append(index)
        return hull[:-1]

    return np.array(chain(order) + chain(order[::-1]))


def _turn(first: list[float], second: list[float], third: list[float]) -> float:
    return (second[0] - first[0]) * (third[1] - second[1]) - (second[1] - first[1]) * (third[0] - second[0])


def _outermost(points: np.ndarray, gaps: np.ndarray, normal: np.ndarray, gap: float) -> ContactManifold:
    """Build a manifold of the points with these gaps: coincident points are merged; of more than ``MAX_POINTS`` the
    outermost are selected, and the closest."""
    coincides = np.linalg.norm(points[:, None] - points, axis=-1) < COINCIDENT
    first = np.unique(np.argmax(coincides, 1))
    # The mean of coincident points: a ball that is supported a micrometre beside its lowest point rolls.
    points = np.array([points[coincides[k]].mean(0) for k in first])
    gaps = np.array([gaps[coincides[k]].min() for k in first])
    if len(points) > MAX_POINTS:
        chosen = np.unique(np.argmax(points @ _plane_basis(normal) @ _compass(0.2).T, 0))
        if gaps.min() < gaps[chosen].min() - THIN:
            chosen = np.append(chosen, np.argmin(gaps))
        points, gaps = points[chosen], gaps[chosen]
    return ContactManifold(points, normal, gaps, gap)
