"""Stability of a stack: one balance of forces over all its objects, with a proof of the result.

    minimise  y.y / 2 + f.R f / 2   subject to   J (a + B y) + R f   in the duals of the friction cones,   B B^T = M^-1

The solution is the acceleration closest to free fall a among all that the contacts allow, by the energy of the
difference: Gauss's principle of least constraint. The forces f are its multipliers; R is a trace of compliance.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.hand.detection import Contacts
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import Hand, Pose
from jaxgrasp.numerics.compiled_code import jit_here, padded_size
from jaxgrasp.numerics.cone_program import ConeProgram, Cones, solve
from jaxgrasp.validation.checked import checked
from jaxgrasp.world.contact_list import (
    SIZES,
    ContactJacobian,
    ContactList,
    hand_contact_list,
    jacobian,
    loads_of,
    mobilities_of,
    mobility_roots,
    together,
    world_contact_list,
)
from jaxgrasp.world.many_bodies import Loads, Motions, World, masses

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
MIN_COMPLIANCE = 1e-9
"""Compliance of every contact, in units of its own: forces stay bounded even where a guide blocks all motion."""
CLOSE = 1e-7
"""Largest gap and errors of a solved program of order one."""


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
        contact_list = together(contact_list, hand_contact_list(world, contacts, *_still_links(scene.hand)))
    weight = np.zeros((len(weights.mass), 6))
    weight[:, :3] = weights.mass[:, None] * np.asarray(scene.gravity)
    mobilities = mobilities_of(world, weights, placed)
    contact_jacobian = jacobian(contact_list, placed.origin)
    rows = contact_jacobian.rows
    free_fall = np.einsum("nij,nj->ni", mobilities, weight)
    approach = np.einsum("minj,nj->mi", rows, free_fall)
    components, is_solved = _least_constraint(contact_jacobian, contact_list.friction, mobilities, approach)

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
    loads = loads_of(contact_list, contact_jacobian, placed, components)
    rests = bool(relative <= BALANCED)
    proved = rests or (is_solved and bool(relative >= FALLING))
    return Standing(
        rests,
        proved,
        contact_list,
        contact_jacobian.forces(components),
        loads,
        residual,
        certificate,
        contact_jacobian.moments(components),
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


def _still_links(hand: Hand) -> tuple[Pose, Motions]:
    """Return poses and zero velocities for the links of a hand that does not move; its place is irrelevant then."""
    nowhere = np.zeros((len(hand.links), 3))
    return Pose(nowhere, np.broadcast_to(np.eye(3), (len(nowhere), 3, 3))), Motions(nowhere, nowhere)


def _least_constraint(
    contact_jacobian: ContactJacobian,
    friction: Float[np.ndarray, "m"],
    mobilities: Float[np.ndarray, "N 6 6"],
    approach: Float[np.ndarray, "m d"],
) -> tuple[Float[np.ndarray, "m d"], bool]:
    """Solve for the forces that keep resting objects apart, by the cone program of the module's docstring.

    Args:
        contact_jacobian: contact Jacobian, from ``jacobian``.
        friction: Coulomb's coefficient of each contact.
        mobilities: acceleration by force of each object.
        approach: acceleration of the contacts in free fall, along their axes [m/s^2].

    Returns:
        The forces in the rows of the Jacobian [N], and True if the program's gap and errors are below ``CLOSE``.
    """
    count, d = approach.shape
    if np.all(approach[:, 0] >= friction * np.linalg.norm(approach[:, 1:], axis=1)):
        return np.zeros((count, d)), True
    # Rows J B. Each contact in units of its own, and all so that the program is of order one.
    whitened_rows = contact_jacobian.in_units_of(mobility_roots(mobilities))
    units = 1 / np.sqrt((whitened_rows**2).sum((1, 2)) / d)
    scaled_rows, right = units[:, None, None] * whitened_rows, units[:, None] * approach
    largest = np.abs(right).max()
    padded = _pad_program(scaled_rows, right / largest, friction, padded_size(count, SIZES))
    multipliers, is_solved = jax.device_get(_program()(*padded))
    # Multipliers of the scaled rows back to forces [N]; the normal row was divided by mu.
    forces = multipliers[:count] * (largest * units)[:, None]
    forces[:, 0] /= np.where(friction > 0, friction, 1)
    return forces, bool(is_solved)


def _pad_program(
    scaled_rows: np.ndarray, right: np.ndarray, friction: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pad the program to ``size`` contacts: rows, offsets and compliances of round cones. Padding rows are zero and
    carry no force; neither do the tangential rows of contacts without friction."""
    count, d, unknowns = scaled_rows.shape
    rows, offset, compliances = np.zeros((size, d, unknowns)), np.zeros((size, d)), np.zeros(size)
    offset[count:, 0] = 1
    rubs = friction > 0
    steep = np.where(rubs, friction, 1)
    rows[:count, 0], offset[:count, 0] = -scaled_rows[:, 0] / steep[:, None], right[:, 0] / steep
    rows[:count, 1:][rubs], offset[:count, 1:][rubs] = -scaled_rows[rubs, 1:], right[rubs, 1:]
    compliances[:count] = MIN_COMPLIANCE
    return rows, offset, compliances


@cache
def _program() -> Any:
    return jit_here(_solve_program)


def _solve_program(rows: jax.Array, offset: jax.Array, compliance: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Solve the program; return its multipliers, and whether gap and errors are below ``CLOSE``."""
    unknowns = rows.shape[-1]
    no_equations = jnp.zeros((1, 1, unknowns)), jnp.zeros((1, 1))
    cones = (Cones(rows[None], offset[None], compliance[None]),)
    result = solve(ConeProgram(jnp.eye(unknowns)[None], jnp.zeros((1, unknowns)), *no_equations, cones))
    duals = result.duals[0][0]
    scale = jnp.sum(result.point[0] ** 2) + jnp.sum(compliance * duals[:, 0] ** 2)
    return duals, (result.gap[0] <= CLOSE * scale) & (result.error[0] <= CLOSE)
