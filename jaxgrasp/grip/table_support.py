"""Whether a hand holds an object, alone and with the table that it may stand on.

The table's contacts and the hand's are one problem. The table pushes and rubs as the hand does, only that it means to
exert nothing, and gives whatever the object asks for: the hand is left with its squeezing. As the object leaves the
table, that support fades.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.distribution import closed_form, closed_form_and_optimum
from jaxgrasp.grip.monitor import Assessment, Hold, Law, judged
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.slipping import Exerted, applied_forces, cut_to_cones, resultant
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Pose
from jaxgrasp.model.solution import Solution, is_held
from jaxgrasp.numerics.tiling import beside
from jaxgrasp.numerics.vec3 import Vec3

FADE = 1e-3
"""Height at which nothing is left of the support [m]: skin and felt give by about as much, and what is felt does not
jump."""
TILT = 5e-3
"""By how much the four directions lean away from straight down, in which the object reaches furthest: on a flat face
they find its corners, on a round one four places half a hundredth of its radius off the lowest."""
QUARTERS = 0.4 + np.pi / 2 * np.arange(4)
"""Where they lean; along no edge of an object whose edges lie along the table's axes."""
READINESS = 100.0
"""Weight of each of the table's contacts, in units of what the hand's have together: what the object asks for, the hand
carries to a four-hundredth. A hundred times as much takes four times as many steps to find."""
SLACK = 0.02
"""Part of the load that friction at the table takes up beside, where closed-form forces are cut to their own."""
STANDING = 0.95
"""Share of the support at which an object counts as standing: its lowest place is known to a twentieth of ``FADE``."""


class TableSupport(NamedTuple):
    """What a table does to an object."""

    wrench: Float[Array, "*batch 6"]
    """About the object's centre [N, N.m], of an object that stands."""
    exerted: Exerted
    """What the hand exerts beside that, by the law that is asked for."""
    share: Float[Array, "*batch"]
    """How much of the support there is: 1 for an object that stands, 0 for one clear of the table or not to be held."""


def support_points(scene: Scene, placed: Pose) -> tuple[Float[Array, "*batch 4 3"], Float[Array, "*batch 4"]]:
    """Where an object meets the table first, from its centre along the world's axes, and how high that is [m]."""
    east, north, up = jnp.asarray(scene.table.rotation).T
    leaning = TILT * (np.cos(QUARTERS)[:, None] * east + np.sin(QUARTERS)[:, None] * north) - up
    turn = jnp.asarray(placed.rotation)
    ahead = jnp.einsum("...ji,kj->...ki", turn, leaning)
    directions = Vec3(*(ahead[..., i] for i in range(3)))
    # The place that reaches furthest in a direction is the derivative of how far that is.
    own = jax.grad(lambda directions: jnp.sum(scene.body.shape._support(directions)))(directions)
    points = jnp.einsum("...ij,...kj->...ki", turn, jnp.stack(own, -1))
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
) -> tuple[Assessment, TableSupport]:
    """Whether the hand alone holds an object, what the table carries, and what that leaves to the hand.

    What the hand alone does not hold does not go with it: then the table is asked whether the object can stay where it
    is. The three questions, the hand alone and the table's two, are one batch: one solver is compiled for them. Where
    the object is clear of the table its two have no contacts, which costs next to nothing.

    Args:
        scene: whose table and friction count.
        placed: where the object stands.
        grasp: of the hand, about the object's centre, along the world's axes.
        wrench: that hand and table are to exert together about that centre [N, N.m].
        inertial: what of it accelerates the object.
        free: of a guide, as for [`jaxgrasp.closed_form`][].
        law: which forces the hand applies.
    """
    batch, links = grasp.points.shape[:-2], grasp.points.shape[-2]
    points, heights = support_points(scene, placed)
    points = jnp.broadcast_to(points, (*batch, 4, 3))
    shares = jnp.broadcast_to(jnp.clip(1 - heights / FADE, 0, 1), (*batch, 4))
    still = wrench - inertial
    near = jnp.any(shares > 0, -1, keepdims=True)
    moves = jnp.any(inertial != 0, -1, keepdims=True)
    alone, own = _with_table(scene, grasp, points, jnp.zeros_like(shares), wrench, jnp.ones_like(near))
    going, ready = _with_table(scene, grasp, points, shares, wrench, near)
    staying, steady = _with_table(scene, grasp, points, shares, still, near & moves)
    all_three = jax.tree.map(lambda *parts: jnp.stack(parts), alone, going, staying)
    wrenches, weights = jnp.stack([wrench, wrench, still]), jnp.stack([own, ready, steady])
    closed, optimum = closed_form_and_optimum(all_three, wrenches, weights, free=free)
    assessment = judged(grasp, _of_hand(closed, links), _of_hand(optimum, links), law)
    stays = (assessment.hold != Hold.STABLE)[..., None] & moves
    with_table = jax.tree.map(lambda parts: jnp.where(beside(stays[..., 0], parts[1]), parts[2], parts[1]), optimum)
    borne = jnp.where(stays, still, wrench)
    return assessment, _supported(grasp, points, shares, borne, with_table, free, law)


def _of_hand(three: Solution, links: int) -> Solution:
    """The hand's own answer among the three."""
    first = jax.tree.map(lambda x: x[0], three)
    own = _by_hand(Exerted(first.forces, first.moments), links)
    return replace(first, forces=own.forces, moments=own.moments)


def _by_hand(exerted: Exerted, links: int) -> Exerted:
    """What the hand's own contacts exert, which are the first."""
    moments = exerted.moments
    return Exerted(exerted.forces[..., :links, :], None if moments is None else moments[..., :links])


def _supported(
    grasp: Grasp, points: Array, shares: Array, wrench: Array, found: Solution, free: AnyArray | None, law: Law
) -> TableSupport:
    """What the table carries by a solution of hand and table together, as far as it does."""
    links = grasp.points.shape[-2]
    applied = applied_forces(found)
    exerted = _by_hand(applied, links)
    reaction = resultant(points, applied.forces[..., links:, :])
    rests = is_held(found.verdict)
    if law == "closed-form":
        left = wrench - reaction
        exerted = cut_to_cones(grasp, applied_forces(closed_form(grasp, left, free=free)))
        slipping = jnp.linalg.norm((left - exerted.wrench(grasp))[..., :3], axis=-1)
        rests = rests & (slipping <= SLACK * jnp.linalg.norm(wrench[..., :3], axis=-1))
    return TableSupport(reaction, exerted, jnp.where(rests, jnp.max(shares, -1), 0))


def _with_table(
    scene: Scene, grasp: Grasp, points: Array, shares: Array, wrench: AnyArray, asked: Array
) -> tuple[Grasp, Array]:
    """Contacts of hand and table together, none where nothing is ``asked``, and their weights."""
    up = jnp.asarray(scene.table.rotation)[:, 2]
    assert grasp.present is not None
    squeeze = jnp.sum(jnp.asarray(grasp.squeeze) * grasp.present, -1)
    pressing = squeeze + jnp.linalg.norm(wrench[..., :3], axis=-1)
    ready = jnp.broadcast_to(READINESS * pressing[..., None], shares.shape)

    of_table = Grasp(
        points,
        jnp.broadcast_to(up, points.shape),
        jnp.full(shares.shape, scene.table_friction, shares.dtype),
        jnp.zeros_like(shares),
        (shares > 0).astype(shares.dtype),
        None if grasp.torsion is None else jnp.zeros_like(shares),
    )
    axis = shares.ndim - 1
    both = jax.tree.map(lambda own, table: jnp.concatenate([own, table], axis), grasp, of_table)
    both = replace(both, present=jnp.where(asked, both.present, 0))
    return both, jnp.concatenate([jnp.asarray(grasp.squeeze), ready], axis)
