"""Convex solids in the world, in NumPy: how far they reach in a direction, and with which of their places."""

from abc import ABC, abstractmethod

import numpy as np

from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Sphere
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.model.hand import Pose

FLAT = 1e-4
"""How much less far than the furthest a place may reach and still touch with it [m]: a face that lies nearly flat on
another touches with all of it."""
SIDES = 16
"""Corners for which a cylinder's round face counts."""
CORNERS = np.array(list(np.ndindex(2, 2, 2))) - 0.5


class Solid(ABC):
    """A convex solid that stands somewhere."""

    has_rim = False
    """Whether it has an edge that is not straight."""

    def __init__(self, placed: Pose):
        self.origin = np.asarray(placed.origin, float)
        self.rotation = np.asarray(placed.rotation, float)

    def feature(self, direction: np.ndarray) -> np.ndarray:
        """``(k, 3)``: its places in the world that reach furthest, corners of a face, ends of an edge, or one."""
        return self.origin + self._own_feature(direction @ self.rotation) @ self.rotation.T

    @abstractmethod
    def _own_feature(self, direction: np.ndarray) -> np.ndarray:
        """What it says, in its own frame."""

    @abstractmethod
    def reach(self, directions: np.ndarray) -> np.ndarray:
        """How far it reaches from its origin along directions ``(n, 3)`` in the world [m]."""

    @abstractmethod
    def extent(self) -> float:
        """Radius of a ball about its origin that holds it [m]."""

    def axes(self) -> np.ndarray:
        """``(n, 3)``: normals of its flat faces, which are directions of its edges too."""
        return np.zeros((0, 3))

    @abstractmethod
    def places(self) -> np.ndarray:
        """``(n, 3)``: where in the world it may come close to another: corners, or centres of what is round."""

    def nearest(self, points: np.ndarray) -> np.ndarray:
        """``(n, 3)``: its places in the world next to others; of what is round all over, those in its middle."""
        return self.origin + self._own_nearest((points - self.origin) @ self.rotation) @ self.rotation.T

    @abstractmethod
    def _own_nearest(self, points: np.ndarray) -> np.ndarray:
        """What it says, in its own frame."""


class BallSolid(Solid):
    """A hull of balls: a sphere, a capsule, or a tree's."""

    def __init__(self, placed: Pose, centers: np.ndarray, radii: np.ndarray):
        super().__init__(placed)
        self._centers, self._radii = centers, radii

    def _own_feature(self, direction: np.ndarray) -> np.ndarray:
        along = self._centers @ direction + self._radii
        there = along >= along.max() - FLAT
        return self._centers[there] + self._radii[there, None] * direction

    def reach(self, directions: np.ndarray) -> np.ndarray:
        return (directions @ self.rotation @ self._centers.T + self._radii).max(1)

    def extent(self) -> float:
        return float((np.linalg.norm(self._centers, axis=1) + self._radii).max())

    def places(self) -> np.ndarray:
        return self.origin + self._centers @ self.rotation.T

    def _own_nearest(self, points: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(points[:, None] - self._centers, axis=-1) - self._radii
        return self._centers[np.argmin(away, 1)]


class BoxSolid(Solid):
    """A box of these edges."""

    def __init__(self, placed: Pose, edges: np.ndarray):
        super().__init__(placed)
        self._corners = CORNERS * edges

    def _own_feature(self, direction: np.ndarray) -> np.ndarray:
        along = self._corners @ direction
        return self._corners[along >= along.max() - FLAT]

    def reach(self, directions: np.ndarray) -> np.ndarray:
        return (directions @ self.rotation @ self._corners.T).max(1)

    def extent(self) -> float:
        return float(np.linalg.norm(self._corners[0]))

    def axes(self) -> np.ndarray:
        return self.rotation.T

    def places(self) -> np.ndarray:
        return self.origin + self._corners @ self.rotation.T

    def _own_nearest(self, points: np.ndarray) -> np.ndarray:
        return np.clip(points, self._corners[0], self._corners[-1])


class RoundSolid(Solid):
    """What is round about its own z: a cylinder or a capsule."""

    def __init__(self, placed: Pose, radius: float, height: float):
        super().__init__(placed)
        self._radius, self._half = radius, height / 2

    def axes(self) -> np.ndarray:
        return self.rotation.T[2:]

    def places(self) -> np.ndarray:
        return self.origin + np.array([-self._half, 0, self._half])[:, None] * self.rotation[:, 2]


class CapsuleSolid(RoundSolid):
    """A capsule, whose straight part is of this height."""

    def _own_feature(self, direction: np.ndarray) -> np.ndarray:
        ends = np.array([[0, 0, -self._half], [0, 0, self._half]])
        along = ends @ direction
        return ends[along >= along.max() - FLAT] + self._radius * direction

    def reach(self, directions: np.ndarray) -> np.ndarray:
        return self._radius + self._half * np.abs(directions @ self.rotation[:, 2])

    def extent(self) -> float:
        return self._radius + self._half

    def _own_nearest(self, points: np.ndarray) -> np.ndarray:
        return np.clip(points, [0, 0, -self._half], [0, 0, self._half])


class CylinderSolid(RoundSolid):
    """A cylinder of this height."""

    has_rim = True

    def _own_feature(self, direction: np.ndarray) -> np.ndarray:
        across = np.linalg.norm(direction[:2])
        end = np.array([0, 0, np.copysign(self._half, direction[2])])
        if 2 * self._radius * across < FLAT:
            angles = 2 * np.pi * np.arange(SIDES) / SIDES
            return end + self._radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
        rim = self._radius * np.append(direction[:2] / across, 0)
        if 2 * self._half * abs(direction[2]) < FLAT:
            return np.stack([rim + end, rim - end])
        return (rim + end)[None]

    def reach(self, directions: np.ndarray) -> np.ndarray:
        own = directions @ self.rotation
        return self._radius * np.linalg.norm(own[:, :2], axis=1) + self._half * np.abs(own[:, 2])

    def extent(self) -> float:
        return float(np.hypot(self._radius, self._half))

    def _own_nearest(self, points: np.ndarray) -> np.ndarray:
        across = np.linalg.norm(points[:, :2], axis=1, keepdims=True)
        inward = np.minimum(1, self._radius / np.maximum(across, self._radius))
        return np.concatenate([points[:, :2] * inward, np.clip(points[:, 2:], -self._half, self._half)], 1)


def solid_of(shape: Shape, placed: Pose) -> Solid:
    """A shape where it stands; of a tree the hull of its balls.

    Raises:
        ValueError: for a shape without an end, or of another kind.
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
