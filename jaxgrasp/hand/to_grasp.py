"""Grasps from contacts, with the squeezing force of each link (eq. 6)."""

import jax.numpy as jnp
from jax import Array

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Hand
from jaxgrasp.model.squeeze import Contributions, squeezing
from jaxgrasp.validation.checked import checked

THUMB, PALM = 2.0, 1.0
"""Contributions of each of the thumb's and the palm's links, which Table I does not name: ours."""


@checked
def link_contributions(
    hand: Hand, table: Contributions | None = None, thumb: float = THUMB, palm: float = PALM
) -> Float[Array, "L"]:
    """Return the contribution c of each link of a hand to a grip.

    Args:
        hand: whose links are asked for.
        table: by finger and phalanx, such as [`jaxgrasp.grip.CYLINDRICAL_POWER_GRIP`][]; ``None`` for 1 everywhere.
        thumb: of each of the thumb's links, where the table does not name it.
        palm: of each finger's part of the palm, likewise.

    Returns:
        ``(L,)``, dimensionless; 1 for links that are no phalanx, which no table names.

    Raises:
        KeyError: for a phalanx that is in neither.
    """
    if table is None:
        return jnp.ones(len(hand.links))
    values = []
    for link in hand.links:
        if not link.phalanx:
            values.append(1.0)
        elif link.finger not in table.fingers and link.finger == "thumb":
            values.append(thumb)
        elif link.phalanx not in table.phalanges and link.phalanx in ("palm", "heel"):
            values.append(palm)
        else:
            values.append(table.of(link.finger, link.phalanx))
    return jnp.array(values)


@checked
def grasp_from_contacts(
    contacts: Contacts,
    friction: Float[AnyArray, "*#batch"] | float,
    stiffness: Float[AnyArray, "*#batch"] | float,
    contributions: Float[AnyArray, "L"] | float = 1.0,
    torsion: Float[AnyArray, "*#batch"] | float | None = None,
) -> Grasp:
    """Build the Grasp of contacts, with squeezing forces by eq. 6.

    Args:
        contacts: of a posed hand, in the world.
        friction: Coulomb coefficients, for each contact or for all.
        stiffness: K of each contact or of all [N/m]; of two springs in series, object and fingertip, that is
            1 / (1 / K_object + 1 / K_finger).
        contributions: c of each link, as from [`jaxgrasp.hand.link_contributions`][].
        torsion: torsional friction of soft fingers, for each contact or for all [m]; all are hard where not given.

    Returns:
        Contacts of the world's frame, in which the wrench must be written too.
    """
    depths = contacts.depths

    def per_contact(coefficient: AnyArray | float) -> Array:
        return jnp.broadcast_to(jnp.asarray(coefficient, depths.dtype), depths.shape)

    return Grasp(
        points=contacts.points,
        normals=contacts.normals,
        friction=per_contact(friction),
        squeeze=squeezing(contributions, stiffness, depths),
        present=contacts.present,
        torsion=None if torsion is None else per_contact(torsion),
    )


def grasp_about(
    origin: Float[AnyArray, "*batch 3"],
    contacts: Contacts,
    friction: Float[AnyArray, "*#each"] | float,
    stiffness: Float[AnyArray, "*#each"] | float,
    contributions: Float[AnyArray, "L"] | float,
    torsion: Float[AnyArray, "*#each"] | float | None = None,
) -> Grasp:
    """Build the Grasp of contacts in a frame at this place of the world, along the world's axes."""
    world = grasp_from_contacts(contacts, friction, stiffness, contributions, torsion)
    points = world.points - jnp.asarray(origin)[..., None, :]
    return Grasp(points, world.normals, world.friction, world.squeeze, world.present, world.torsion)
