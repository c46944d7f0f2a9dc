"""Obstacles to object and hand: springs to a hand that presses into them, and rigid to an object that moves freely.

A free object moves no deeper into an obstacle than it is. Of all motions that obey this, the one closest to its own by
the kinetic energy of the difference is taken, so that no energy is gained: to stay at rest obeys it too.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.grip.contact_forces import resultant
from jaxgrasp.grip.motion import Motion, mobility, moved
from jaxgrasp.grip.scene import Obstacle, Scene, at_time
from jaxgrasp.hand.detection import find_contacts
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.hand.shapes import Plane
from jaxgrasp.hand.world import world_contacts
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.numerics.nonnegative_qp import minimise_nonnegative

MAX_SAMPLES = 64
"""Largest number of samples of a path: an object that moves by more than that many radii of its smallest ball in a step
may pass through a board."""
CORRECTIONS = 4
"""Number of corrections of a motion: contacts change along the path."""
CREEP = 1e-3
"""Speed of sliding at which friction reaches seven tenths of its full value [m/s]: at rest it has no direction."""


def world_wrench(scene: Scene, placed: Pose, motion: Motion | None = None) -> Float[Array, "*batch 6"]:
    """Compute the wrench of all obstacles on the object, about its centre [N, N.m].

    Args:
        scene: scene with obstacles at their current poses.
        placed: pose of the object; any leading axes.
        motion: motion of the object, which friction and damping resist; at rest where not given.
    """
    contacts = _parts(scene, placed)
    arms = contacts.points - jnp.asarray(placed.origin)[..., None, :]
    approach = jnp.zeros(contacts.points.shape)
    if motion is not None:
        approach = motion.linear[..., None, :] + jnp.cross(motion.angular[..., None, :], arms)
    sliding = approach - contacts.velocities
    along = jnp.sum(sliding * contacts.normals, -1)
    # f_n = max(K d - D v_n, 0) and f_t = -mu f_n v_t / sqrt(|v_t|^2 + CREEP^2)
    pressed = jnp.where(
        contacts.depths > 0, jnp.maximum(contacts.stiffness * contacts.depths - contacts.damping * along, 0), 0
    )
    tangential = sliding - along[..., None] * contacts.normals
    friction = contacts.friction * pressed / jnp.sqrt(jnp.sum(tangential**2, -1) + CREEP**2)
    return resultant(arms, pressed[..., None] * contacts.normals - friction[..., None] * tangential)


def hand_torques(scene: Scene, posture: Posture) -> Float[Array, "*batch J"]:
    """Compute the joint torques from the table and obstacles that the hand itself touches: springs of eq. 6, without
    friction [N.m].

    Args:
        scene: scene with obstacles at their current poses.
        posture: posture of the hand; any leading axes.
    """
    frames = pose_hand(scene.hand, posture)
    torques = jnp.zeros(posture.angles.shape)
    table = [(Plane(), scene.table)] if scene.table_touches_hand else []
    for shape, placed in table + [(o.shape, o.placed) for o in scene.obstacles if o.touches_hand]:
        contacts = find_contacts(scene.hand, posture, shape, placed)
        pressed = scene.contributions * scene.stiffness * contacts.depths * contacts.present
        torques = torques + joint_torques(scene.hand, frames, contacts.points, pressed[..., None] * contacts.normals)
    return torques


class Stopped(NamedTuple):
    """A motion as limited by obstacles, and whether they changed it."""

    motion: Motion
    touches: Array


def stop(
    scene: Scene, placed: Pose, motion: Motion, dt: float | AnyArray, start_time: float | AnyArray = 0.0
) -> Stopped:
    """Compute the motion closest to an object's own that moves no part of it deeper into an obstacle.

    Args:
        scene: scene with its obstacles and guide.
        placed: pose of the object.
        motion: free motion of the object's centre.
        dt: length of the step [s].
        start_time: start of the step, for obstacles that move [s].
    """
    agility = mobility(scene.body, placed, scene.guide)
    free, before = jnp.concatenate(motion), _parts(at_time(scene, start_time), placed)
    parts = before.depths.shape[-1]

    def correct(k: Array, state: _Constrained) -> _Constrained:
        sample = _first_contact(scene, placed, before, Motion(state.motion[:3], state.motion[3:]), dt, start_time)
        deepening = sample.parts.depths - before.depths
        normals = sample.parts.normals
        pushed = jnp.sum(normals * sample.parts.velocities, -1)
        rows = jnp.concatenate([normals, jnp.cross(sample.parts.points - sample.origin, normals)], -1)
        rows = jnp.where((deepening > 0)[:, None], rows, 0)
        # rows . motion >= bound: no deeper at the end of the step than before it. Constraints of earlier corrections
        # stay, so that the object does not return into an obstacle that it has left. To move with the obstacle is
        # always allowed: to stand still, where the obstacle does.
        excess = (rows @ state.motion - pushed) * sample.time + deepening
        bound = jnp.where(deepening > 0, pushed + jnp.minimum(excess / dt, 0), 0)
        rows = lax.dynamic_update_slice_in_dim(state.rows, rows, k * parts, 0)
        bound = lax.dynamic_update_slice_in_dim(state.bound, bound, k * parts, 0)
        # v = v_free + M^-1 A' p, with p >= 0 complementary to A v - b >= 0
        impulses = minimise_nonnegative(rows @ agility @ rows.T, rows @ free - bound)
        return _Constrained(free + agility @ (impulses @ rows), rows, bound)

    start = _Constrained(
        free,
        jnp.zeros((CORRECTIONS * parts, 6), free.dtype),
        jnp.zeros(CORRECTIONS * parts, free.dtype),
    )
    result = lax.fori_loop(0, CORRECTIONS, correct, start)
    return Stopped(Motion(result.motion[:3], result.motion[3:]), jnp.any(result.rows != 0))


class _PathSample(NamedTuple):
    """Contacts with obstacles at a point of the path, with the object's position and the time."""

    parts: "_ObstacleContacts"
    origin: Array
    time: Array


def _first_contact(
    scene: Scene,
    placed: Pose,
    before: "_ObstacleContacts",
    motion: Motion,
    dt: float | AnyArray,
    start_time: float | AnyArray,
) -> _PathSample:
    """Find the first sample of the path where any part is deeper than before, else the last.

    Samples are no further apart than the object's smallest ball is wide, so that it cannot pass through a thin board.
    """
    assert scene.outline is not None
    centers, radii = scene.outline.skin.centers, scene.outline.skin.radii
    finest = jnp.min(jnp.where(radii > 0, radii, jnp.inf))
    reach = jnp.max(jnp.linalg.norm(centers, axis=-1))
    fastest = jnp.max(jnp.linalg.norm(before.velocities, axis=-1))
    travel = dt * (jnp.linalg.norm(motion.linear) + reach * jnp.linalg.norm(motion.angular) + fastest)
    count = jnp.clip(jnp.ceil(travel / finest), 1, MAX_SAMPLES)

    def step(state: tuple[Array, _PathSample]) -> tuple[Array, _PathSample]:
        k = state[0] + 1
        time = dt * k / count
        pose = moved(placed, motion, time, scene.guide)
        parts = _parts(at_time(scene, start_time + time), pose)
        return k, _PathSample(parts, jnp.asarray(pose.origin), jnp.asarray(time))

    def is_clear(state: tuple[Array, _PathSample]) -> Array:
        return (state[0] < count) & ~jnp.any(state[1].parts.depths > before.depths)

    start = _PathSample(before, jnp.asarray(placed.origin), jnp.zeros_like(travel))
    return lax.while_loop(is_clear, step, (jnp.zeros_like(count), start))[1]


class _Constrained(NamedTuple):
    """A motion, and the half-spaces rows.motion >= bound that it must stay in; a row of zeros is no constraint."""

    motion: Array
    rows: Array
    bound: Array


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
    contacts = [_contacts_with(scene, obstacle, placed) for obstacle in scene.obstacles]
    axis = contacts[0].depths.ndim - 1
    return jax.tree.map(lambda *parts: jnp.concatenate(parts, axis), *contacts)


def _contacts_with(scene: Scene, obstacle: Obstacle, placed: Pose) -> _ObstacleContacts:
    assert scene.outline is not None
    contacts = world_contacts(scene.outline, placed, obstacle.shape, obstacle.placed)
    velocities = jnp.zeros(contacts.points.shape)
    if (motion := obstacle.motion) is not None:
        velocities = motion.linear + jnp.cross(motion.angular, contacts.points - obstacle.placed.origin)
    laws = (obstacle.stiffness, obstacle.friction, obstacle.damping)
    columns = (jnp.broadcast_to(jnp.asarray(law, contacts.depths.dtype), contacts.depths.shape) for law in laws)
    return _ObstacleContacts(contacts.points, contacts.normals, contacts.depths, velocities, *columns)
