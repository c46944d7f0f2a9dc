"""Contacts of an object with the world, that is a table, an obstacle or another object, and their wrench."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.shapes import Shape
from jaxgrasp.hand.sphere_tree import SphereTree
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Link, Pose, Posture, padded
from jaxgrasp.validation.checked import checked

OCTANTS = tuple("".join("-+"[up] + axis for up, axis in zip(ups, "xyz", strict=True)) for ups in np.ndindex(2, 2, 2))


@checked
def rigid_body(tree: SphereTree) -> Hand:
    """Convert an object to a Hand without joints and with a link for each octant, to find contacts as a hand does.

    The contacts of each part merge into one, by the rule of [`jaxgrasp.hand.find_contacts`][]; so a box that stands on
    a table has four.

    Args:
        tree: of the object, in whose frame the octants lie about the middle of what it fills.
    """
    centers, radii = np.asarray(tree.balls.centers), np.asarray(tree.balls.radii)
    middle = (np.min(centers - radii[:, None], 0) + np.max(centers + radii[:, None], 0)) / 2
    octant = (centers > middle) @ np.array([4, 2, 1])
    return Hand(
        origins=jnp.zeros((0, 3)),
        rests=jnp.zeros((0, 3, 3)),
        axes=jnp.zeros((0, 3)),
        lower=jnp.zeros(0),
        upper=jnp.zeros(0),
        skin=padded([(centers[octant == part], radii[octant == part]) for part in range(8)]),
        parents=(),
        joints=(),
        links=tuple(Link(name, "", -1) for name in OCTANTS),
    )


@checked
def world_contacts(body: Hand, placed: Pose, obstacle: Shape, at: Pose) -> Contacts:
    """Find the contacts of an object with an obstacle in the world.

    Args:
        body: from [`jaxgrasp.hand.rigid_body`][]; one for all poses.
        placed: where the object stands; any leading axes.
        obstacle: an exact shape, or the tree of another object.
        at: where that stands; leading axes that broadcast.

    Returns:
        A contact for each octant, in the world, on the obstacle's surface; normals point INTO the object that
        ``body`` is, as those of a hand's contacts with it do.
    """
    origin = jnp.asarray(placed.origin)
    posture = Posture(Pose(origin, jnp.asarray(placed.rotation)), jnp.zeros((*origin.shape[:-1], 0), origin.dtype))
    contacts = find_contacts(body, posture, obstacle, at)
    return Contacts(contacts.points, -contacts.normals, contacts.depths, contacts.present, contacts.tests)


@checked
def spring_wrench(
    contacts: Contacts, stiffness: Float[AnyArray, "*#batch"] | float, about: Float[AnyArray, "*#batch 3"]
) -> Float[Array, "*batch 6"]:
    """Compute the wrench of contacts on the object: K depth along each normal, without friction (eq. 1).

    Subtract it from the wrench that the hand must exert.

    Args:
        contacts: with normals into that object ``(..., L)``.
        stiffness: K of each contact, or of all [N/m].
        about: the point ``(..., 3)`` that torques are taken about, in the contacts' frame [m].

    Returns:
        Force, then torque [N, N.m].
    """
    forces = (jnp.asarray(stiffness) * contacts.depths)[..., None] * contacts.normals
    arms = contacts.points - jnp.asarray(about)[..., None, :]
    return jnp.concatenate([jnp.sum(forces, -2), jnp.sum(jnp.cross(arms, forces), -2)], -1)
