"""What stands in an object's way: springs to the hand that presses it there, and rigid to what the hand has let go.

An object that moves by itself goes no deeper into an obstacle than it was. Of all motions that obey this the one
closest to its own is taken, by the kinetic energy of the difference: so none is gained, since to stay obeys it too.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.grip.motion import Motion, mobility, moved
from jaxgrasp.grip.scene import Scene
from jaxgrasp.hand.world import spring_wrench, world_contacts
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.numerics.nonnegative_qp import minimise_nonnegative

MOST_PLACES = 64
"""Places at most at which a motion is tried: what is faster than that many radii of its smallest ball in a step may
pass a board."""
LOOKS = 4
"""How often a motion is tried and corrected: contacts change on the way."""


def world_wrench(scene: Scene, placed: Pose) -> Float[Array, "*batch 6"]:
    """What all obstacles exert on the object, about its centre [N, N.m]."""
    assert scene.outline is not None
    each = [
        spring_wrench(world_contacts(scene.outline, placed, o.shape, o.placed), o.stiffness, placed.origin)
        for o in scene.obstacles
    ]
    return sum(each[1:], each[0])


class Stopped(NamedTuple):
    """A motion as obstacles leave it, and whether they changed it."""

    motion: Motion
    touches: Array


def stop(scene: Scene, placed: Pose, motion: Motion, dt: float | AnyArray) -> Stopped:
    """The motion closest to an object's own that takes no part of it deeper into an obstacle.

    Args:
        scene: whose obstacles and guide count.
        placed: where the object is.
        motion: its own, of its centre.
        dt: for how long it moves [s].
    """
    agility = mobility(scene.body, placed, scene.guide)
    own, before = jnp.concatenate(motion), _parts(scene, placed)
    parts = before.depths.shape[-1]

    def look(k: Array, state: _Found) -> _Found:
        met = _first_met(scene, placed, before, Motion(state.motion[:3], state.motion[3:]), dt)
        deeper = met.parts.depths - before.depths
        normals = met.parts.normals
        rows = jnp.concatenate([normals, jnp.cross(met.parts.points - met.origin, normals)], -1)
        rows = jnp.where((deeper > 0)[:, None], rows, 0)
        # No deeper at the end of the step than before it. What is out of the way again must not come back: all that
        # was met so far stays forbidden. To stand still is always allowed.
        least = jnp.where(deeper > 0, jnp.minimum((rows @ state.motion * met.time + deeper) / dt, 0), 0)
        rows = lax.dynamic_update_slice_in_dim(state.rows, rows, k * parts, 0)
        least = lax.dynamic_update_slice_in_dim(state.least, least, k * parts, 0)
        impulses = minimise_nonnegative(rows @ agility @ rows.T, rows @ own - least)
        return _Found(own + agility @ (impulses @ rows), rows, least)

    start = _Found(own, jnp.zeros((LOOKS * parts, 6), own.dtype), jnp.zeros(LOOKS * parts, own.dtype))
    found = lax.fori_loop(0, LOOKS, look, start)
    return Stopped(Motion(found.motion[:3], found.motion[3:]), jnp.any(found.rows != 0))


class _Met(NamedTuple):
    """What an object meets on its way, where it is then, and when."""

    parts: "_ObstacleContacts"
    origin: Array
    time: Array


def _first_met(scene: Scene, placed: Pose, before: "_ObstacleContacts", motion: Motion, dt: float | AnyArray) -> _Met:
    """The first place on the way where any part is deeper than before, else the last.

    Places are no further apart than the object's smallest ball is wide, so that it jumps over no thin board.
    """
    assert scene.outline is not None
    centers, radii = scene.outline.skin.centers, scene.outline.skin.radii
    finest = jnp.min(jnp.where(radii > 0, radii, jnp.inf))
    reach = jnp.max(jnp.linalg.norm(centers, axis=-1))
    way = dt * (jnp.linalg.norm(motion.linear) + reach * jnp.linalg.norm(motion.angular))
    count = jnp.clip(jnp.ceil(way / finest), 1, MOST_PLACES)

    def go(state: tuple[Array, _Met]) -> tuple[Array, _Met]:
        k = state[0] + 1
        time = dt * k / count
        there = moved(placed, motion, time, scene.guide)
        return k, _Met(_parts(scene, there), jnp.asarray(there.origin), jnp.asarray(time))

    def clear(state: tuple[Array, _Met]) -> Array:
        return (state[0] < count) & ~jnp.any(state[1].parts.depths > before.depths)

    start = _Met(before, jnp.asarray(placed.origin), jnp.zeros_like(way))
    return lax.while_loop(clear, go, (jnp.zeros_like(count), start))[1]


class _Found(NamedTuple):
    """A motion, and the half-spaces rows.motion >= least that it must stay in; none where a row is zero."""

    motion: Array
    rows: Array
    least: Array


class _ObstacleContacts(NamedTuple):
    """Contacts of every part of the object with every obstacle, ``(m, 3)`` or ``(m,)``."""

    points: Array
    normals: Array
    depths: Array


def _parts(scene: Scene, placed: Pose) -> _ObstacleContacts:
    assert scene.outline is not None
    each = [world_contacts(scene.outline, placed, o.shape, o.placed) for o in scene.obstacles]
    return _ObstacleContacts(
        *(jnp.concatenate([getattr(found, name) for found in each]) for name in _ObstacleContacts._fields)
    )
