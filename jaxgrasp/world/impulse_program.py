"""The impulses of all contacts of a world in one step, as one cone program over all its objects.

    minimise  p.Q p / 2 + c.p   subject to each p_i in its friction cone,   Q = J M^-1 J^T + R

Of all motions that contacts allow it has the one closest to the motion without them, by the kinetic energy of the
difference: Gauss's principle of least constraint, with friction as Anitescu ("Optimization-based simulation of
nonsmooth rigid multibody dynamics", 2006) makes it convex. What slides at a speed v therefore rises from what it slides
on by mu v in a unit of time, and hovers at mu v dt.
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
from jaxgrasp.numerics.compiled_code import compile_options
from jaxgrasp.numerics.cone_program import ConeProgram, Cones, solve
from jaxgrasp.world.contact_list import ContactList
from jaxgrasp.world.many_bodies import Masses, World

SIZES = (8, 32, 64, 128, 256, 512)
"""Numbers of contacts for which a program is compiled."""
GIVING = 1e-9
"""By how much every contact gives, in units of what the objects do: so that of all impulses that move them alike one is
the answer."""
CLOSE = 1e-7
"""Gap and errors of a program of order one that count as solved."""


class Impulses(NamedTuple):
    """The answer."""

    on_contacts: Float[np.ndarray, "m 3"]
    """On the first object of each contact, in the world [N.s]."""
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


def jacobian(
    contacts: ContactList, centers: Float[AnyArray, "N 3"]
) -> tuple[Float[np.ndarray, "m 3 N 6"], Float[np.ndarray, "m 3 3"]]:
    """How fast what touches moves apart, along each contact's axes, for motions of all objects; and these axes as rows:
    the normal first."""
    count, n = len(contacts.first), len(centers)
    normals = contacts.normals
    axes = np.stack([normals, *tangents(normals, np)], 1)
    rows = np.zeros((count, 3, n, 6))
    index = np.arange(count)
    for sign, owner in ((1.0, contacts.first), (-1.0, contacts.second)):
        there = owner >= 0
        arms = contacts.points[there] - centers[owner[there]]
        turning = np.cross(arms[:, None], axes[there])
        rows[index[there], :, owner[there]] += sign * np.concatenate([axes[there], turning], -1)
    return rows, axes


def least_constraint(
    rows: Float[np.ndarray, "m 3 N 6"],
    axes: Float[np.ndarray, "m 3 3"],
    friction: Float[np.ndarray, "m"],
    mobilities: Float[np.ndarray, "N 6 6"],
    approach: Float[np.ndarray, "m 3"],
    giving: Float[np.ndarray, "m"],
) -> Impulses:
    """The impulses by which contacts keep what touches apart.

    Args:
        rows: from ``jacobian``.
        axes: likewise.
        friction: of each contact.
        mobilities: of each object, motion by impulse.
        approach: how fast what touches would move apart without impulses, less what it may: along the axes [m/s].
        giving: of springs, speed by impulse [1/kg]; 0 where nothing gives.
    """
    count, n = rows.shape[0], rows.shape[2]
    if not count:
        return Impulses(np.zeros((0, 3)), np.zeros((n, 6)), True)
    agile = np.einsum("minj,njk->mink", rows, mobilities)
    quadratic = np.einsum("mink,pqnk->mipq", agile, rows).reshape(3 * count, 3 * count)
    quadratic += np.diag(np.stack([giving, 0 * giving, 0 * giving], 1).ravel())
    # Each contact in units of its own, and all so that the program is of order one.
    units = 1 / np.sqrt(np.repeat(np.diagonal(quadratic).reshape(count, 3).mean(1), 3))
    linear = units * approach.ravel()
    largest = np.abs(linear).max()
    if not largest > 0:
        return Impulses(np.zeros((count, 3)), np.zeros((n, 6)), True)
    size = next((size for size in SIZES if size >= count), count)
    padded = _padded(units[:, None] * quadratic * units, linear / largest, friction, 3 * size)
    point, solved = jax.device_get(_program()(*padded))
    own = (largest * units * point[: 3 * count]).reshape(count, 3)
    on_contacts = np.einsum("mi,mij->mj", own, axes)
    return Impulses(on_contacts, np.einsum("minj,mi->nj", rows, own), bool(solved))


def _padded(quadratic: np.ndarray, linear: np.ndarray, friction: np.ndarray, size: int) -> tuple[np.ndarray, ...]:
    """Contacts that are none have no impulse; those without friction no tangential one, which moves nothing either."""
    whole, right = GIVING * np.eye(size), np.zeros(size)
    used = len(linear)
    whole[:used, :used] += quadratic
    right[:used] = linear
    cones = np.ones(size // 3)
    cones[: len(friction)] = np.where(friction > 0, friction, 1)
    nothing = np.concatenate([np.repeat(friction == 0, 3) & (np.arange(used) % 3 > 0), np.ones(size - used, bool)])
    whole[nothing] = whole[:, nothing] = 0
    whole[nothing, nothing] = 1
    right[nothing] = 0
    right[used::3] = 1
    return whole, right, cones


def compile_programs(most: int) -> None:
    """Compile what so many contacts at most need: otherwise it is done when they first occur."""
    for size in SIZES[: 1 + next((k for k, size in enumerate(SIZES) if size >= most), len(SIZES))]:
        _program()(np.eye(3 * size), np.zeros(3 * size), np.ones(size))


@cache
def _program() -> Any:
    return jax.jit(_solved, compiler_options=compile_options())


def _solved(quadratic: jax.Array, linear: jax.Array, friction: jax.Array) -> tuple[jax.Array, jax.Array]:
    count, size = len(friction), len(linear)
    index = jnp.arange(count)
    rows = jnp.zeros((count, 3, size))
    rows = rows.at[index, 0, 3 * index].set(-friction)
    for part in (1, 2):
        rows = rows.at[index, part, 3 * index + part].set(-1.0)
    nothing = jnp.zeros((1, 1, size)), jnp.zeros((1, 1))
    cones = (Cones(rows[None], jnp.zeros((1, count, 3))),)
    found = solve(ConeProgram(quadratic[None], linear[None], *nothing, cones))
    worth = jnp.abs(linear @ found.point[0])
    return found.point[0], (found.gap[0] <= CLOSE * worth) & (found.error[0] <= CLOSE)
