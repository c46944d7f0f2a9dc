"""What stands in an object's way: springs to the hand that presses it there, and rigid to what the hand has let go.

An object that moves by itself goes no deeper into an obstacle than it was. Of all motions that obey this the one
closest to its own is taken, by the kinetic energy of the difference: so none is gained, since to stay obeys it too.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.contact.world import spring_wrench, world_contacts
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Hand, Pose
from jaxgrasp.numerics.nonnegative import minimise_nonnegative
from jaxgrasp.prehension.motion import Motion, mobility, moved
from jaxgrasp.prehension.scene import Scene

LOOKS = 4
"""How often a motion is tried and corrected: contacts change on the way."""


def check_outline(scene: Scene) -> Hand:
    """The object's outline; ValueError where obstacles need one that is missing."""
    if scene.outline is None:
        raise ValueError("outline is None: with obstacles expected rigid_body(sphere_tree(shape)) of the object")
    return scene.outline


def world_wrench(scene: Scene, placed: Pose) -> Float[Array, "*batch 6"]:
    """What all obstacles exert on the object, about its centre [N, N.m]."""
    outline = check_outline(scene)
    each = [
        spring_wrench(world_contacts(outline, placed, o.shape, o.placed), o.stiffness, placed.origin)
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
    own, before = jnp.concatenate(motion), _parts(scene, placed).depths
    parts = before.shape[-1]

    def look(k: Array, state: _Found) -> _Found:
        trial = moved(placed, Motion(state.motion[:3], state.motion[3:]), dt, scene.guide)[0]
        there = _parts(scene, trial)
        arms = there.points - trial.origin
        deeper = there.depths - before
        rows = jnp.where((deeper > 0)[:, None], jnp.concatenate([there.normals, jnp.cross(arms, there.normals)], -1), 0)
        # What is out of the way again must not come back: all that was met so far stays forbidden. To stand still is
        # always allowed.
        least = jnp.where(deeper > 0, jnp.minimum(rows @ state.motion + deeper / dt, 0), 0)
        rows = lax.dynamic_update_slice_in_dim(state.rows, rows, k * parts, 0)
        least = lax.dynamic_update_slice_in_dim(state.least, least, k * parts, 0)
        impulses = minimise_nonnegative(rows @ agility @ rows.T, rows @ own - least)
        return _Found(own + agility @ (impulses @ rows), rows, least)

    start = _Found(own, jnp.zeros((LOOKS * parts, 6), own.dtype), jnp.zeros(LOOKS * parts, own.dtype))
    found = lax.fori_loop(0, LOOKS, look, start)
    return Stopped(Motion(found.motion[:3], found.motion[3:]), jnp.any(found.rows != 0))


class _Found(NamedTuple):
    """A motion, and the half-spaces rows.motion >= least that it must stay in; none where a row is zero."""

    motion: Array
    rows: Array
    least: Array


class _Parts(NamedTuple):
    """Contacts of every part of the object with every obstacle, ``(m, 3)`` or ``(m,)``."""

    points: Array
    normals: Array
    depths: Array


def _parts(scene: Scene, placed: Pose) -> _Parts:
    outline = check_outline(scene)
    each = [world_contacts(outline, placed, o.shape, o.placed) for o in scene.obstacles]
    return _Parts(*(jnp.concatenate([getattr(found, name) for found in each]) for name in _Parts._fields))
