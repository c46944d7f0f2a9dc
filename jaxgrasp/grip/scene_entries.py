"""Tables of a scene file as dataclasses that validate their fields."""

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
from jaxgrasp.numerics.geometry import rotation_by
from jaxgrasp.validation.checked import (
    check_directions,
    check_finite,
    check_not_negative,
    check_positive,
    check_vectors,
)


@dataclass(frozen=True)
class HandEntry:
    """Table ``[hand]``: a human hand by its sizes, or a hand from a file."""

    length: float = LENGTH
    """Length from the wrist to the middle finger's tip, of a human hand [m]."""
    breadth: float | None = None
    """Breadth across the knuckles, of a human hand [m]; in proportion to the length where not given."""
    side: Literal["right", "left"] = "right"
    """Side of a human hand."""
    file: str | None = None
    """A URDF or MJCF file, relative to the scene's own folder (the extra ``hands``)."""
    wrist: str | None = None
    """Body of the file that is the wrist; where not given, the last body that carries all joints."""
    links: dict[str, str] = field(default_factory=dict)
    """Finger and phalanx of links that are not recognised by name, such as ``"index distal"``."""
    open: dict[str, float] = field(default_factory=dict)
    """Angles of the file's joints of the open hand, as of a thumb opposite the fingers [rad]; 0 for all others."""
    closed: dict[str, float] = field(default_factory=dict)
    """Angles of the file's joints of the closed hand [rad]; the limit that flexes, for all others."""

    def __post_init__(self) -> None:
        check_positive(self, "length", "breadth")
        for key in ("wrist", "links", "open", "closed"):
            if self.file is None and getattr(self, key):
                raise ValueError(f"{key} is {getattr(self, key)!r}: expected none, since a human hand has no file")
        for link, label in self.links.items():
            if len(label.split()) != 2:
                raise ValueError(f"links[{link!r}] is {label!r}: expected a finger and a phalanx, as in 'index distal'")

    def names(self) -> dict[str, tuple[str, str]]:
        """Return finger and phalanx by link, as [`jaxgrasp.hand.name_fingers`][] takes them."""
        return {link: (label.split()[0], label.split()[1]) for link, label in self.links.items()}


@dataclass(frozen=True, kw_only=True)
class SolidEntry:
    """An exact shape."""

    shape: Literal["cylinder", "sphere", "capsule", "box"] = "cylinder"
    radius: float = 0.03
    """[m]; for a box half the edge."""
    height: float = 0.12
    """Height of a cylinder, of a capsule's straight part, or of a box [m]."""
    size: tuple[float, ...] | None = None
    """A box's edges [m], instead of radius and height."""

    def __post_init__(self) -> None:
        check_positive(self, "radius", "height")
        if self.size is None:
            return
        if self.shape != "box":
            raise ValueError(f"size is {list(self.size)}: expected radius and height, since the shape is not a box")
        if len(self.size) != 3 or not all(math.isfinite(edge) and edge > 0 for edge in self.size):
            raise ValueError(f"size is {list(self.size)}: expected three positive numbers [m]")

    def solid(self) -> Shape:
        """Build the shape."""
        if self.shape == "sphere":
            return Sphere(self.radius)
        if self.shape == "box":
            return Box(*(self.size or (2 * self.radius, 2 * self.radius, self.height)))
        return (Cylinder if self.shape == "cylinder" else Capsule)(self.radius, self.height)


@dataclass(frozen=True, kw_only=True)
class ObjectEntry(SolidEntry):
    """Table ``[object]``: a solid, of uniform density unless mass properties are given."""

    mesh: str | None = None
    """File of a closed surface, relative to the scene's own folder, instead of a shape; its longest axis lies across
    the palm. Balls represent it (the extra ``mesh``)."""
    scale: float = 1.0
    """Metres per unit of the mesh."""
    mass: float = 0.15
    """[kg]"""
    centre_of_mass: tuple[float, ...] | None = None
    """Centre of mass in the shape's frame, or the mesh file's [m]; that of uniform density where not given."""
    inertia: tuple[float, ...] | None = None
    """Inertia tensor about the centre of mass, along the axes of that frame [kg.m^2]: xx, yy, zz, and xy, xz, yz where
    they are not zero; that of uniform density about its own centre where not given."""
    friction: float = 0.6
    """Coulomb's coefficient between hand and object."""
    stiffness: float = 310.0
    """K of eq. 6 [N/m]; the default is quiet on a line of 115,200 baud."""
    torsion: float = 0.0
    """Torsional friction of soft fingers on it [m]: moment about a contact's normal for each newton of normal force; 0
    for hard contacts."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "mass", "scale")
        check_not_negative(self, "friction", "stiffness", "torsion")
        check_vectors(self, "centre_of_mass")
        if self.inertia is not None:
            _check_inertia(self.inertia)

    def solid(self) -> Shape:
        """Build the object's shape; for a mesh its balls, in the frame of its principal axes."""
        return self.body()[0].shape

    def body(self) -> tuple[Body, np.ndarray]:
        """Build the object about its shape's own origin, for a mesh in the frame of its principal axes; and return its
        centre of mass in that frame [m]."""
        if self.mesh is None:
            shape, frame = super().solid(), Pose(np.zeros(3), np.eye(3))
        else:
            mesh, frame = principal_frame(load_mesh(self.mesh, self.scale))
            shape = sphere_tree(mesh)
        uniform, back = Body(shape, self.mass), np.asarray(frame.rotation).T
        inertia = None if self.inertia is None else back @ _inertia_matrix(self.inertia) @ back.T
        if self.centre_of_mass is None:
            return Body(shape, self.mass, inertia), np.zeros(3)
        # About another reference point the moments of the shape differ from those of the object.
        inertia = uniform.inertia_matrix() if inertia is None else inertia
        return Body(shape, self.mass, inertia), back @ (np.array(self.centre_of_mass) - np.asarray(frame.origin))


def _inertia_matrix(numbers: tuple[float, ...]) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = (*numbers, 0.0, 0.0, 0.0)[:6]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _check_inertia(numbers: tuple[float, ...]) -> None:
    """Raise ValueError for an impossible inertia tensor: no principal moment may exceed the sum of the other two."""
    if len(numbers) not in (3, 6) or not np.all(np.isfinite(numbers)):
        raise ValueError(f"inertia is {list(numbers)}: expected xx, yy, zz, or these and xy, xz, yz [kg.m^2]")
    smallest, middle, largest = np.linalg.eigvalsh(_inertia_matrix(numbers))
    if not (smallest > 0 and largest <= (smallest + middle) * (1 + 1e-9)):
        raise ValueError(
            f"inertia is {list(numbers)}: expected positive principal moments, none above the sum of the other two, "
            f"not {smallest:.3g}, {middle:.3g}, {largest:.3g} kg.m^2"
        )


@dataclass(frozen=True, kw_only=True)
class PlacedEntry(SolidEntry):
    """A shape at a pose in the world."""

    at: tuple[float, ...]
    """Position of its centre, relative to the object's at the start, along the world's axes [m]."""
    turn: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Rotation vector of the shape, along the world's axes [rad]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_vectors(self, "at", "turn")

    def rotation(self) -> Array:
        """Return the shape's axes in the world, as columns."""
        return rotation_by(jnp.array(self.turn))


@dataclass(frozen=True, kw_only=True)
class ObstacleEntry(PlacedEntry):
    """Table ``[[obstacle]]``: a solid at rest or on a path, in the way of object and hand."""

    stiffness: float = 2000.0
    """K of eq. 1, for each part of the object in contact [N/m]."""
    friction: float = 0.0
    """Coulomb's coefficient between the obstacle and the object."""
    damping: float = 0.0
    """Damping of each part of the object as it goes deeper [N.s/m]."""
    path: tuple[tuple[float, ...], ...] = ()
    """Path of a moving obstacle: rows of a time [s], its shift from ``at`` by then along the world's axes [m], and if
    it turns, a rotation vector [rad]; linear in between."""
    touches_hand: bool = True
    """True if it stops the hand too; False if the hand passes through."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "stiffness", "friction", "damping")
        for k, row in enumerate(self.path):
            if len(row) not in (4, 7) or not all(map(math.isfinite, row)):
                raise ValueError(f"path[{k}] is {list(row)}: expected a time and three or six finite numbers")
            if k and row[0] <= self.path[k - 1][0]:
                raise ValueError(f"path[{k}] begins at {row[0]:g} s: expected later than {self.path[k - 1][0]:g} s")

    def moves(self) -> ObstaclePath | None:
        """Build the obstacle's path; None for one at rest."""
        if not self.path:
            return None
        rows = jnp.array([(*row, 0.0, 0.0, 0.0)[:7] for row in self.path])
        return ObstaclePath(rows[:, 0], rows[:, 1:4], rows[:, 4:])


@dataclass(frozen=True, kw_only=True)
class OtherEntry(ObjectEntry, PlacedEntry):
    """Table ``[[other]]``: a further object, moved by its contacts with hand, table and objects."""

    rubbing: float = 0.5
    """Coulomb's coefficient between it and the table or another object; of two objects the larger counts. The friction
    in table ``[table]`` is that of the gripped object."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "rubbing")


@dataclass(frozen=True, kw_only=True)
class GuideEntry:
    """Table ``[guide]``: a joint that restricts the object's motion."""

    kind: Literal["slide", "hinge", "screw"]
    axis: tuple[float, ...]
    """Axis of the motion in the world; of any length."""
    through: tuple[float, ...] = (0.0, 0.0, 0.0)
    """A point of the axis, relative to the object's centre at the start, along the world's axes [m]."""
    pitch: float = 0.0
    """Travel of a screw along the axis for a radian of turn [m/rad]."""

    def __post_init__(self) -> None:
        check_directions(self, "axis")
        check_vectors(self, "through")
        check_finite(self, "pitch")
        if self.pitch != 0 and self.kind != "screw":
            raise ValueError(f"pitch is {self.pitch}: expected 0 for a {self.kind}")

    def twists(self, centre: np.ndarray) -> np.ndarray:
        """Return the twist ``(6, 1)`` about the world's origin, for an object whose centre starts at ``centre``."""
        axis = np.array(self.axis) / np.abs(self.axis).max()
        axis = axis / np.linalg.norm(axis)
        if self.kind == "slide":
            return np.append(axis, np.zeros(3))[:, None]
        point = np.asarray(centre) + self.through
        return np.append(np.cross(point, axis) + self.pitch * axis, axis)[:, None]


@dataclass(frozen=True)
class GripEntry:
    """Table ``[grip]``: the initial grip of the hand."""

    kind: Literal["power", "precision-3", "precision-4", "precision-5"] = "power"
    """Power grip of the whole hand, or a precision grip of that many fingertips."""
    depth: float = 1e-3
    """Depth of the links in the object [m]."""
    contributions: Literal["table", "balanced"] = "table"
    """Contributions of the links: the paper's Table I, or the closest to it whose squeezing forces balance."""
    law: Law = "optimum"
    """Force law of the hand."""

    def __post_init__(self) -> None:
        check_positive(self, "depth")


@dataclass(frozen=True)
class TableEntry:
    """Table ``[table]``: the support of the object at the start."""

    below: float = 0.0
    """Height of the object's lowest point above the table [m]."""
    friction: float = 0.5
    """Coulomb's coefficient between object and table."""
    touches_hand: bool = False
    """True if the table stops the hand too; False if it passes through: fingers around an object on a table would be
    inside it."""

    def __post_init__(self) -> None:
        check_not_negative(self, "below", "friction")


@dataclass(frozen=True)
class WorldEntry:
    """Table ``[world]``: gravity."""

    gravity: tuple[float, ...] = tuple(GRAVITY)
    """[m/s^2]"""

    def __post_init__(self) -> None:
        check_vectors(self, "gravity")
