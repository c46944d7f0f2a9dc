"""The tables of a scene file, each checked as it is made."""

import math
from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.grip.monitor import Law
from jaxgrasp.hand.filling import sphere_tree
from jaxgrasp.hand.human_hand import LENGTH
from jaxgrasp.hand.mesh import load_mesh, principal_frame
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Sphere
from jaxgrasp.model.task import GRAVITY
from jaxgrasp.numerics.rotation import rotation_by
from jaxgrasp.validation.fields import check_directions, check_finite, check_not_negative, check_positive, check_vectors


@dataclass(frozen=True)
class HandEntry:
    """The table ``[hand]``: a human hand by its sizes."""

    length: float = LENGTH
    """From the wrist to the middle finger's tip [m]."""
    breadth: float | None = None
    """Across the knuckles [m]; in proportion where not given."""
    side: Literal["right", "left"] = "right"

    def __post_init__(self) -> None:
        check_positive(self, "length", "breadth")


@dataclass(frozen=True, kw_only=True)
class SolidEntry:
    """An exact shape."""

    shape: Literal["cylinder", "sphere", "capsule", "box"] = "cylinder"
    radius: float = 0.03
    """[m]; of a box half the edge."""
    height: float = 0.12
    """Height of a cylinder, of a capsule's straight part, or of a box [m]."""
    size: tuple[float, ...] | None = None
    """A box's edges [m], instead of radius and height."""

    def __post_init__(self) -> None:
        check_positive(self, "radius", "height")
        if self.size is None:
            return
        if self.shape != "box":
            raise ValueError(f"size is {list(self.size)}: expected radius and height, since the shape is no box")
        if len(self.size) != 3 or not all(math.isfinite(edge) and edge > 0 for edge in self.size):
            raise ValueError(f"size is {list(self.size)}: expected three positive numbers [m]")

    def solid(self) -> Shape:
        """The shape."""
        if self.shape == "sphere":
            return Sphere(self.radius)
        if self.shape == "box":
            return Box(*(self.size or (2 * self.radius, 2 * self.radius, self.height)))
        return (Cylinder if self.shape == "cylinder" else Capsule)(self.radius, self.height)


@dataclass(frozen=True, kw_only=True)
class ObjectEntry(SolidEntry):
    """The table ``[object]``: a solid of uniform density."""

    mesh: str | None = None
    """File of a closed surface, from the scene's own folder, instead of a shape; its longest axis goes across the
    palm. Its balls stand for it (the extra ``mesh``)."""
    scale: float = 1.0
    """Metres of a unit of the mesh's."""
    mass: float = 0.15
    """[kg]"""
    friction: float = 0.6
    """Coulomb's coefficient between hand and object."""
    stiffness: float = 400.0
    """K of eq. 6 [N/m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "mass", "scale")
        check_not_negative(self, "friction", "stiffness")

    def solid(self) -> Shape:
        """The object's shape; of a mesh its balls, in the frame of its principal axes."""
        if self.mesh is None:
            return super().solid()
        return sphere_tree(principal_frame(load_mesh(self.mesh, self.scale))[0])


@dataclass(frozen=True, kw_only=True)
class PlacedEntry(SolidEntry):
    """A shape that stands in the world."""

    at: tuple[float, ...]
    """Place of its centre, from the object's at first, along the world's axes [m]."""
    turn: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Turn of the shape: an axis in the world, as long as the angle [rad]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_vectors(self, "at", "turn")

    def rotation(self) -> Array:
        """Its axes in the world, as columns."""
        return rotation_by(jnp.array(self.turn))


@dataclass(frozen=True, kw_only=True)
class ObstacleEntry(PlacedEntry):
    """A table ``[[obstacle]]``: what stands in the object's way; the hand goes through it."""

    stiffness: float = 2000.0
    """K of eq. 1, of each part of the object that touches [N/m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "stiffness")


@dataclass(frozen=True, kw_only=True)
class OtherEntry(ObjectEntry, PlacedEntry):
    """A table ``[[other]]``: a further object, which moves by what hand, table and objects do to it."""

    rubbing: float = 0.5
    """Coulomb's coefficient between it and the table or another object; of two objects the larger counts, and the
    table's friction is that of the gripped one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "rubbing")


@dataclass(frozen=True, kw_only=True)
class GuideEntry:
    """The table ``[guide]``: what the object cannot leave."""

    kind: Literal["slide", "hinge", "screw"]
    axis: tuple[float, ...]
    """Along which, or about which, it moves in the world; of any length."""
    through: tuple[float, ...] = (0.0, 0.0, 0.0)
    """A point of the axis, from the object's centre at first, along the world's axes [m]."""
    pitch: float = 0.0
    """Way along the axis with a radian of turn, of a screw [m/rad]."""

    def __post_init__(self) -> None:
        check_directions(self, "axis")
        check_vectors(self, "through")
        check_finite(self, "pitch")
        if self.pitch != 0 and self.kind != "screw":
            raise ValueError(f"pitch is {self.pitch}: expected none of a {self.kind}")

    def twists(self, centre: np.ndarray) -> np.ndarray:
        """``(6, 1)``: the twist about the world's origin, for an object whose centre is there at first."""
        axis = np.array(self.axis) / np.abs(self.axis).max()
        axis = axis / np.linalg.norm(axis)
        if self.kind == "slide":
            return np.append(axis, np.zeros(3))[:, None]
        point = np.asarray(centre) + self.through
        return np.append(np.cross(point, axis) + self.pitch * axis, axis)[:, None]


@dataclass(frozen=True)
class GripEntry:
    """The table ``[grip]``: how the hand is closed at first."""

    kind: Literal["power", "precision-3", "precision-4", "precision-5"] = "power"
    """All of the hand, or as many fingertips."""
    depth: float = 1e-3
    """How far the links press into the object [m]."""
    contributions: Literal["table", "balanced"] = "table"
    """Contributions of the links: the paper's Table I, or the nearest to it by which the squeezing forces balance."""
    law: Law = "optimum"
    """Which forces the hand applies."""

    def __post_init__(self) -> None:
        check_positive(self, "depth")


@dataclass(frozen=True)
class TableEntry:
    """The table ``[table]``: what the object stands on at first."""

    below: float = 0.0
    """How far below the object's lowest place it is [m]."""
    friction: float = 0.5
    """Coulomb's coefficient between object and table."""

    def __post_init__(self) -> None:
        check_not_negative(self, "below", "friction")


@dataclass(frozen=True)
class WorldEntry:
    """The table ``[world]``."""

    gravity: tuple[float, ...] = tuple(GRAVITY)
    """[m/s^2]"""

    def __post_init__(self) -> None:
        check_vectors(self, "gravity")
