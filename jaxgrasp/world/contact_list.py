"""All places where the objects of a world touch something, as rows of one problem over all of them."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.grip.scene import Obstacle
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import Float, Int
from jaxgrasp.model.hand import Hand, Pose
from jaxgrasp.world.led_bodies import Motions, velocity_at
from jaxgrasp.world.many_bodies import World
from jaxgrasp.world.physics import HAND, OBSTACLES, TABLE
from jaxgrasp.world.solids import Solid, solid_of
from jaxgrasp.world.touching_solids import Patch, patch_between, table_patch


class ContactList(NamedTuple):
    """The m contacts of a world's objects."""

    first: Int[np.ndarray, "m"]
    """The object that the normal points into."""
    second: Int[np.ndarray, "m"]
    """The other object, or HAND, TABLE or OBSTACLES."""
    points: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "m 3"]
    gaps: Float[np.ndarray, "m"]
    """[m]; negative where what touches reaches in."""
    friction: Float[np.ndarray, "m"]
    stiffness: Float[np.ndarray, "m"]
    """Stiffness of springs [N/m]; inf where nothing gives."""
    carried: Float[np.ndarray, "m 3"]
    """Velocity of what is no object [m/s]."""
    torsion: Float[np.ndarray, "m"]
    """Torsional friction of soft fingers [m]; 0 of what is hard."""
    turning: Float[np.ndarray, "m"]
    """Angular velocity about the normal of a soft finger [rad/s]; 0 of all else."""

    @property
    def spin_radius(self) -> Float[np.ndarray, "m"]:
        """Moment for each unit of a soft finger's spin component [m]; 0 of what is hard, or slides freely."""
        return np.where(self.friction > 0, self.torsion / np.where(self.friction > 0, self.friction, 1), 0)


COLUMNS = [((), int)] * 2 + [((3,), float)] * 2 + [((), float)] * 3 + [((3,), float)] + [((), float)] * 2
"""Shape and kind of an entry of each of its columns."""


class _Rows:
    """Contacts as they are found."""

    def __init__(self) -> None:
        self.rows: list[tuple] = []

    def add(
        self,
        first: int,
        second: int,
        patch: Patch,
        friction: float,
        stiffness: float = np.inf,
        moving: Obstacle | None = None,
    ) -> None:
        carried = np.zeros(patch.points.shape)
        if moving is not None and moving.motion is not None:
            linear, angular, origin = (
                np.broadcast_to(part, carried.shape) for part in (*moving.motion, moving.placed.origin)
            )
            carried = velocity_at(Motions(linear, angular), origin, patch.points)
        for point, velocity in zip(patch.points, carried, strict=True):
            self.rows.append((first, second, point, patch.normal, patch.gap, friction, stiffness, velocity, 0.0, 0.0))

    def finished(self) -> ContactList:
        nothing = [np.zeros((0, *tail), kind) for tail, kind in COLUMNS]
        return ContactList._make([np.array(column) for column in zip(*self.rows, strict=True)] or nothing)


def solids(world: World, placed: Pose) -> list[Solid]:
    """The objects where they stand.

    Raises:
        ValueError: for a shape that no object has.
    """
    return [
        solid_of(thing.body.shape, Pose(origin, rotation))
        for thing, origin, rotation in zip(world.things, placed.origin, placed.rotation, strict=True)
    ]


def world_contact_list(
    world: World, placed: Pose, within: float, obstacles: tuple[Obstacle, ...] | None = None
) -> ContactList:
    """Where objects touch one another, the table and obstacles, or are closer to it than ``within`` [m]; ``obstacles``
    are those of the scene where they now are, if any moves."""
    things, found, stand = world.things, _Rows(), solids(world, placed)
    rubbing = [float(thing.rubbing) for thing in things]
    around = world.scene.obstacles if obstacles is None else obstacles
    fixed = [(solid_of(obstacle.shape, obstacle.placed), obstacle) for obstacle in around]
    for n, solid in enumerate(stand):
        on_table = table_patch(solid, world.scene.table)
        if on_table.gap <= within:
            found.add(n, TABLE, on_table, rubbing[n])
        for other, obstacle in fixed:
            patch = patch_between(solid, other, within)
            if patch is not None:
                found.add(n, OBSTACLES, patch, 0.0, float(obstacle.stiffness), obstacle)
        for k in range(n):
            patch = patch_between(solid, stand[k], within)
            if patch is not None:
                found.add(n, k, patch, max(rubbing[n], rubbing[k]))
    return found.finished()


def hand_contact_list(world: World, contacts: Contacts, links: Pose, motion: Motions) -> ContactList:
    """Where the hand touches objects, by contacts ``(N, L)`` that are known.

    Args:
        world: whose friction and stiffness count.
        contacts: of each link with each object.
        links: where the links are ``(L,)``.
        motion: how they move.
    """
    own = np.array([float(thing.stiffness) for thing in world.things])
    springs = own[:, None] * np.asarray(world.scene.contributions)
    thing, link = np.nonzero((np.asarray(contacts.present) > 0) & (springs > 0))
    points, normals, depths = (
        np.asarray(getattr(contacts, name))[thing, link] for name in ("points", "normals", "depths")
    )
    friction, torsion = (
        np.array([float(getattr(each, name) or 0) for each in world.things])[thing] for name in ("friction", "torsion")
    )
    moving = Motions(motion.linear[link], motion.angular[link])
    carried = velocity_at(moving, links.origin[link], points)
    turning = np.where(torsion > 0, np.sum(moving.angular * normals, -1), 0)
    hand, pressed = np.full(len(thing), HAND), springs[thing, link]
    return ContactList(thing, hand, points, normals, -depths, friction, pressed, carried, torsion, turning)


def still_links(hand: Hand) -> tuple[Pose, Motions]:
    """Links of a hand that does not move, wherever it is."""
    nowhere = np.zeros((len(hand.links), 3))
    return Pose(nowhere, np.broadcast_to(np.eye(3), (len(nowhere), 3, 3))), Motions(nowhere, nowhere)


def together(one: ContactList, other: ContactList) -> ContactList:
    """Both."""
    return ContactList(*(np.concatenate(parts) for parts in zip(one, other, strict=True)))
