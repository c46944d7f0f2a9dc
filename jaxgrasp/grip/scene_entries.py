"""The tables of a scene file, each checked as it is made."""

import math
from dataclasses import dataclass, field
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.grip.monitor import Law
from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.scene import ObstaclePath
from jaxgrasp.hand.filling import sphere_tree
from jaxgrasp.hand.human_hand import LENGTH
from jaxgrasp.hand.mesh import load_mesh, principal_frame
from jaxgrasp.hand.shapes import Box, Capsule, Cylinder, Shape, Sphere
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.task import GRAVITY
from jaxgrasp.numerics.rotation import rotation_by
from jaxgrasp.validation.fields import check_directions, check_finite, check_not_negative, check_positive, check_vectors


@dataclass(frozen=True)
class HandEntry:
    """The table ``[hand]``: a human hand by its sizes, or one out of a file."""

    length: float = LENGTH
    """From the wrist to the middle finger's tip, of a human hand [m]."""
    breadth: float | None = None
    """Across the knuckles, of a human hand [m]; in proportion where not given."""
    side: Literal["right", "left"] = "right"
    """Which hand, of a human one."""
    file: str | None = None
    """A URDF or MJCF file, from the scene's own folder (the extra ``hands``)."""
    wrist: str | None = None
    """Body of the file that is the wrist; where not given, the last one that all joints hang on."""
    links: dict[str, str] = field(default_factory=dict)
    """Finger and phalanx of the file's links whose names do not tell, such as ``"index distal"``."""
    open: dict[str, float] = field(default_factory=dict)
    """Angles of the file's joints where the hand is open, as of a thumb opposite the fingers [rad]; 0 of the others."""
    closed: dict[str, float] = field(default_factory=dict)
    """Angles of the file's joints where they end as the hand closes [rad]; the limit that flexes, of the others."""

    def __post_init__(self) -> None:
        check_positive(self, "length", "breadth")
        for key in ("wrist", "links", "open", "closed"):
            if self.file is None and getattr(self, key):
                raise ValueError(f"{key} is {getattr(self, key)!r}: expected none of a human hand, which has no file")
        for link, said in self.links.items():
            if len(said.split()) != 2:
                raise ValueError(f"links[{link!r}] is {said!r}: expected a finger and a phalanx, as in 'index distal'")

    def names(self) -> dict[str, tuple[str, str]]:
        """Finger and phalanx by link, as [`jaxgrasp.hand.name_fingers`][] takes them."""
        return {link: (said.split()[0], said.split()[1]) for link, said in self.links.items()}


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
    """The table ``[object]``: a solid, of uniform density where nothing else is said."""

    mesh: str | None = None
    """File of a closed surface, from the scene's own folder, instead of a shape; its longest axis goes across the
    palm. Its balls stand for it (the extra ``mesh``)."""
    scale: float = 1.0
    """Metres of a unit of the mesh's."""
    mass: float = 0.15
    """[kg]"""
    centre_of_mass: tuple[float, ...] | None = None
    """In the shape's frame, or the mesh file's [m]; where not given, that of a uniform density."""
    inertia: tuple[float, ...] | None = None
    """About the centre of mass, along the axes of that frame [kg.m^2]: xx, yy, zz, and xy, xz, yz where they are not
    zero; where not given, that of a uniform density about its own centre."""
    friction: float = 0.6
    """Coulomb's coefficient between hand and object."""
    stiffness: float = 400.0
    """K of eq. 6 [N/m]."""
    torsion: float = 0.0
    """Torsional friction of soft fingers on it [m]: the moment about a contact's normal that a newton of normal force
    holds; 0 for hard ones."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "mass", "scale")
        check_not_negative(self, "friction", "stiffness", "torsion")
        check_vectors(self, "centre_of_mass")
        if self.inertia is not None:
            _check_inertia(self.inertia)

    def solid(self) -> Shape:
        """The object's shape; of a mesh its balls, in the frame of its principal axes."""
        return self.body()[0].shape

    def body(self) -> tuple[Body, np.ndarray]:
        """The object about its shape's own origin, of a mesh in the frame of its principal axes; and where its centre
        of mass is there [m]."""
        if self.mesh is None:
            shape, frame = super().solid(), Pose(np.zeros(3), np.eye(3))
        else:
            mesh, frame = principal_frame(load_mesh(self.mesh, self.scale))
            shape = sphere_tree(mesh)
        uniform, back = Body(shape, self.mass), np.asarray(frame.rotation).T
        inertia = None if self.inertia is None else back @ _inertia_matrix(self.inertia) @ back.T
        if self.centre_of_mass is None:
            return Body(shape, self.mass, inertia), np.zeros(3)
        # About another place the shape's own moments are not the object's.
        inertia = uniform.inertia_matrix() if inertia is None else inertia
        return Body(shape, self.mass, inertia), back @ (np.array(self.centre_of_mass) - np.asarray(frame.origin))


def _inertia_matrix(numbers: tuple[float, ...]) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = (*numbers, 0.0, 0.0, 0.0)[:6]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _check_inertia(numbers: tuple[float, ...]) -> None:
    """Raise ValueError for what no solid has: none of its principal moments exceeds the sum of the others."""
    if len(numbers) not in (3, 6) or not np.all(np.isfinite(numbers)):
        raise ValueError(f"inertia is {list(numbers)}: expected xx, yy, zz, or these and xy, xz, yz [kg.m^2]")
    least, middle, most = np.linalg.eigvalsh(_inertia_matrix(numbers))
    if not (least > 0 and most <= (least + middle) * (1 + 1e-9)):
        raise ValueError(
            f"inertia is {list(numbers)}: expected positive principal moments, none above the sum of the other two, "
            f"not {least:.3g}, {middle:.3g}, {most:.3g} kg.m^2"
        )


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
    """A table ``[[obstacle]]``: what stands or moves in the way of object and hand."""

    stiffness: float = 2000.0
    """K of eq. 1, of each part of the object that touches [N/m]."""
    friction: float = 0.0
    """Coulomb's coefficient between it and a held object that slides along it."""
    damping: float = 0.0
    """By which each part of the object is resisted as it goes deeper [N.s/m]."""
    path: tuple[tuple[float, ...], ...] = ()
    """Where it goes, whatever it meets: rows of a time [s], its way from ``at`` by then along the world's axes [m], and
    if it turns, an axis as long as the angle [rad]; straight from each to the next."""
    touches_hand: bool = True
    """Whether the hand is stopped by it too, or goes through."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "stiffness", "friction", "damping")
        for k, row in enumerate(self.path):
            if len(row) not in (4, 7) or not all(map(math.isfinite, row)):
                raise ValueError(f"path[{k}] is {list(row)}: expected a time and three or six finite numbers")
            if k and row[0] <= self.path[k - 1][0]:
                raise ValueError(f"path[{k}] begins at {row[0]:g} s: expected later than {self.path[k - 1][0]:g} s")

    def moves(self) -> ObstaclePath | None:
        """Its path, if it has one."""
        if not self.path:
            return None
        rows = jnp.array([(*row, 0.0, 0.0, 0.0)[:7] for row in self.path])
        return ObstaclePath(rows[:, 0], rows[:, 1:4], rows[:, 4:])


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
    touches_hand: bool = False
    """Whether the hand is stopped by it too, or goes through: fingers around what lies on a table would be in it."""

    def __post_init__(self) -> None:
        check_not_negative(self, "below", "friction")


@dataclass(frozen=True)
class WorldEntry:
    """The table ``[world]``."""

    gravity: tuple[float, ...] = tuple(GRAVITY)
    """[m/s^2]"""

    def __post_init__(self) -> None:
        check_vectors(self, "gravity")
