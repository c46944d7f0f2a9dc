"""The impulses of all contacts of a world in one step, by one cone program over the motions of all its objects.

    minimise  y.y / 2 + p.R p / 2   subject to   J (v + B y) + R p   in the duals of the friction cones,   B B^T = M^-1

Of all motions that contacts allow it has the one closest to the motion v without them, by the kinetic energy of the
difference: Gauss's principle of least constraint, with friction as Anitescu ("Optimization-based simulation of
nonsmooth rigid multibody dynamics", 2006) makes it convex. The impulses p are its multipliers; R is what springs give.
What slides at a speed v therefore rises from what it slides on by mu v in a unit of time, and hovers at mu v dt.

An impulse has three components, and where fingers are soft a fourth: that of the moment about the normal, in units by
which the cone stays round. There are six unknowns for each object, however many places it touches.
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
from jaxgrasp.numerics.compiled_code import jit_here
from jaxgrasp.numerics.cone_program import ConeProgram, Cones, solve
from jaxgrasp.world.contact_list import ContactList
from jaxgrasp.world.many_bodies import Masses, World
from jaxgrasp.world.physics import Loads, summed_loads

SIZES = (16, 64, 256, 1024)
"""Numbers of contacts for which a program is compiled."""
GIVING = 1e-9
"""By how much every contact gives, in units of its own: impulses are bounded even where a guide lets nothing yield."""
CLOSE = 1e-7
"""Gap and errors of a program of order one that count as solved."""


class Impulses(NamedTuple):
    """The answer."""

    along: Float[np.ndarray, "m d"]
    """On the first object of each contact, by the rows of its ``jacobian``: along the normal, across it, and of soft
    fingers the spin component [N.s]."""
    on_things: Float[np.ndarray, "N 6"]
    """Their resultants about the objects' centres [N.s, N.m.s]."""
    solved: bool
    """Whether the program's gap and errors are as small as they should be."""


def mobilities_of(world: World, weights: Masses, placed: Pose) -> Float[np.ndarray, "N 6 6"]:
    """Motions of each object by impulse about its centre; of a guided one along its guide alone."""
    found = np.zeros((len(weights.mass), 6, 6))
    found[:, :3, :3] = np.eye(3) / weights.mass[:, None, None]
    found[:, 3:, 3:] = np.linalg.inv(weights.turned(placed.rotation))
    scene = world.scene
    if scene.guide is not None:
        found[0] = _guided(scene.body, Pose(placed.origin[0], placed.rotation[0]), scene.guide)
    return found


_guided = jax.jit(mobility)


class ContactRows(NamedTuple):
    """How what touches moves apart as objects move, and back from impulses to forces and moments."""

    rows: Float[np.ndarray, "m d N 6"]
    """Speed along each contact's axes, the normal first, and where any finger is soft that of its spin component, for
    motions of all objects."""
    axes: Float[np.ndarray, "m 3 3"]
    """The axes, as rows."""
    spin_radius: Float[np.ndarray, "m"]

    def seen(self, linear: Float[np.ndarray, "m 3"], turning: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m d"]:
        """Velocities, and angular velocities about the normals, as the rows have them."""
        along, spin = np.einsum("mij,mj->mi", self.axes, linear), (self.spin_radius * turning)[:, None]
        return np.concatenate([along, spin], 1)[:, : self.rows.shape[1]]

    def forces(self, along: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m 3"]:
        """Vectors in the world, from components by the rows."""
        return np.einsum("mi,mij->mj", along[:, :3], self.axes)

    def moments(self, along: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "m"] | None:
        """Moments about the normals; None where all fingers are hard."""
        return self.spin_radius * along[:, 3] if along.shape[1] > 3 else None


def jacobian(contacts: ContactList, centers: Float[AnyArray, "N 3"]) -> ContactRows:
    """What contacts see of the motions of objects with these centres."""
    count, n = len(contacts.first), len(centers)
    normals, radius = contacts.normals, contacts.spin_radius
    axes = np.stack([normals, *tangents(normals, np)], 1)
    spins = (radius[:, None] * normals)[:, None][:, : int(radius.any())]
    along = np.concatenate([axes, 0 * spins], 1)
    rows = np.zeros((*along.shape[:2], n, 6))
    index = np.arange(count)
    for sign, owner in ((1.0, contacts.first), (-1.0, contacts.second)):
        there = owner >= 0
        arms = contacts.points[there] - centers[owner[there]]
        turning = np.concatenate([np.cross(arms[:, None], axes[there]), spins[there]], 1)
        rows[index[there], :, owner[there]] += sign * np.concatenate([along[there], turning], -1)
    return ContactRows(rows, axes, radius)


def loads_of(contacts: ContactList, seen: ContactRows, placed: Pose, along: Float[np.ndarray, "m d"]) -> Loads:
    """The loads of forces and moments with these components [N] by the contacts' rows."""
    owners, moments = np.stack([contacts.first, contacts.second], 1), seen.moments(along)
    couples = None if moments is None else moments[:, None] * contacts.normals
    return summed_loads(owners, contacts.points, seen.forces(along), placed.origin, couples)


def least_constraint(
    rows: Float[np.ndarray, "m d N 6"],
    friction: Float[np.ndarray, "m"],
    mobilities: Float[np.ndarray, "N 6 6"],
    approach: Float[np.ndarray, "m d"],
    giving: Float[np.ndarray, "m"],
) -> Impulses:
    """The impulses by which contacts keep what touches apart.

    Args:
        rows: from ``jacobian``.
        friction: of each contact.
        mobilities: of each object, motion by impulse.
        approach: how fast what touches would move apart without impulses, less what it may: along the axes [m/s].
        giving: of springs, speed by impulse [1/kg]; 0 where nothing gives.
    """
    count, d, n, _ = rows.shape
    nothing = Impulses(np.zeros((count, d)), np.zeros((n, 6)), True)
    if np.all(approach[:, 0] >= friction * np.linalg.norm(approach[:, 1:], axis=1)):
        return nothing
    sizes, ways = np.linalg.eigh(mobilities)
    roots = ways * np.sqrt(np.maximum(sizes, 0))[:, None]
    agile = np.einsum("minj,njk->mink", rows, roots).reshape(count, d, 6 * n)
    # Each contact in units of its own, and all so that the program is of order one.
    units = 1 / np.sqrt(((agile**2).sum((1, 2)) + giving) / d)
    seen, right = units[:, None, None] * agile, units[:, None] * approach
    largest = np.abs(right).max()
    size = next((size for size in SIZES if size >= count), count)
    padded = _padded(seen, right / largest, friction, units**2 * giving, size)
    found, solved = jax.device_get(_program()(*padded))
    along = found[:count] * (largest * units)[:, None]
    along[:, 0] /= np.where(friction > 0, friction, 1)
    return Impulses(along, np.einsum("minj,mi->nj", rows, along), bool(solved))


def _padded(
    seen: np.ndarray, right: np.ndarray, friction: np.ndarray, giving: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, offsets and givings of round cones: those of contacts that are none see nothing, and have no impulse; of
    those without friction likewise what is across."""
    count, d, unknowns = seen.shape
    rows, offset, gives = np.zeros((size, d, unknowns)), np.zeros((size, d)), np.zeros(size)
    offset[count:, 0] = 1
    steep = np.where(friction > 0, friction, 1)
    rows[:count, 0], offset[:count, 0] = -seen[:, 0] / steep[:, None], right[:, 0] / steep
    rubs = friction > 0
    rows[:count, 1:][rubs], offset[:count, 1:][rubs] = -seen[rubs, 1:], right[rubs, 1:]
    gives[:count] = GIVING + giving / steep**2
    return rows, offset, gives


def compile_programs(things: int, most: int, is_soft: bool) -> None:
    """Compile what so many objects with so many contacts at most need: otherwise it is done when they first occur."""
    for size in SIZES[: 1 + next((k for k, size in enumerate(SIZES) if size >= most), len(SIZES))]:
        for d in (3, 4) if is_soft else (3,):
            _program()(np.zeros((size, d, 6 * things)), np.tile(np.eye(d)[0], (size, 1)), np.zeros(size))


@cache
def _program() -> Any:
    return jit_here(_solved)


def _solved(rows: jax.Array, offset: jax.Array, giving: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The multipliers, and whether gap and errors are as small as they should be."""
    unknowns = rows.shape[-1]
    no_equations = jnp.zeros((1, 1, unknowns)), jnp.zeros((1, 1))
    cones = (Cones(rows[None], offset[None], giving[None]),)
    found = solve(ConeProgram(jnp.eye(unknowns)[None], jnp.zeros((1, unknowns)), *no_equations, cones))
    duals = found.duals[0][0]
    worth = jnp.sum(found.point[0] ** 2) + jnp.sum(giving * duals[:, 0] ** 2)
    return duals, (found.gap[0] <= CLOSE * worth) & (found.error[0] <= CLOSE)
