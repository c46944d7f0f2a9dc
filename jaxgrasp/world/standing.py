"""Stability of a stack: one balance of forces over all its objects, with a proof of the result."""

from typing import NamedTuple

import numpy as np

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.validation.checked import checked
from jaxgrasp.world.impulse_program import (
    ContactList,
    hand_contact_list,
    jacobian,
    least_constraint,
    loads_of,
    mobilities_of,
    still_links,
    together,
    world_contact_list,
)
from jaxgrasp.world.many_bodies import Loads, World, masses

TOUCHING = 1e-4
"""Largest gap of solids in contact [m]."""
BALANCED = 1e-9
"""Largest residual of forces that hold, as a part of free fall by its energy: rounding."""
NEAR_BALANCE = 1e-2
"""Residual below which balanced forces are searched nearby, as a part of free fall."""
FALLING = 1e-4
"""Residual above which a fall is proved, as a part of free fall: an interior point ends at the root of its gap."""
FORCE_THRESHOLDS = (1e-3, 0.0)
"""Parts of the largest force below which normal forces are set to zero, in the order of the attempts."""
CONE_TOLERANCE = 1e-9
"""Tolerance of the friction cones, as a part of the largest force: rounding."""


class Standing(NamedTuple):
    """Result of ``stands``: whether N objects at rest can stay at rest, and the proof."""

    stands: bool
    """True if forces in all friction cones hold all objects; ``forces`` are then such forces, to rounding."""
    proved: bool
    """True if the result is proved, by these forces or by the certificate; False if it is undecided."""
    contacts: ContactList
    forces: Float[np.ndarray, "m 3"]
    """Forces on the first object of each contact [N]: those of least residual, by the motion that it gives to the
    objects."""
    loads: Loads
    residual: Float[np.ndarray, "N 6"]
    """Residual of the balance of each object, about its centre [N, N.m]: zero for a stack that stands."""
    certificate: Float[np.ndarray, "N 6"]
    """Acceleration of the objects by the residual [m/s^2, rad/s^2]. For a stack that does not stand it is the proof:
    gravity works along this motion, and no contact can work against it (Farkas' lemma)."""
    moments: Float[np.ndarray, "m"] | None = None
    """Moments about the normals of soft fingers, on the first object [N.m]; None where all fingers are hard."""


@checked
def stands(world: World, placed: Pose, contacts: Contacts | None = None) -> Standing:
    """Decide whether objects that lean on one another, on the table, on obstacles, and on a hand stay at rest.

    Friction is Coulomb's and contacts are rigid. The existence of holding forces is necessary for a stack to stand;
    that nature selects such forces is assumed. The result has those of least squares.

    Args:
        world: the objects, table, obstacles and hand.
        placed: poses of the objects ``(N,)``.
        contacts: contacts of a hand with them ``(N, L)``, which then helps as far as its friction allows.

    Returns:
        A Standing: whether they stay, the force of each contact, and the proof.

    Raises:
        ValueError: for shapes that are unbounded or not supported.
    """
    weights, scene = masses(world.bodies), world.scene
    placed = Pose(np.asarray(placed.origin, float), np.asarray(placed.rotation, float))
    contact_list = world_contact_list(world, placed, TOUCHING)
    if contacts is not None:
        contact_list = together(contact_list, hand_contact_list(world, contacts, *still_links(scene.hand)))
    weight = np.zeros((len(weights.mass), 6))
    weight[:, :3] = weights.mass[:, None] * np.asarray(scene.gravity)
    mobilities = mobilities_of(world, weights, placed)
    contact_rows = jacobian(contact_list, placed.origin)
    rows = contact_rows.rows
    free_fall = np.einsum("nij,nj->ni", mobilities, weight)
    approach = np.einsum("minj,nj->mi", rows, free_fall)
    impulses = least_constraint(rows, contact_list.friction, mobilities, approach, np.zeros(len(contact_list.first)))
    components = impulses.along

    def relative_residual(forces: np.ndarray) -> float:
        """Return the residual of the balance as a part of free fall, by energy: loads that a guide carries do no
        work."""
        residual = weight + np.einsum("minj,mi->nj", rows, forces)
        return float(
            np.sqrt(max(0.0, np.einsum("ni,nij,nj", residual, mobilities, residual) / np.sum(weight * free_fall)))
        )

    relative = relative_residual(components)
    if relative < NEAR_BALANCE:
        for threshold in FORCE_THRESHOLDS:
            balanced = _balance(
                rows,
                mobilities,
                np.where(components[:, :1] >= threshold * components.max(initial=0), components, 0),
                free_fall,
            )
            if _is_in_cones(balanced, contact_list.friction) and relative_residual(balanced) <= BALANCED:
                components, relative = balanced, relative_residual(balanced)
                break
    residual = weight + np.einsum("minj,mi->nj", rows, components)
    certificate = np.einsum("nij,nj->ni", mobilities, residual)
    loads = loads_of(contact_list, contact_rows, placed, components)
    rests = bool(relative <= BALANCED)
    proved = rests or (impulses.solved and bool(relative >= FALLING))
    return Standing(
        rests,
        proved,
        contact_list,
        contact_rows.forces(components),
        loads,
        residual,
        certificate,
        contact_rows.moments(components),
    )


def _balance(rows: np.ndarray, mobilities: np.ndarray, forces: np.ndarray, free_fall: np.ndarray) -> np.ndarray:
    """Correct nearly balanced forces ``(m, d)`` by the least change that balances them to rounding.

    The change of each contact is measured in units of its normal force, so that contacts without force keep none.
    """
    scales = np.repeat(np.maximum(forces[:, 0], 0), forces.shape[1])
    moves = np.einsum("nij,mknj->nimk", mobilities, rows).reshape(free_fall.size, -1)
    residual = free_fall.ravel() + moves @ forces.ravel()
    change, *_ = np.linalg.lstsq(moves * scales, -residual, rcond=None)
    return forces + (scales * change).reshape(forces.shape)


def _is_in_cones(forces: np.ndarray, friction: np.ndarray) -> bool:
    """Return whether forces in the rows of their contacts are in their friction cones."""
    across = np.linalg.norm(forces[:, 1:], axis=1)
    rounding = CONE_TOLERANCE * np.abs(forces).max(initial=0)
    return bool(np.all((forces[:, 0] >= -rounding) & (across <= friction * forces[:, 0] + rounding)))
