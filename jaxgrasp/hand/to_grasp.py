"""Grasps from contacts: the kind of the grip, the contribution of each link to it, and squeezing forces by eq. 6.

With Table I, which is of a hand whose palm and thumb it leaves out, contributions are such that a grip's squeezing
forces balance.
"""

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Hand, Posture
from jaxgrasp.model.squeeze import (
    CYLINDRICAL_POWER_GRIP,
    SPHERICAL_POWER_GRIP,
    Contributions,
    precision_contributions,
    squeezing,
)
from jaxgrasp.numerics.small_minimisers import minimise_nonnegative
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


FINGERS = ("index", "middle", "ring", "little")
SIDEWAYS = 0.7
"""Cosine of the angle between a contact's normal and the finger's flexion axis, from which its side touches."""
FLAT = 0.09
"""Share of the normals' squares outside their best plane, up to which they count as lying in it.

Closed on spheres of 20 to 50 mm radius, hands of 0.16 to 0.21 m show 0.11 to 0.23; on cylinders and boxes that are
longer than the hand is broad, 0 to 0.07, which is fingers that touch their ends. All directions alike are 1/3.
"""


class GripType(IntEnum):
    """Kinds of grips. The codes are stable in files; that of a precision grip is its number of fingers."""

    NONE = 0
    """No link touches."""
    UNKNOWN = 1
    """None of the others, or data that are not numbers."""
    PRECISION_2 = 2
    PRECISION_3 = 3
    PRECISION_4 = 4
    PRECISION_5 = 5
    LATERAL = 6
    CYLINDRICAL_POWER = 7
    SPHERICAL_POWER = 8


CONTRIBUTIONS: Mapping[GripType, Contributions] = MappingProxyType(
    {
        GripType.PRECISION_2: precision_contributions(2),
        GripType.PRECISION_3: precision_contributions(3),
        GripType.PRECISION_4: precision_contributions(4),
        GripType.PRECISION_5: precision_contributions(5),
        GripType.LATERAL: precision_contributions(2),
        GripType.CYLINDRICAL_POWER: CYLINDRICAL_POWER_GRIP,
        GripType.SPHERICAL_POWER: SPHERICAL_POWER_GRIP,
    }
)
"""Tables with a source: the paper's for a cylindrical power grip, measurements and equilibrium for precision grips and
the lateral pinch, and a measurement for a spherical power grip."""


@checked
@jax.jit
def grip_type(hand: Hand, posture: Posture, contacts: Contacts) -> Int[Array, "*batch"]:
    """Classify the grip by the links that touch and by their normals.

    The classes are Cutkosky's (IEEE Trans. Robotics and Automation 5(3):269-279, 1989); the thresholds are ours.

    - LATERAL: the thumb and the index alone touch, and the index does with its sides.
    - PRECISION: fingertips alone touch, the thumb's among them.
    - Power: the palm or a proximal phalanx touches, and at least two fingers do beyond it. SPHERICAL where the
      normals span three dimensions, CYLINDRICAL where they lie in a plane, as about any prism: by the least
      eigenvalue of their second moment.

    Args:
        hand: with links named as by [`jaxgrasp.hand.human_hand`][]; others touch for no grip that is known here.
        posture: any leading axes.
        contacts: of that posture, in the world.

    Returns:
        Codes of a [`jaxgrasp.grip.GripType`][]; of what the hand does now, with no memory of what it did.
    """
    touches = contacts.present > 0.5

    def select_touching(*phalanges: str, finger: str | None = None) -> Array:
        """Select the links ``(..., links)`` of these phalanges, of one finger or of all but the thumb."""
        fingers = FINGERS if finger is None else (finger,)
        return touches[..., _rows(hand, lambda link: link.finger in fingers and link.phalanx in phalanges)]

    def count(mask: Array) -> Array:
        return jnp.sum(mask, -1)

    total = count(touches)
    thumb = count(select_touching("metacarpal", "proximal", "distal", finger="thumb"))
    index = count(select_touching("proximal", "middle", "distal", finger="index"))
    tips, thumb_tip = count(select_touching("distal")), count(select_touching("distal", finger="thumb"))
    wrapping = sum(jnp.any(select_touching("middle", "distal", finger=finger), -1) for finger in FINGERS)
    lateral = (thumb > 0) & (index > 0) & (thumb + index == total) & ~_faces(hand, posture, contacts, touches)
    precision = (thumb_tip > 0) & (tips > 0) & (tips + thumb_tip == total)
    power = (count(select_touching("palm", "heel", "proximal")) > 0) & (wrapping > 1)
    cases = [
        (jnp.any(jnp.isnan(contacts.present), -1), GripType.UNKNOWN),
        (total == 0, GripType.NONE),
        (lateral, GripType.LATERAL),
        (precision, tips + thumb_tip),
        (power & (_out_of_plane(contacts, touches) > FLAT), GripType.SPHERICAL_POWER),
        (power, GripType.CYLINDRICAL_POWER),
    ]
    conditions, codes = zip(*cases, strict=True)
    return jnp.select(conditions, [jnp.asarray(code, jnp.int32) for code in codes], GripType.UNKNOWN).astype(jnp.int32)


@checked
def contributions_of(
    hand: Hand, grip: GripType, tables: Mapping[GripType, Contributions] = CONTRIBUTIONS
) -> Float[Array, "L"]:
    """Return the contribution c of each link to a kind of grip (eq. 6).

    Args:
        hand: whose links are asked for.
        grip: of the kind that they make.
        tables: of each kind; 1 for every link of those that it lacks. The paper has one alone, of the cylindrical
            power grip (Table I); those of precision grips (``jaxgrasp.model.squeeze.precision_contributions``) and of
            the spherical power grip (``SPHERICAL_POWER_GRIP`` there) are measured.
            ``{**CONTRIBUTIONS, GripType.SPHERICAL_POWER: mine}`` replaces one.

    Raises:
        KeyError: for a link that the grip's table lacks, but for thumb and palm.
    """
    return link_contributions(hand, tables.get(GripType(grip)))


def _rows(hand: Hand, is_selected) -> np.ndarray:
    return np.array([i for i, link in enumerate(hand.links) if is_selected(link)], int)


def _faces(hand: Hand, posture: Posture, contacts: Contacts, touches: Array) -> Array:
    """Tell whether the index finger touches with a face other than its sides."""
    rows = _rows(hand, lambda link: link.finger == "index" and link.joint >= 0)
    hinges = np.array([hand.links[i].joint for i in rows], int)
    axes = pose_hand(hand, posture).axes[..., hinges, :]
    sideways = jnp.abs(jnp.sum(contacts.normals[..., rows, :] * axes, -1))
    return jnp.any(touches[..., rows] & (sideways < SIDEWAYS), -1)


def _out_of_plane(contacts: Contacts, touches: Array) -> Array:
    """Compute the share of the normals' squares outside their best plane, 0 to 1/3."""
    normals = jnp.where(touches[..., None], contacts.normals, 0)
    moment = jnp.einsum("...li,...lj->...ij", normals, normals)
    return jnp.linalg.eigvalsh(moment)[..., 0] / jnp.maximum(jnp.sum(touches, -1), 1)


FAITHFUL = 0.1
"""Cost of leaving a contribution, in units of the unbalanced force that this saves."""


@checked
def balanced_contributions(
    contacts: Contacts, contributions: Float[AnyArray, "L"], centre: Float[AnyArray, "3"]
) -> Float[Array, "L"]:
    """Compute the contributions nearest to the given ones with which the squeezing forces (eq. 6) balance.

    Squeezing forces that leave much of themselves unbalanced are what takes method B out of the friction cones: it
    spreads what balances them over all contacts, by their weights. Links that do not touch keep their contribution,
    and those that do share the same total of squeezing as before.

    Args:
        contacts: of the closed hand, one posture's.
        contributions: of each link, such as [`jaxgrasp.grip.contributions_of`][] gives.
        centre: of the object, in the world [m].

    Returns:
        ``(L,)``, none negative. The squeezing forces by them balance as far as forces along the normals can.
    """
    depths = jnp.maximum(contacts.depths, 0) * contacts.present
    return _balanced(depths, contacts.points, contacts.normals, jnp.asarray(contributions, depths.dtype), centre)


@jax.jit
def _balanced(depths: Array, points: Array, normals: Array, contributions: Array, centre: Array) -> Array:
    touches = depths > 0
    arms = jnp.where(touches[:, None], points - centre, 0)
    length = jnp.sqrt(jnp.sum(arms**2) / jnp.maximum(jnp.sum(touches), 1))
    length = jnp.where(length > 0, length, 1)
    # Each contact's wrench for a unit of its contribution, lengths in those of the grip, depths in their mean.
    relative_depths = depths / jnp.where(jnp.any(touches), jnp.sum(depths) / jnp.maximum(jnp.sum(touches), 1), 1)
    wrenches = jnp.concatenate([normals, jnp.cross(arms, normals) / length], -1) * relative_depths[:, None]
    closeness = jnp.diag((FAITHFUL * relative_depths) ** 2)
    # minimise |W' c|^2 + |D (c - c_0)|^2 over c >= 0, with D = FAITHFUL x relative depth
    balanced = minimise_nonnegative(wrenches @ wrenches.T + closeness, -closeness @ contributions)
    total_before, total_after = depths @ contributions, depths @ balanced
    scale = jnp.where(total_after > 0, total_before / jnp.where(total_after > 0, total_after, 1), 1)
    return jnp.where(touches, scale * balanced, contributions)
