"""What is in the way of object and hand: springs to the hand that presses there, and rigid to what the hand let go.

An object that moves by itself goes no deeper into an obstacle than it was. Of all motions that obey this the one
closest to its own is taken, by the kinetic energy of the difference: so none is gained, since to stay obeys it too.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.grip.motion import Motion, mobility, moved
from jaxgrasp.grip.scene import Obstacle, Scene, at_time
from jaxgrasp.grip.slipping import resultant
from jaxgrasp.hand.detection import find_contacts
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.hand.shapes import Plane
from jaxgrasp.hand.world import world_contacts
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.numerics.nonnegative_qp import minimise_nonnegative

MOST_PLACES = 64
"""Places at most at which a motion is tried: what is faster than that many radii of its smallest ball in a step may
pass a board."""
LOOKS = 4
"""How often a motion is tried and corrected: contacts change on the way."""
CREEP = 1e-3
"""Speed of sliding at which friction is seven tenths of what it comes to [m/s]: at rest it has no direction."""


def world_wrench(scene: Scene, placed: Pose, motion: Motion | None = None) -> Float[Array, "*batch 6"]:
    """What all obstacles exert on the object, about its centre [N, N.m].

    Args:
        scene: its obstacles as they are now.
        placed: where the object is; any leading axes.
        motion: of the object, which friction and damping resist; at rest where not given.
    """
    met = _parts(scene, placed)
    arms = met.points - jnp.asarray(placed.origin)[..., None, :]
    approach = jnp.zeros(met.points.shape)
    if motion is not None:
        approach = motion.linear[..., None, :] + jnp.cross(motion.angular[..., None, :], arms)
    sliding = approach - met.velocities
    along = jnp.sum(sliding * met.normals, -1)
    pressed = jnp.where(met.depths > 0, jnp.maximum(met.stiffness * met.depths - met.damping * along, 0), 0)
    across = sliding - along[..., None] * met.normals
    rubbed = met.friction * pressed / jnp.sqrt(jnp.sum(across**2, -1) + CREEP**2)
    return resultant(arms, pressed[..., None] * met.normals - rubbed[..., None] * across)


def hand_torques(scene: Scene, posture: Posture) -> Float[Array, "*batch J"]:
    """Torques on a hand's joints by what of the world it touches itself: springs of eq. 6, without friction [N.m].

    Args:
        scene: its obstacles as they are now.
        posture: of the hand; any leading axes.
    """
    frames = pose_hand(scene.hand, posture)
    torques = jnp.zeros(posture.angles.shape)
    table = [(Plane(), scene.table)] if scene.table_touches_hand else []
    for shape, placed in table + [(o.shape, o.placed) for o in scene.obstacles if o.touches_hand]:
        met = find_contacts(scene.hand, posture, shape, placed)
        pressed = scene.contributions * scene.stiffness * met.depths * met.present
        torques = torques + joint_torques(scene.hand, frames, met.points, pressed[..., None] * met.normals)
    return torques


class Stopped(NamedTuple):
    """A motion as obstacles leave it, and whether they changed it."""

    motion: Motion
    touches: Array


def stop(scene: Scene, placed: Pose, motion: Motion, dt: float | AnyArray, begun: float | AnyArray = 0.0) -> Stopped:
    """The motion closest to an object's own that takes no part of it deeper into an obstacle.

    Args:
        scene: whose obstacles and guide count, where they are when it begins.
        placed: where the object is.
        motion: its own, of its centre.
        dt: for how long it moves [s].
        begun: when, for obstacles that move [s].
    """
    agility = mobility(scene.body, placed, scene.guide)
    own, before = jnp.concatenate(motion), _parts(at_time(scene, begun), placed)
    parts = before.depths.shape[-1]

    def look(k: Array, state: _Found) -> _Found:
        met = _first_met(scene, placed, before, Motion(state.motion[:3], state.motion[3:]), dt, begun)
        deeper = met.parts.depths - before.depths
        normals = met.parts.normals
        pushed = jnp.sum(normals * met.parts.velocities, -1)
        rows = jnp.concatenate([normals, jnp.cross(met.parts.points - met.origin, normals)], -1)
        rows = jnp.where((deeper > 0)[:, None], rows, 0)
        # No deeper at the end of the step than before it. What is out of the way again must not come back: all that
        # was met so far stays forbidden. To go with what is met is always allowed: to stand still, where that does.
        since = (rows @ state.motion - pushed) * met.time + deeper
        least = jnp.where(deeper > 0, pushed + jnp.minimum(since / dt, 0), 0)
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


def _first_met(
    scene: Scene,
    placed: Pose,
    before: "_ObstacleContacts",
    motion: Motion,
    dt: float | AnyArray,
    begun: float | AnyArray,
) -> _Met:
    """The first place on the way where any part is deeper than before, else the last.

    Places are no further apart than the object's smallest ball is wide, so that it jumps over no thin board.
    """
    assert scene.outline is not None
    centers, radii = scene.outline.skin.centers, scene.outline.skin.radii
    finest = jnp.min(jnp.where(radii > 0, radii, jnp.inf))
    reach = jnp.max(jnp.linalg.norm(centers, axis=-1))
    fastest = jnp.max(jnp.linalg.norm(before.velocities, axis=-1))
    way = dt * (jnp.linalg.norm(motion.linear) + reach * jnp.linalg.norm(motion.angular) + fastest)
    count = jnp.clip(jnp.ceil(way / finest), 1, MOST_PLACES)

    def go(state: tuple[Array, _Met]) -> tuple[Array, _Met]:
        k = state[0] + 1
        time = dt * k / count
        there = moved(placed, motion, time, scene.guide)
        parts = _parts(at_time(scene, begun + time), there)
        return k, _Met(parts, jnp.asarray(there.origin), jnp.asarray(time))

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
    """Contacts of every part of the object with every obstacle, ``(..., m, 3)`` or ``(..., m)``."""

    points: Array
    normals: Array
    depths: Array
    velocities: Array
    """Velocity of the obstacle, where it is touched [m/s]."""
    stiffness: Array
    friction: Array
    damping: Array


def _parts(scene: Scene, placed: Pose) -> _ObstacleContacts:
    each = [_contacts_with(scene, obstacle, placed) for obstacle in scene.obstacles]
    axis = each[0].depths.ndim - 1
    return jax.tree.map(lambda *parts: jnp.concatenate(parts, axis), *each)


def _contacts_with(scene: Scene, obstacle: Obstacle, placed: Pose) -> _ObstacleContacts:
    assert scene.outline is not None
    found = world_contacts(scene.outline, placed, obstacle.shape, obstacle.placed)
    velocities = jnp.zeros(found.points.shape)
    if (motion := obstacle.motion) is not None:
        velocities = motion.linear + jnp.cross(motion.angular, found.points - obstacle.placed.origin)
    laws = (obstacle.stiffness, obstacle.friction, obstacle.damping)
    each = (jnp.broadcast_to(jnp.asarray(law, found.depths.dtype), found.depths.shape) for law in laws)
    return _ObstacleContacts(found.points, found.normals, found.depths, velocities, *each)
