"""Whether a stack stands as it is: one balance of forces over all its objects, with what proves the answer."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.validation.checked import checked
from jaxgrasp.world.contact_list import ContactList, hand_contact_list, still_links, together, world_contact_list
from jaxgrasp.world.impulse_program import jacobian, least_constraint, loads_of, mobilities_of
from jaxgrasp.world.many_bodies import World, masses
from jaxgrasp.world.physics import Loads

TOUCHING = 1e-4
"""Solids no further apart than that touch [m]."""
BALANCED = 1e-9
"""Part of free fall, by its energy, that may be left where forces are shown to hold: rounding."""
NEARLY = 1e-2
"""Part of free fall below which forces close by are looked for that leave nothing."""
FALLING = 1e-4
"""The part above which what is left proves a fall: an interior point ends at the root of its gap."""
HARDLY = (1e-3, 0.0)
"""Parts of the largest force below which contacts are first taken to press not at all."""
INSIDE = 1e-9
"""Part of the largest force by which one may be out of its cone: rounding."""


class Standing(NamedTuple):
    """Whether N objects can stay where they are, at rest."""

    stands: bool
    """Whether forces in all friction cones hold all of them: then these are such forces, to rounding."""
    proved: bool
    """Whether that is proved, by these forces or by the certificate; if not, it could not be decided."""
    contacts: ContactList
    forces: Float[np.ndarray, "m 3"]
    """On the first object of each contact [N]: those that leave least, by how what is left would move the objects."""
    loads: Loads
    left: Float[np.ndarray, "N 6"]
    """What they leave of each object's weight, about its centre [N, N.m]: nothing of one that stands."""
    certificate: Float[np.ndarray, "N 6"]
    """How what is left sets the objects in motion [m/s^2, rad/s^2]. Where they do not stand it proves so: gravity works
    along this motion, and no contact can work against it (Farkas' lemma)."""
    moments: Float[np.ndarray, "m"] | None = None
    """About the normals of soft fingers, on the first object [N.m]; None where all fingers are hard."""


@checked
def stands(world: World, placed: Pose, contacts: Contacts | None = None) -> Standing:
    """Whether objects that lean on one another, on the table, on obstacles, and on a hand stay at rest.

    Friction is Coulomb's and what touches is rigid: that forces hold is necessary for a stack to stand, and that nature
    chooses such forces is assumed. Of all that hold, those of the least squares are shown.

    Args:
        world: the objects, and what stands around them.
        placed: where they are ``(N,)``.
        contacts: of a hand with them ``(N, L)``, which then helps with whatever its friction allows.

    Returns:
        A Standing: whether they stay, what each contact carries, and what proves that they do not.

    Raises:
        ValueError: for shapes that no object has.
    """
    weights, scene = masses(world.things), world.scene
    placed = Pose(np.asarray(placed.origin, float), np.asarray(placed.rotation, float))
    found = world_contact_list(world, placed, TOUCHING)
    if contacts is not None:
        found = together(found, hand_contact_list(world, contacts, *still_links(scene.hand)))
    pull = np.zeros((len(weights.mass), 6))
    pull[:, :3] = weights.mass[:, None] * np.asarray(scene.gravity)
    agile = mobilities_of(world, weights, placed)
    seen = jacobian(found, placed.origin)
    rows = seen.rows
    falling = np.einsum("nij,nj->ni", agile, pull)
    approach = np.einsum("minj,nj->mi", rows, falling)
    answer = least_constraint(rows, found.friction, agile, approach, np.zeros(len(found.first)))
    own = answer.along

    def share_left(forces: np.ndarray) -> float:
        """What they leave of free fall; by energy, since what a guide carries works nowhere."""
        left = pull + np.einsum("minj,mi->nj", rows, forces)
        return float(np.sqrt(max(0.0, np.einsum("ni,nij,nj", left, agile, left) / np.sum(pull * falling))))

    share = share_left(own)
    if share < NEARLY:
        for least in HARDLY:
            closer = _balanced(rows, agile, np.where(own[:, :1] >= least * own.max(initial=0), own, 0), falling)
            if _allowed(closer, found.friction) and share_left(closer) <= BALANCED:
                own, share = closer, share_left(closer)
                break
    left = pull + np.einsum("minj,mi->nj", rows, own)
    certificate = np.einsum("nij,nj->ni", agile, left)
    loads = loads_of(found, seen, placed, own)
    rests = bool(share <= BALANCED)
    proved = rests or (answer.solved and bool(share >= FALLING))
    return Standing(rests, proved, found, seen.forces(own), loads, left, certificate, seen.moments(own))


def _balanced(rows: np.ndarray, agile: np.ndarray, forces: np.ndarray, falling: np.ndarray) -> np.ndarray:
    """Forces ``(m, d)`` close to others that nearly balance, which do so to rounding if any that are as large do.

    The least change, of each contact in units of its normal force: what does not press stays so.
    """
    sizes = np.repeat(np.maximum(forces[:, 0], 0), forces.shape[1])
    moves = np.einsum("nij,mknj->nimk", agile, rows).reshape(falling.size, -1)
    left = falling.ravel() + moves @ forces.ravel()
    change, *_ = np.linalg.lstsq(moves * sizes, -left, rcond=None)
    return forces + (sizes * change).reshape(forces.shape)


def _allowed(forces: np.ndarray, friction: np.ndarray) -> bool:
    """Whether forces by the rows of their contacts are in their cones."""
    across = np.linalg.norm(forces[:, 1:], axis=1)
    rounding = INSIDE * np.abs(forces).max(initial=0)
    return bool(np.all((forces[:, 0] >= -rounding) & (across <= friction * forces[:, 0] + rounding)))
