"""Impulses of all contacts of a world in one step, by one cone program over the motions of all its objects.

    minimise  y.y / 2 + p.R p / 2   subject to   J (v + B y) + R p   in the duals of the friction cones,   B B^T = M^-1

The solution is the motion closest to the free motion v among all that the contacts allow, by the kinetic energy of the
difference: Gauss's principle of least constraint, with friction as Anitescu ("Optimization-based simulation of
nonsmooth rigid multibody dynamics", 2006) makes it convex. The impulses p are its multipliers; R is the
compliance of springs. A body that slides at a speed v therefore rises from its support by mu v in a unit of time, and
hovers at mu v dt.

An impulse has three components, and a fourth where fingers are soft: the moment about the normal, in units that keep
the cone round. There are six unknowns for each object, however many contacts it has.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrasp.grip.motion import mobility
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.numerics.centring import tangents
from jaxgrasp.numerics.compiled_code import jit_here, padded_size
from jaxgrasp.numerics.cone_program import ConeProgram, Cones, solve
from jaxgrasp.world.contact_list import ContactList
from jaxgrasp.world.many_bodies import Masses, World
from jaxgrasp.world.physics import Loads, summed_loads

SIZES = (16, 64, 256, 1024)
"""Numbers of contacts for which a program is compiled."""
MIN_COMPLIANCE = 1e-9
"""Compliance of every contact, in units of its own: impulses stay bounded even where a guide blocks all motion."""
CLOSE = 1e-7
"""Largest gap and errors of a solved program of order one."""


class Impulses(NamedTuple):
    """Solution of the cone program of one step."""

    along: Float[np.ndarray, "m d"]
    """Impulses on the first object of each contact, in the rows of its ``jacobian``: along the normal, tangential, and
    for soft fingers the spin component [N.s]."""
    on_bodies: Float[np.ndarray, "N 6"]
    """Resultant impulses about the objects' centres [N.s, N.m.s]."""
    solved: bool
    """True if the program's gap and errors are below ``CLOSE``."""


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


class ContactRows(NamedTuple):
    """Contact Jacobian: from motions of the objects to relative velocities, and from impulses to forces and moments."""

    rows: Float[np.ndarray, "m d N 6"]
    """Speed along each contact's axes, the normal first, and where any finger is soft that of its spin component, for
    motions of all objects."""
    axes: Float[np.ndarray, "m 3 3"]
    """Axes of each contact, as rows."""
    spin_radius: Float[np.ndarray, "m"]

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


def jacobian(contacts: ContactList, centers: Float[AnyArray, "N 3"]) -> ContactRows:
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
    return ContactRows(rows, axes, radius)


def loads_of(contacts: ContactList, contact_rows: ContactRows, placed: Pose, along: Float[np.ndarray, "m d"]) -> Loads:
    """Sum forces and moments with these components [N] along the contacts' rows into loads on the objects."""
    owners, moments = np.stack([contacts.first, contacts.second], 1), contact_rows.moments(along)
    couples = None if moments is None else moments[:, None] * contacts.normals
    return summed_loads(owners, contacts.points, contact_rows.forces(along), placed.origin, couples)


def least_constraint(
    rows: Float[np.ndarray, "m d N 6"],
    friction: Float[np.ndarray, "m"],
    mobilities: Float[np.ndarray, "N 6 6"],
    approach: Float[np.ndarray, "m d"],
    compliance: Float[np.ndarray, "m"],
) -> Impulses:
    """Solve for the impulses that keep bodies apart, by the cone program of the module's docstring.

    Args:
        rows: contact Jacobian, from ``jacobian``.
        friction: Coulomb's coefficient of each contact.
        mobilities: velocity by impulse of each object.
        approach: separation velocity without impulses, less the allowed one, along the axes [m/s].
        compliance: compliance of springs, speed by impulse [1/kg]; 0 for rigid contacts.
    """
    count, d, n, _ = rows.shape
    no_impulses = Impulses(np.zeros((count, d)), np.zeros((n, 6)), True)
    if np.all(approach[:, 0] >= friction * np.linalg.norm(approach[:, 1:], axis=1)):
        return no_impulses
    eigenvalues, eigenvectors = np.linalg.eigh(mobilities)
    roots = eigenvectors * np.sqrt(np.maximum(eigenvalues, 0))[:, None]
    whitened_rows = np.einsum("minj,njk->mink", rows, roots).reshape(count, d, 6 * n)
    # B = M^(-1/2): whitened rows J B. Each contact in units of its own, and all so that the program is of order one.
    units = 1 / np.sqrt(((whitened_rows**2).sum((1, 2)) + compliance) / d)
    scaled_rows, right = units[:, None, None] * whitened_rows, units[:, None] * approach
    largest = np.abs(right).max()
    padded = _pad_program(scaled_rows, right / largest, friction, units**2 * compliance, padded_size(count, SIZES))
    multipliers, solved = jax.device_get(_program()(*padded))
    # Multipliers of the scaled rows back to impulses [N.s]; the normal row was divided by mu.
    along = multipliers[:count] * (largest * units)[:, None]
    along[:, 0] /= np.where(friction > 0, friction, 1)
    return Impulses(along, np.einsum("minj,mi->nj", rows, along), bool(solved))


def _pad_program(
    scaled_rows: np.ndarray, right: np.ndarray, friction: np.ndarray, compliance: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pad the program to ``size`` contacts: rows, offsets and compliances of round cones. Padding rows are zero and
    carry no impulse; neither do the tangential rows of contacts without friction."""
    count, d, unknowns = scaled_rows.shape
    rows, offset, compliances = np.zeros((size, d, unknowns)), np.zeros((size, d)), np.zeros(size)
    offset[count:, 0] = 1
    steep = np.where(friction > 0, friction, 1)
    rows[:count, 0], offset[:count, 0] = -scaled_rows[:, 0] / steep[:, None], right[:, 0] / steep
    rubs = friction > 0
    rows[:count, 1:][rubs], offset[:count, 1:][rubs] = -scaled_rows[rubs, 1:], right[rubs, 1:]
    compliances[:count] = MIN_COMPLIANCE + compliance / steep**2
    return rows, offset, compliances


def compile_programs(n_bodies: int, max_contacts: int, is_soft: bool) -> None:
    """Compile the programs for these numbers of objects and contacts ahead of their first use."""
    largest = padded_size(max_contacts, SIZES)
    for size in sorted({size for size in (*SIZES, largest) if size <= largest}):
        for d in (3, 4) if is_soft else (3,):
            _program()(np.zeros((size, d, 6 * n_bodies)), np.tile(np.eye(d)[0], (size, 1)), np.zeros(size))


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
