"""Support of an object by the table beside the hand.

Contacts of table and hand are one problem. The table presses and rubs as the hand does, but without squeezing forces,
and takes up whatever load remains: the hand keeps its squeezing. As the object leaves the table, the support fades.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.distribution import closed_form, closed_form_and_optimum, known_closed_form_and_optimum
from jaxgrasp.grip.contact_forces import ContactForces, applied_forces, cut_to_cones, resultant
from jaxgrasp.grip.monitor import Assessment, Hold, Law, assess
from jaxgrasp.grip.scene import Scene
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.solution import Solution, is_held
from jaxgrasp.numerics.tiling import beside
from jaxgrasp.numerics.vec3 import Vec3

FADE = 1e-3
"""Height at which the support has faded to zero [m]: skin and felt give by about as much, and torques do not jump."""
TILT = 5e-3
"""Tilt of the four directions of support against straight down: on a flat face they find its corners, on a round face
four points half a hundredth of its radius off the lowest."""
QUARTERS = 0.4 + np.pi / 2 * np.arange(4)
"""Azimuths of that tilt [rad]; along no edge of an object whose edges are parallel to the table's axes."""
TILTS = np.array([TILT, 0.05, 0.3, 0.8])
"""Tilts of the directions in which contact points are sought [rad]: the largest is more than an object turns in a step.
"""
CIRCLE = 0.4 + np.pi / 4 * np.arange(8)
"""Azimuths of these directions, at every other tilt turned by half their distance [rad]."""
TABLE_WEIGHT = 100.0
"""Weight of each of the table's contacts, in units of the sum over the hand's: the hand carries a four-hundredth of the
load. A hundred times the weight takes four times as many solver steps."""
SLACK = 0.02
"""Part of the load that friction at the table takes up in addition, where closed-form forces are cut to their friction.
"""
STANDING = 0.95
"""Share of the support at which an object counts as standing: its lowest point is known to a twentieth of ``FADE``."""


Solutions = tuple[Solution, Solution]
"""Closed form and optimum of three problems: the hand alone, and two with the table."""


class TableSupport(NamedTuple):
    """Load of the table on an object, and the hand's forces beside it."""

    wrench: Float[Array, "*batch 6"]
    """Wrench of the table about the object's centre [N, N.m], of an object that stands."""
    exerted: ContactForces
    """Forces of the hand in addition, by the applied law."""
    share: Float[Array, "*batch"]
    """Share of the support: 1 for an object that stands, 0 for an object that is clear of the table or that cannot be
    held."""
    points: Float[Array, "*batch 4 3"]
    """Support points from the object's centre, along the world's axes [m]."""
    pressed: Float[Array, "*batch 4"]
    """Normal force of the table at each, of an object that stands [N]."""


class TableFriction(NamedTuple):
    """Friction of the table on an object that a hand drags, as it is known from the step before."""

    wrench: Float[Array, "6"]
    """Wrench of the table's friction about the object's centre [N, N.m]."""
    share: Float[Array, ""]
    """Share of it that applies: 1 while the object slides, and then fading; the rest is what the table can bear."""


def support_points(scene: Scene, placed: Pose) -> tuple[Float[Array, "*batch 4 3"], Float[Array, "*batch 4"]]:
    """Compute the first contact points of an object with the table, from its centre along the world's axes, and their
    heights [m]."""
    return _points_towards(scene, placed, TILT * np.stack([np.cos(QUARTERS), np.sin(QUARTERS)], 1))


def table_points(scene: Scene, placed: Pose) -> tuple[Float[Array, "*batch m 3"], Float[Array, "*batch m"]]:
    """Compute all points of an object that may meet the table in a step, as ``support_points`` does: its lowest points,
    those about them, and those that come down as it turns."""
    azimuths = CIRCLE + np.pi / 8 * (np.arange(len(TILTS)) % 2)[:, None]
    around = np.stack([np.cos(azimuths), np.sin(azimuths)], -1)
    return _points_towards(scene, placed, (np.tan(TILTS)[:, None, None] * around).reshape(-1, 2))


def _points_towards(scene: Scene, placed: Pose, slopes: Float[np.ndarray, "m 2"]) -> tuple[Array, Array]:
    """Return the support points in directions that lean from straight down by slopes along the table's axes."""
    east, north, up = jnp.asarray(scene.table.rotation).T
    leaning = slopes[:, :1] * east + slopes[:, 1:] * north - up
    turn = jnp.asarray(placed.rotation)
    ahead = jnp.einsum("...ji,kj->...ki", turn, leaning)
    directions = Vec3(*(ahead[..., i] for i in range(3)))
    # The support point in a direction is the gradient of the support function.
    local_points = jax.grad(lambda directions: jnp.sum(scene.body.shape._support(directions)))(directions)
    points = jnp.einsum("...ij,...kj->...ki", turn, jnp.stack(local_points, -1))
    above = jnp.asarray(placed.origin) - scene.table.origin
    return points, (above[..., None, :] + points) @ up


@partial(jax.jit, static_argnames="law")
def held_beside_table(
    scene: Scene,
    placed: Pose,
    grasp: Grasp,
    wrench: Float[AnyArray, "*batch 6"],
    inertial: Float[AnyArray, "*batch 6"],
    free: Float[AnyArray, "*#batch 6 k"] | None,
    law: Law,
    friction: TableFriction | None = None,
    known: Solutions | None = None,
) -> tuple[Assessment, TableSupport, Solutions]:
    """Assess the hand alone, and compute the table's support and the hand's forces beside it.

    An object that the hand alone does not hold does not follow it: then the second problem with the table decides
    whether it can stay at its pose. The three problems, the hand alone and two with the table, are one batch, so that
    one solver is compiled for them. Where the object is clear of the table these two have no contacts, which costs next
    to nothing.

    Args:
        scene: scene with its table and friction.
        placed: pose of the object.
        grasp: grasp of the hand, about the object's centre, along the world's axes.
        wrench: wrench required of hand and table together about that centre [N, N.m].
        inertial: part of it that accelerates the object.
        free: motion basis of a guide, as for [`jaxgrasp.closed_form`][].
        law: force law of the hand.
        friction: friction of the table, of an object that is dragged; none where not given.
        known: solutions of the three problems by an earlier call with these arguments, of which only derivatives are
            to be computed.

    Returns:
        The assessment, the support, and the solutions of the three problems.
    """
    batch, links = grasp.points.shape[:-2], grasp.points.shape[-2]
    points, heights = support_points(scene, placed)
    points = jnp.broadcast_to(points, (*batch, 4, 3))
    shares = jnp.broadcast_to(jnp.clip(1 - heights / FADE, 0, 1), (*batch, 4))
    near = jnp.any(shares > 0, -1, keepdims=True)
    friction_wrench = jnp.zeros_like(wrench)
    if friction is not None:
        friction_wrench = near * friction.share * friction.wrench
        scene = replace(scene, table_friction=scene.table_friction * (1 - friction.share))
    beside_table = wrench - friction_wrench
    static_wrench = beside_table - inertial
    moves = jnp.any(inertial != 0, -1, keepdims=True)
    hand_alone, hand_weights = _with_table(scene, grasp, points, jnp.zeros_like(shares), wrench, jnp.ones_like(near))
    following, following_weights = _with_table(scene, grasp, points, shares, beside_table, near)
    at_pose, at_pose_weights = _with_table(scene, grasp, points, shares, static_wrench, near & moves)
    all_three = jax.tree.map(lambda *parts: jnp.stack(parts), hand_alone, following, at_pose)
    wrenches, weights = (
        jnp.stack([wrench, beside_table, static_wrench]),
        jnp.stack([hand_weights, following_weights, at_pose_weights]),
    )
    if known is None:
        known = closed_form_and_optimum(all_three, wrenches, weights, free=free)
    else:
        known = known_closed_form_and_optimum(all_three, wrenches, weights, known, free=free)
    closed, optimum = known
    assessment = assess(grasp, _of_hand(closed, links), _of_hand(optimum, links), law)
    stays = (assessment.hold != Hold.STABLE)[..., None] & moves
    with_table = jax.tree.map(lambda parts: jnp.where(beside(stays[..., 0], parts[1]), parts[2], parts[1]), optimum)
    carried_wrench = jnp.where(stays, static_wrench, beside_table)
    table = _supported(scene, grasp, points, shares, carried_wrench, with_table, free, law)
    return assessment, table._replace(wrench=table.wrench + friction_wrench), known


def _of_hand(solutions: Solution, links: int) -> Solution:
    """Return the hand's part of the first of three solutions."""
    first = jax.tree.map(lambda x: x[0], solutions)
    forces_of_hand = _by_hand(ContactForces(first.forces, first.moments), links)
    return replace(first, forces=forces_of_hand.forces, moments=forces_of_hand.moments)


def _by_hand(exerted: ContactForces, links: int) -> ContactForces:
    """Select the forces of the hand's contacts, which come first."""
    moments = exerted.moments
    return ContactForces(exerted.forces[..., :links, :], None if moments is None else moments[..., :links])


def _supported(
    scene: Scene,
    grasp: Grasp,
    points: Array,
    shares: Array,
    wrench: Array,
    solution: Solution,
    free: AnyArray | None,
    law: Law,
) -> TableSupport:
    """Extract the table's support from a solution of hand and table together."""
    links = grasp.points.shape[-2]
    applied = applied_forces(solution)
    exerted = _by_hand(applied, links)
    reaction = resultant(points, applied.forces[..., links:, :])
    rests = is_held(solution.verdict)
    if law == "closed-form":
        required = wrench - reaction
        exerted = cut_to_cones(grasp, applied_forces(closed_form(grasp, required, free=free)))
        deficit = jnp.linalg.norm((required - exerted.wrench(grasp))[..., :3], axis=-1)
        rests = rests & (deficit <= SLACK * jnp.linalg.norm(wrench[..., :3], axis=-1))
    pressed = applied.forces[..., links:, :] @ jnp.asarray(scene.table.rotation)[:, 2]
    return TableSupport(reaction, exerted, jnp.where(rests, jnp.max(shares, -1), 0), points, pressed)


def _with_table(
    scene: Scene, grasp: Grasp, points: Array, shares: Array, wrench: AnyArray, is_relevant: Array
) -> tuple[Grasp, Array]:
    """Join the contacts of hand and table, absent where ``is_relevant`` is false, and return their weights too."""
    up = jnp.asarray(scene.table.rotation)[:, 2]
    assert grasp.present is not None
    squeeze = jnp.sum(jnp.asarray(grasp.squeeze) * grasp.present, -1)
    total_force = squeeze + jnp.linalg.norm(wrench[..., :3], axis=-1)
    # Weight of each support point: TABLE_WEIGHT (sum of squeezes + |f|)
    table_weights = jnp.broadcast_to(TABLE_WEIGHT * total_force[..., None], shares.shape)

    of_table = Grasp(
        points,
        jnp.broadcast_to(up, points.shape),
        jnp.full(shares.shape, scene.table_friction, shares.dtype),
        jnp.zeros_like(shares),
        (shares > 0).astype(shares.dtype),
        None if grasp.torsion is None else jnp.zeros_like(shares),
    )
    axis = shares.ndim - 1
    joined = jax.tree.map(lambda of_hand, table: jnp.concatenate([of_hand, table], axis), grasp, of_table)
    joined = replace(joined, present=jnp.where(is_relevant, joined.present, 0))
    return joined, jnp.concatenate([jnp.asarray(grasp.squeeze), table_weights], axis)
