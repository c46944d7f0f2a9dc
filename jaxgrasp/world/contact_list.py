"""Contacts of all objects of a world, as rows of one problem over all of them."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.grip.scene import Obstacle
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import Float, Int
from jaxgrasp.model.hand import Hand, Pose
from jaxgrasp.world.many_bodies import Motions, World, velocity_at
from jaxgrasp.world.physics import HAND, OBSTACLES, TABLE
from jaxgrasp.world.solids import ContactManifold, Solid, manifold_between, solid_of, table_manifold


class ContactList(NamedTuple):
    """The m contacts of a world's objects with each other and with hand, table and obstacles."""

    first: Int[np.ndarray, "m"]
    """Index of the object that the normal points into."""
    second: Int[np.ndarray, "m"]
    """Index of the second object, or HAND, TABLE or OBSTACLES."""
    points: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "m 3"]
    gaps: Float[np.ndarray, "m"]
    """[m]; negative for penetration."""
    friction: Float[np.ndarray, "m"]
    stiffness: Float[np.ndarray, "m"]
    """Stiffness of a spring contact [N/m]; inf for a rigid contact."""
    carried: Float[np.ndarray, "m 3"]
    """Velocity of the second body at the contact, where it is hand, table or obstacle [m/s]."""
    torsion: Float[np.ndarray, "m"]
    """Torsional friction of soft fingers [m]; 0 for hard contacts."""
    turning: Float[np.ndarray, "m"]
    """Angular velocity of a soft finger about the normal [rad/s]; 0 for all other contacts."""

    @property
    def spin_radius(self) -> Float[np.ndarray, "m"]:
        """Return the moment for each unit of a soft finger's spin component [m]; 0 for hard or frictionless
        contacts."""
        return np.where(self.friction > 0, self.torsion / np.where(self.friction > 0, self.friction, 1), 0)


COLUMNS = [((), int)] * 2 + [((3,), float)] * 2 + [((), float)] * 3 + [((3,), float)] + [((), float)] * 2
"""Shape and dtype of an entry of each column of a ContactList."""


class _Rows:
    """Accumulator of contacts, converted into columns once all manifolds are added."""

    def __init__(self) -> None:
        self.rows: list[tuple] = []

    def add(
        self,
        first: int,
        second: int,
        manifold: ContactManifold,
        friction: float,
        stiffness: float = np.inf,
        moving: Obstacle | None = None,
    ) -> None:
        carried = np.zeros(manifold.points.shape)
        if moving is not None and moving.motion is not None:
            linear, angular, origin = (
                np.broadcast_to(part, carried.shape) for part in (*moving.motion, moving.placed.origin)
            )
            carried = velocity_at(Motions(linear, angular), origin, manifold.points)
        for point, velocity in zip(manifold.points, carried, strict=True):
            self.rows.append(
                (first, second, point, manifold.normal, manifold.gap, friction, stiffness, velocity, 0.0, 0.0)
            )

    def to_list(self) -> ContactList:
        empty = [np.zeros((0, *tail), kind) for tail, kind in COLUMNS]
        return ContactList._make([np.array(column) for column in zip(*self.rows, strict=True)] or empty)


def solids(world: World, placed: Pose) -> list[Solid]:
    """Place the solid of every object at its pose.

    Raises:
        ValueError: for a shape that is unbounded or not supported.
    """
    return [
        solid_of(member.body.shape, Pose(origin, rotation))
        for member, origin, rotation in zip(world.bodies, placed.origin, placed.rotation, strict=True)
    ]


def world_contact_list(
    world: World, placed: Pose, within: float, obstacles: tuple[Obstacle, ...] | None = None
) -> ContactList:
    """List the contacts of objects with each other, the table and obstacles, up to a gap of ``within`` [m].
    ``obstacles`` replaces those of the scene, at their current poses, where any moves."""
    rigid_bodies, rows, placed_solids = world.bodies, _Rows(), solids(world, placed)
    rubbing = [float(rigid_body.rubbing) for rigid_body in rigid_bodies]
    present_obstacles = world.scene.obstacles if obstacles is None else obstacles
    fixed = [(solid_of(obstacle.shape, obstacle.placed), obstacle) for obstacle in present_obstacles]
    for n, solid in enumerate(placed_solids):
        on_table = table_manifold(solid, world.scene.table)
        if on_table.gap <= within:
            rows.add(n, TABLE, on_table, rubbing[n])
        for solid_obstacle, obstacle in fixed:
            manifold = manifold_between(solid, solid_obstacle, within)
            if manifold is not None:
                rows.add(n, OBSTACLES, manifold, 0.0, float(obstacle.stiffness), obstacle)
        for k in range(n):
            manifold = manifold_between(solid, placed_solids[k], within)
            if manifold is not None:
                rows.add(n, k, manifold, max(rubbing[n], rubbing[k]))
    return rows.to_list()


def hand_contact_list(world: World, contacts: Contacts, links: Pose, motion: Motions) -> ContactList:
    """List the contacts of the hand with objects, from detected contacts ``(N, L)``.

    Args:
        world: gives friction and stiffness.
        contacts: contacts of each link with each object.
        links: poses of the links ``(L,)``.
        motion: velocities of the links.
    """
    body_stiffness = np.array([float(member.stiffness) for member in world.bodies])
    springs = body_stiffness[:, None] * np.asarray(world.scene.contributions)
    index, link = np.nonzero((np.asarray(contacts.present) > 0) & (springs > 0))
    points, normals, depths = (
        np.asarray(getattr(contacts, name))[index, link] for name in ("points", "normals", "depths")
    )
    friction, torsion = (
        np.array([float(getattr(member, name) or 0) for member in world.bodies])[index]
        for name in ("friction", "torsion")
    )
    link_motion = Motions(motion.linear[link], motion.angular[link])
    carried = velocity_at(link_motion, links.origin[link], points)
    turning = np.where(torsion > 0, np.sum(link_motion.angular * normals, -1), 0)
    hand, contact_stiffness = np.full(len(index), HAND), springs[index, link]
    return ContactList(index, hand, points, normals, -depths, friction, contact_stiffness, carried, torsion, turning)


def still_links(hand: Hand) -> tuple[Pose, Motions]:
    """Return poses and zero velocities for the links of a hand that does not move; its place is irrelevant then."""
    nowhere = np.zeros((len(hand.links), 3))
    return Pose(nowhere, np.broadcast_to(np.eye(3), (len(nowhere), 3, 3))), Motions(nowhere, nowhere)


def together(first: ContactList, second: ContactList) -> ContactList:
    """Concatenate two lists of contacts."""
    return ContactList(*(np.concatenate(parts) for parts in zip(first, second, strict=True)))
