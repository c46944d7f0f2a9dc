"""Obstacles to object and hand: springs to a hand that presses into them, and rigid to an object that moves freely."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.grip.contact_forces import resultant
from jaxgrasp.grip.motion import Motion
from jaxgrasp.grip.scene import Obstacle, Scene
from jaxgrasp.hand.detection import Contacts, find_contacts
from jaxgrasp.hand.kinematics import joint_torques, pose_hand
from jaxgrasp.hand.shapes import Plane, Shape
from jaxgrasp.model.arrays import Float
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.numerics.vec3 import Vec3

CREEP = 1e-3
"""Speed of sliding at which friction reaches seven tenths of its full value, where only a motion is given and no step
[m/s]: at rest it has no direction."""
BLUR = 1e-4
"""Balls of a part of the outline whose gaps differ by this act together [m]: a face meets an obstacle in its middle."""
ABSENT = 1e3
"""Gap of a part of the outline that has no balls [m]."""


class ObstacleContacts(NamedTuple):
    """Contacts of every part of the object's outline with every obstacle, ``(..., m, 3)`` or ``(..., m)``."""

    points: Array
    """Points of the obstacle's surface [m]."""
    normals: Array
    """Unit normals, into the object."""
    gaps: Array
    """Distance of the part from the obstacle [m]; negative for the depth of its deepest point."""
    velocities: Array
    """Velocity of the obstacle, where it is touched [m/s]."""
    stiffness: Array
    friction: Array
    damping: Array


def world_wrench(scene: Scene, placed: Pose, motion: Motion | None = None) -> Float[Array, "*batch 6"]:
    """Compute the wrench of all obstacles on the object, about its centre [N, N.m].

    Args:
        scene: scene with obstacles at their current poses.
        placed: pose of the object; any leading axes.
        motion: motion of the object, which friction and damping resist; at rest where not given.
    """
    contacts = obstacle_contacts(scene, placed)
    arms = contacts.points - jnp.asarray(placed.origin)[..., None, :]
    pressed = contacts.stiffness * jnp.maximum(-contacts.gaps, 0)
    approach = jnp.zeros(contacts.points.shape)
    if motion is not None:
        approach = motion.linear[..., None, :] + jnp.cross(motion.angular[..., None, :], arms)
    sliding = approach - contacts.velocities
    along = jnp.sum(sliding * contacts.normals, -1)
    # f_n = max(K d - D v_n, 0) and f_t = -mu f_n v_t / sqrt(|v_t|^2 + CREEP^2)
    pressed = jnp.where(contacts.gaps < 0, jnp.maximum(pressed - contacts.damping * along, 0), 0)
    tangential = sliding - along[..., None] * contacts.normals
    friction = contacts.friction * pressed / jnp.sqrt(jnp.sum(tangential**2, -1) + CREEP**2)
    return resultant(arms, pressed[..., None] * contacts.normals - friction[..., None] * tangential)


def spring_wrench(contacts: ObstacleContacts, placed: Pose) -> Float[Array, "*batch 6"]:
    """Compute the wrench of obstacles as springs without friction and damping, about the object's centre [N, N.m]."""
    # eq. 1: f = K d
    pressed = contacts.stiffness * jnp.maximum(-contacts.gaps, 0)
    arms = contacts.points - jnp.asarray(placed.origin)[..., None, :]
    return resultant(arms, pressed[..., None] * contacts.normals)


def hand_torques(scene: Scene, posture: Posture) -> Float[Array, "*batch J"]:
    """Compute the joint torques from the table and obstacles that the hand itself touches: springs of eq. 6, without
    friction [N.m].

    Args:
        scene: scene with obstacles at their current poses.
        posture: posture of the hand; any leading axes.
    """
    contacts = [find_contacts(scene.hand, posture, *surface) for surface in felt_surfaces(scene)]
    return surface_torques(scene, pose_hand(scene.hand, posture), contacts)


def felt_surfaces(scene: Scene) -> list[tuple[Shape, Pose]]:
    """Return table and obstacles, at their poses in the scene, as far as the hand itself touches them."""
    table: list[tuple[Shape, Pose]] = [(Plane(), scene.table)] if scene.table_touches_hand else []
    return table + [(obstacle.shape, obstacle.placed) for obstacle in scene.obstacles if obstacle.touches_hand]


def surface_torques(scene: Scene, frames: HandFrames, contacts: Sequence[Contacts]) -> Float[Array, "*batch J"]:
    """Compute as ``hand_torques`` does, from the contacts of the hand with each of its ``felt_surfaces``."""
    torques = jnp.zeros(frames.axes.shape[:-1])
    for touched in contacts:
        pressed = scene.contributions * scene.stiffness * touched.depths * touched.present
        torques = torques + joint_torques(scene.hand, frames, touched.points, pressed[..., None] * touched.normals)
    return torques


def obstacle_contacts(scene: Scene, placed: Pose) -> ObstacleContacts:
    """Find the contacts of the object's outline with obstacles at their poses in the scene, near or touching.

    Args:
        scene: scene with obstacles at their current poses and velocities.
        placed: pose of the object; any leading axes.
    """
    contacts = [_contacts_with(scene, obstacle, placed) for obstacle in scene.obstacles]
    axis = contacts[0].gaps.ndim - 1
    return jax.tree.map(lambda *parts: jnp.concatenate(parts, axis), *contacts)


def _contacts_with(scene: Scene, obstacle: Obstacle, placed: Pose) -> ObstacleContacts:
    assert scene.outline is not None
    skin = scene.outline.skin
    turn = jnp.asarray(placed.rotation)
    centers = jnp.asarray(placed.origin)[..., None, None, :] + jnp.einsum("...ij,pkj->...pki", turn, skin.centers)
    obstacle_turn = jnp.asarray(obstacle.placed.rotation)
    local = (centers - obstacle.placed.origin) @ obstacle_turn
    distance, out = obstacle.shape._distance(Vec3(*(local[..., i] for i in range(3))))
    is_ball = jnp.asarray(skin.radii) > 0
    gaps = jnp.where(is_ball, distance - skin.radii, ABSENT)
    nearest = jnp.min(gaps, -1, keepdims=True)
    # Means over the balls near the deepest one, which change without a jump as the object turns.
    share = jnp.where(is_ball, jnp.exp(-(gaps - nearest) / BLUR), 0)
    share = share / jnp.maximum(jnp.sum(share, -1, keepdims=True), 1e-300)
    outward = jnp.stack(jnp.broadcast_arrays(*out), -1)
    normals = jnp.sum(share[..., None] * outward, -2)
    length = jnp.linalg.norm(normals, axis=-1, keepdims=True)
    normals = (
        jnp.where(length > 0, normals / jnp.where(length > 0, length, 1), jnp.array([1.0, 0, 0])) @ obstacle_turn.T
    )
    surface = local - distance[..., None] * outward
    points = jnp.sum(share[..., None] * surface, -2) @ obstacle_turn.T + obstacle.placed.origin
    velocities = jnp.zeros(points.shape)
    if (motion := obstacle.motion) is not None:
        velocities = motion.linear + jnp.cross(motion.angular, points - obstacle.placed.origin)
    laws = (obstacle.stiffness, obstacle.friction, obstacle.damping)
    gaps = nearest[..., 0]
    columns = (jnp.broadcast_to(jnp.asarray(law, gaps.dtype), gaps.shape) for law in laws)
    return ObstacleContacts(points, normals, gaps, velocities, *columns)
