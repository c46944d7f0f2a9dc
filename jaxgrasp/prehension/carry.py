"""A hand and an object over time: contacts, forces, verdict, and where the object goes next.

- STABLE: the object goes where its contacts go.
- SLIPPING: the contacts exert what comes closest to the wrench that would take it along, by how it would move
  the object; what is missed of it lags behind, or slides down. Where the closed form slips although the optimum
  holds, nothing is missed, and the object stays in the hand.
- LOST: it keeps the motion that it had, and falls.

The wrench holds the object's weight and gives it the acceleration of its contacts. A table stops it: nothing bounces.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.contact.detection import Contacts, find_contacts
from jaxgrasp.contact.kinematics import joint_torques, pose_hand
from jaxgrasp.contact.to_grasp import grasp_from_contacts
from jaxgrasp.force.reachable import reachable_wrench
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.grasp import Grasp
from jaxgrasp.model.hand import Hand, HandFrames, Pose, Posture
from jaxgrasp.model.wrench import weight_wrench
from jaxgrasp.prehension.monitor import Assessment, Hold, Law, monitor
from jaxgrasp.prehension.motion import Body, Motion, follow, motion_between, moved, rest_on, spatial_inertia


class Scene(eqx.Module):
    """What stays the same while time goes on."""

    hand: Hand
    body: Body
    table: Pose
    """Its top is the xy plane of this frame; the half space below is solid."""
    friction: float | AnyArray
    stiffness: float | AnyArray
    """K of eq. 6 [N/m]"""
    contributions: Float[AnyArray, "L"]
    """c of eq. 6, of each link."""
    gravity: Float[AnyArray, "3"]
    """[m/s^2]"""


class Tick(eqx.Module):
    """One instant: what touches, which forces act, and whether they hold. Any leading axes."""

    contacts: Contacts
    grasp: Grasp
    """In a frame at the object's centre, along the world's axes."""
    wrench: Float[Array, "*batch 6"]
    """What the contacts must exert about that centre [N, N.m]."""
    assessment: Assessment
    torques: Float[Array, "*batch J"]
    """On the joints [N.m]: negative where they resist a positive angle."""


class Instant(NamedTuple):
    """A tick of a scene that goes on."""

    placed: Pose
    """Where the object was."""
    tick: Tick
    hold: Hold
    stands: bool
    """Whether the table carried it."""
    missed: Float[Array, "6"]
    """What of the wrench no allowed forces of these contacts could exert [N, N.m]."""


def stacked(record: list[Instant]) -> Instant:
    """All instants in one: NumPy arrays with a leading axis of time."""
    return jax.device_get(jax.tree.map(lambda *parts: np.stack(parts), *record))


def observe(
    scene: Scene,
    posture: Posture,
    placed: Pose,
    inertial: Float[AnyArray, "*#batch 6"] | None = None,
    *,
    law: Law = "closed-form",
) -> Tick:
    """One tick of the paper's loop: posture to contacts, forces by method B and its optimum, joint torques.

    Args:
        scene: hand, object, and the laws of their contacts.
        posture: of the hand; any leading axes.
        placed: where the object stands; leading axes that broadcast.
        inertial: wrench about the object's centre that accelerates it, beside its weight [N, N.m]; none at rest.
        law: which forces the hand applies, as for [`jaxgrasp.monitor`][].
    """
    contacts, grasp = _touched(scene, posture, placed)
    return _assessed(scene, pose_hand(scene.hand, posture), contacts, grasp, inertial, law)


def _assessed(
    scene: Scene,
    frames: HandFrames,
    contacts: Contacts,
    grasp: Grasp,
    inertial: Float[AnyArray, "*#batch 6"] | None,
    law: Law,
) -> Tick:
    weight = weight_wrench(scene.body.mass, jnp.zeros(3), scene.gravity)
    wrench = jnp.broadcast_to(weight, (*contacts.tests.shape, 6))
    if inertial is not None:
        wrench = wrench + inertial
    assessment = monitor(grasp, wrench, law=law)
    torques = joint_torques(scene.hand, frames, contacts.points, assessment.forces)
    return Tick(contacts, grasp, wrench, assessment, torques)


def _touched(scene: Scene, posture: Posture, placed: Pose) -> tuple[Contacts, Grasp]:
    """The contacts, and their Grasp in a frame at the object's centre, along the world's axes."""
    contacts = find_contacts(scene.hand, posture, scene.body.shape, placed)
    world = grasp_from_contacts(contacts, scene.friction, scene.stiffness, scene.contributions)
    points = world.points - jnp.asarray(placed.origin)[..., None, :]
    return contacts, Grasp(points, world.normals, world.friction, world.squeeze, world.present)


class _State(NamedTuple):
    placed: Pose
    motion: Motion
    stands: Array


def carry(scene: Scene, postures: Posture, placed: Pose, dt: float, *, law: Law = "closed-form") -> list[Instant]:
    """What becomes of an object while a hand goes through postures.

    A loop in Python over compiled ticks, so that only an object that slips pays for the closest wrench.

    Args:
        scene: hand, object, table, and the laws of their contacts.
        postures: with a leading axis T of instants.
        placed: where the object stands at first, at rest.
        dt: time from one instant to the next [s].
        law: which forces decide whether the object slips, as for [`jaxgrasp.monitor`][].

    Raises:
        ValueError: for a step of time that is not positive.
    """
    if not dt > 0:
        raise ValueError(f"dt is {dt!r}: expected a positive time [s]")
    frames = pose_hand(scene.hand, postures)
    count = frames.axes.shape[0]
    state = _State(placed, Motion(jnp.zeros(3), jnp.zeros(3)), jnp.asarray(False))
    state = state._replace(stands=rest_on(scene.table, scene.body.shape, placed, state.motion)[2])
    instants = []
    for k in range(count):
        posture, now = (jax.tree.map(lambda x, k=k: x[k], tree) for tree in (postures, frames))
        later = jax.tree.map(lambda x, k=k: x[min(k + 1, count - 1)], frames)
        tick, led = _tick(scene, dt, state, posture, now, later, law=law)
        hold = Hold(int(tick.assessment.hold))
        missed = _missed(scene, tick, state.placed, hold)
        instants.append(Instant(state.placed, tick, hold, bool(state.stands), missed))
        state = _go_on(scene, dt, state.placed, led, missed)
    return instants


@partial(jax.jit, static_argnames="law")
def _tick(
    scene: Scene, dt: float | AnyArray, state: _State, posture: Posture, now: HandFrames, later: HandFrames, *, law: Law
) -> tuple[Tick, Motion]:
    """An instant, and the motion that the object's contacts ask of it: its own, where nothing touches."""
    contacts, grasp = _touched(scene, posture, state.placed)
    lost = ~jnp.any(contacts.present > 0)
    weights = jnp.where(lost, 1.0, jnp.asarray(grasp.squeeze) * contacts.present)
    followed = motion_between(state.placed, follow(now, later, contacts.points, weights, state.placed), dt)
    led = Motion(*(jnp.where(lost, own, new) for own, new in zip(state.motion, followed, strict=True)))
    gained = jnp.concatenate([(new - own) / dt for own, new in zip(state.motion, led, strict=True)])
    inertia = spatial_inertia(scene.body, state.placed.rotation)
    spin = jnp.append(jnp.zeros(3), jnp.cross(led.angular, inertia[3:, 3:] @ led.angular))
    return _assessed(scene, now, contacts, grasp, inertia @ gained + spin, law), led


def _missed(scene: Scene, tick: Tick, placed: Pose, hold: Hold) -> Array:
    """What of the wrench the contacts cannot exert, measured by how it would move the object."""
    if hold == Hold.STABLE:
        return jnp.zeros_like(tick.wrench)
    if hold == Hold.LOST:
        return tick.wrench
    inertia = spatial_inertia(scene.body, placed.rotation)
    return tick.wrench - reachable_wrench(tick.grasp, tick.wrench, inertia=inertia).wrench


@jax.jit
def _go_on(scene: Scene, dt: float | AnyArray, placed: Pose, led: Motion, missed: Array) -> _State:
    """The object's next pose and motion: as it was led, less what was missed."""
    lag = jnp.linalg.solve(spatial_inertia(scene.body, placed.rotation), missed) * dt
    motion = Motion(led.linear - lag[:3], led.angular - lag[3:])
    return _State(*rest_on(scene.table, scene.body.shape, moved(placed, motion, dt), motion))
