"""Contacts of all objects of a world, and their Jacobian: relative velocities by the motions of the objects.

A velocity at a contact has three components, and a fourth where fingers are soft: the speed of spin about the normal,
in units that keep the friction cone round. There are six unknowns for each object, however many contacts it has.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxgrasp.grip.motion import mobility
from jaxgrasp.grip.scene import Obstacle
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.hand import Pose
from jaxgrasp.numerics.geometry import tangents
from jaxgrasp.world.many_bodies import HAND, OBSTACLES, TABLE, Loads, Masses, Motions, World, summed_loads, velocity_at
from jaxgrasp.world.solids import ContactManifold, manifold_between, solid_of, table_manifold

SIZES = (16, 64, 256, 1024)
"""Numbers of contacts for which programs are compiled."""


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
        for point, gap, velocity in zip(manifold.points, manifold.gaps, carried, strict=True):
            self.rows.append((first, second, point, manifold.normal, gap, friction, stiffness, velocity, 0.0, 0.0))

    def to_list(self) -> ContactList:
        empty = [np.zeros((0, *tail), kind) for tail, kind in COLUMNS]
        return ContactList._make([np.array(column) for column in zip(*self.rows, strict=True)] or empty)


def world_contact_list(
    world: World, placed: Pose, within: float, obstacles: tuple[Obstacle, ...] | None = None
) -> ContactList:
    """List the contacts of objects with each other, the table and obstacles, up to a gap of ``within`` [m].
    ``obstacles`` replaces those of the scene, at their current poses, where any moves."""
    rigid_bodies, rows = world.bodies, _Rows()
    placed_solids = [
        solid_of(member.body.shape, Pose(origin, rotation))
        for member, origin, rotation in zip(rigid_bodies, placed.origin, placed.rotation, strict=True)
    ]
    rubbing = [float(rigid_body.rubbing) for rigid_body in rigid_bodies]
    present_obstacles = world.scene.obstacles if obstacles is None else obstacles
    fixed = [(solid_of(obstacle.shape, obstacle.placed), obstacle) for obstacle in present_obstacles]
    for n, solid in enumerate(placed_solids):
        on_table = table_manifold(solid, world.scene.table, within)
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
    rigid_bodies = world.bodies
    body_stiffness = np.array([float(member.stiffness) for member in rigid_bodies])
    springs = body_stiffness[:, None] * np.asarray(world.scene.contributions)
    index, link = np.nonzero((np.asarray(contacts.present) > 0) & (springs > 0))
    points, normals, depths = (
        np.asarray(getattr(contacts, name))[index, link] for name in ("points", "normals", "depths")
    )
    friction, torsion = (
        np.array([float(getattr(member, name) or 0) for member in rigid_bodies])[index]
        for name in ("friction", "torsion")
    )
    link_motion = Motions(motion.linear[link], motion.angular[link])
    carried = velocity_at(link_motion, links.origin[link], points)
    turning = np.where(torsion > 0, np.sum(link_motion.angular * normals, -1), 0)
    hand, contact_stiffness = np.full(len(index), HAND), springs[index, link]
    return ContactList(index, hand, points, normals, -depths, friction, contact_stiffness, carried, torsion, turning)


def together(first: ContactList, second: ContactList) -> ContactList:
    """Concatenate two lists of contacts."""
    return ContactList(*(np.concatenate(parts) for parts in zip(first, second, strict=True)))


def mobilities_of(world: World, weights: Masses, placed: Pose) -> Float[np.ndarray, "N 6 6"]:
    """Compute each object's velocity for an impulse about its centre, M^-1; for a guided object along its guide
    only."""
    mobilities = np.zeros((len(weights.mass), 6, 6))
    mobilities[:, :3, :3] = np.eye(3) / weights.mass[:, None, None]
    mobilities[:, 3:, 3:] = np.linalg.inv(weights.world_inertia(placed.rotation))
    scene = world.scene
    if scene.guide is not None:
        mobilities[0] = _guided(scene.body, Pose(placed.origin[0], placed.rotation[0]), scene.guide)
    return mobilities


_guided = jax.jit(mobility)


def mobility_roots(mobilities: Float[np.ndarray, "N 6 6"]) -> Float[np.ndarray, "N 6 6"]:
    """Return roots B of the mobilities, B B^T = M^-1: in units of B, an impulse changes the motion by itself."""
    eigenvalues, eigenvectors = np.linalg.eigh(mobilities)
    return eigenvectors * np.sqrt(np.maximum(eigenvalues, 0))[:, None]


class ContactJacobian(NamedTuple):
    """Contact Jacobian: from motions of the objects to relative velocities, and from impulses to forces and moments."""

    rows: Float[np.ndarray, "m d N 6"]
    """Speed along each contact's axes, the normal first, and where any finger is soft that of its spin component, for
    motions of all objects."""
    axes: Float[np.ndarray, "m 3 3"]
    """Axes of each contact, as rows."""
    spin_radius: Float[np.ndarray, "m"]

    def in_units_of(self, roots: Float[np.ndarray, "N 6 6"]) -> Float[np.ndarray, "m d k"]:
        """Return the rows J B for roots B of the mobilities, with one axis for the motions of all objects."""
        count, d, n, _ = self.rows.shape
        return np.einsum("minj,njk->mink", self.rows, roots).reshape(count, d, 6 * n)

    def project(self, linear: Float[np.ndarray, "m 3"], turning: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m d"]:
        """Project velocities, and angular velocities about the normals, onto the rows' axes."""
        along, spin = np.einsum("mij,mj->mi", self.axes, linear), (self.spin_radius * turning)[:, None]
        return np.concatenate([along, spin], 1)[:, : self.rows.shape[1]]

    def forces(self, along: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m 3"]:
        """Return force vectors in the world, from components along the rows' axes."""
        return np.einsum("mi,mij->mj", along[:, :3], self.axes)

    def moments(self, along: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m"] | None:
        """Return moments about the normals; None where all fingers are hard."""
        return self.spin_radius * along[:, 3] if along.shape[1] > 3 else None


def jacobian(contacts: ContactList, centers: Float[AnyArray, "N 3"]) -> ContactJacobian:
    """Build the contact Jacobian for objects with these centres."""
    count, n = len(contacts.first), len(centers)
    normals, radius = contacts.normals, contacts.spin_radius
    axes = np.stack([normals, *tangents(normals, np)], 1)
    spins = (radius[:, None] * normals)[:, None][:, : int(radius.any())]
    along = np.concatenate([axes, 0 * spins], 1)
    rows = np.zeros((*along.shape[:2], n, 6))
    index = np.arange(count)
    for sign, owner in ((1.0, contacts.first), (-1.0, contacts.second)):
        is_object = owner >= 0
        arms = contacts.points[is_object] - centers[owner[is_object]]
        turning = np.concatenate([np.cross(arms[:, None], axes[is_object]), spins[is_object]], 1)
        rows[index[is_object], :, owner[is_object]] += sign * np.concatenate([along[is_object], turning], -1)
    return ContactJacobian(rows, axes, radius)


def loads_of(
    contacts: ContactList, contact_jacobian: ContactJacobian, placed: Pose, along: Float[np.ndarray, "m d"]
) -> Loads:
    """Sum forces and moments with these components [N] along the contacts' rows into loads on the objects."""
    owners, moments = np.stack([contacts.first, contacts.second], 1), contact_jacobian.moments(along)
    couples = None if moments is None else moments[:, None] * contacts.normals
    return summed_loads(owners, contacts.points, contact_jacobian.forces(along), placed.origin, couples)
