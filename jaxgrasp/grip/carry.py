"""A hand and an object over time: contacts, forces, verdict, and where the object goes next.

- STABLE: the object goes where its contacts go.
- SLIPPING: what the contacts cannot exert of the wrench that would take it along lags behind, or slides down. By the
  closed form each contact exerts its force as far as its friction goes, whether or not other forces would hold. By the
  optimum, which slips only where none hold, they exert what comes closest, by how it would move the object. An object
  that stands on the table, and can stay there at rest, does so.
- LOST: it keeps the motion that it had, and falls.

The wrench holds the object's weight, gives it the acceleration of its contacts, and resists the obstacles that it is
pressed into. A guide carries what it can of all that. Table and obstacles stop what moves by itself: nothing bounces.
"""

from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.force.reachable import reachable_wrench
from jaxgrasp.grip.falling import fallen, gone_on, led_on
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.motion import (
    Motion,
    follow,
    follow_along,
    guide_at,
    mobility,
    motion_between,
    moved,
    rest_on,
    spatial_inertia,
)
from jaxgrasp.grip.obstacles import stop
from jaxgrasp.grip.scene import Scene, at_time, check_scene
from jaxgrasp.grip.slipping import Exerted
from jaxgrasp.grip.tick import Tick, Touches, assessed, touched
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.validation.checked import checked


class Instant(NamedTuple):
    """A tick of a scene that goes on."""

    placed: Pose
    """Where the object was."""
    tick: Tick
    hold: Hold
    stands: bool
    """Whether the table or an obstacle carried it."""
    exerted: Float[Array, "L 3"]
    """What the contacts exert on the object [N]."""
    missed: Float[Array, "6"]
    """What they and the table leave of the wrench [N, N.m]."""
    moments: Float[Array, "L"] | None = None
    """What soft fingers exert on the object about their normals [N.m]; None where all are hard."""


Record = TypeVar("Record")


def stacked(record: list[Record]) -> Record:
    """Trees of all instants in one: NumPy arrays with a leading axis of time."""
    return jax.device_get(jax.tree.map(lambda *parts: np.stack(parts), *record))


class CarryState(NamedTuple):
    """Where an object is on its way."""

    placed: Pose
    motion: Motion
    """Motion that brought it there."""
    stands: Array
    before: Pose
    """Where that began."""
    time: Array
    """Since it was set down [s]."""


@checked
def carry(scene: Scene, postures: Posture, placed: Pose, dt: float, *, law: Law = "closed-form") -> list[Instant]:
    """What becomes of an object while a hand goes through postures.

    Stable, it goes where its contacts go, and presses into obstacles as far as the hand presses it; slipping, what the
    contacts cannot exert of the wrench lags behind; lost, it falls. A loop in Python over compiled ticks, so that only
    an object that slips by the optimum pays for the closest wrench.

    Args:
        scene: hand, object, table, guide, obstacles, and the laws of their contacts.
        postures: with a leading axis T of instants; the hand is at rest before the first and after the last, so
            that one that moves at once jolts what it holds.
        placed: where the object stands at first, at rest.
        dt: time from one instant to the next [s].
        law: which forces decide whether the object slips, as for [`jaxgrasp.grip.monitor`][].

    Returns:
        An Instant for each posture: where the object was, its Tick, and what became of it. What a guide carries is
        the tick's wrench less what its forces exert.

    Raises:
        ValueError: for postures without that axis, a step of time that is not positive, a guide that is none, and
            obstacles without the object's outline.
    """
    check_instants(scene, postures, dt)
    frames = pose_hand(scene.hand, postures)
    count = frames.axes.shape[0]
    carried = set_down(scene, placed)
    instants = []
    for k in range(count):
        posture, now = (jax.tree.map(lambda x, k=k: x[k], tree) for tree in (postures, frames))
        later = jax.tree.map(lambda x, k=k: x[min(k + 1, count - 1)], frames)
        instant, carried = advance(scene, dt, carried, posture, now, later, law=law)
        instants.append(instant)
    return instants


def check_instants(scene: Scene, postures: Posture, dt: float) -> None:
    """Raise ValueError for what no hand can go through in this scene."""
    if not dt > 0:
        raise ValueError(f"dt is {dt!r}: expected a positive time [s]")
    check_scene(scene)
    if np.ndim(postures.angles) != 2:
        raise ValueError(f"postures.angles has shape {np.shape(postures.angles)}: expected (T, J), T instants")


def set_down(scene: Scene, placed: Pose) -> CarryState:
    """An object at rest, before anything happens to it."""
    start = Pose(*map(jnp.asarray, (placed.origin, placed.rotation)))
    still = Motion(jnp.zeros(3), jnp.zeros(3))
    return CarryState(start, still, rest_on(scene.table, scene.body.shape, start, still)[2], start, jnp.zeros(()))


def advance(
    scene: Scene, dt: float, carried: CarryState, posture: Posture, now: HandFrames, later: HandFrames, *, law: Law
) -> tuple[Instant, CarryState]:
    """An instant of ``carry``, and where the object is at the next.

    Args:
        scene: as for ``carry``; it is not checked again.
        dt: time to the next instant [s].
        carried: where the object is.
        posture: of the hand now.
        now: the hand's frames in that posture.
        later: those of the next instant.
        law: as for ``carry``.
    """
    tick, led = _tick(scene, dt, carried, posture, now, later, law=law)
    hold = Hold(int(tick.assessment.hold))
    exerted, missed = tick.by_hand, missed_by(tick)
    if law == "optimum" and bool(tick.slips):
        exerted, missed = closest_to(scene, tick, carried.placed)
    instant = Instant(carried.placed, tick, hold, bool(carried.stands), exerted.forces, missed, exerted.moments)
    return instant, go_on(scene, dt, carried, led, missed, tick.assessment.hold, tick.rests)


@partial(jax.jit, static_argnames="law")
def _tick(
    scene: Scene,
    dt: float | AnyArray,
    state: CarryState,
    posture: Posture,
    now: HandFrames,
    later: HandFrames,
    *,
    law: Law,
) -> tuple[Tick, Motion]:
    """An instant, and the motion that the object's contacts ask of it: its own, where nothing touches."""
    scene = at_time(scene, state.time)
    return led_tick(scene, dt, state, touched(scene, posture, state.placed), now, later, law)


def led_tick(
    scene: Scene,
    dt: float | AnyArray,
    state: CarryState,
    touches: Touches,
    now: HandFrames,
    later: HandFrames,
    law: Law,
) -> tuple[Tick, Motion]:
    """An instant, and the motion that its contacts ask of the object, for contacts that are known, with obstacles as
    they are in the scene."""
    contacts, grasp = touches.contacts, touches.grasp
    lost = ~jnp.any(contacts.present > 0)
    weights = jnp.where(lost, 1.0, jnp.asarray(grasp.squeeze) * contacts.present)
    followed = _followed(scene, dt, now, later, contacts.points, weights, state.placed)
    led = Motion(*(jnp.where(lost, own, new) for own, new in zip(state.motion, followed, strict=True)))
    gained = jnp.concatenate([(new - own) / dt for own, new in zip(state.motion, led, strict=True)])
    inertia = spatial_inertia(scene.body, state.placed.rotation)
    spin = jnp.append(jnp.zeros(3), jnp.cross(led.angular, inertia[3:, 3:] @ led.angular))
    return assessed(scene, now, state.placed, touches, inertia @ gained + spin, law, led), led


def _followed(
    scene: Scene, dt: float | AnyArray, now: HandFrames, later: HandFrames, points: Array, weights: Array, placed: Pose
) -> Motion:
    """The motion of an object that goes with its contacts."""
    if scene.guide is None:
        return motion_between(placed, follow(now, later, points, weights, placed), dt)
    return follow_along(scene.guide, now, later, points, weights, placed, dt)


def missed_by(tick: Tick) -> Array:
    """What the contacts leave of a wrench: nothing where they hold it, or the table does."""
    return jnp.where((tick.assessment.hold == Hold.STABLE) | tick.rests, 0, tick.left_by(tick.by_hand))


def closest_to(scene: Scene, tick: Tick, placed: Pose) -> tuple[Exerted, Array]:
    """What comes closest to a tick's wrench, which no allowed forces exert, by how what it leaves moves the object; and
    what it leaves."""
    left, inertia = tick.wrench - tick.support, spatial_inertia(scene.body, placed.rotation)
    free = None if scene.guide is None else guide_at(scene.guide, placed.origin)
    closest = reachable_wrench(tick.grasp, left, inertia=inertia, free=free)
    return Exerted(closest.forces, closest.moments), left - closest.wrench


@jax.jit
def go_on(
    scene: Scene, dt: float | AnyArray, state: CarryState, led: Motion, missed: Array, hold: Array, rests: Array
) -> CarryState:
    """The object's next pose and motion: as it was led, less what was missed; none, where it rests; or as it falls."""
    placed, lost = state.placed, hold == Hold.LOST
    lag = mobility(scene.body, placed, scene.guide) @ missed * dt
    slid = Motion(*(jnp.where(rests, 0, part) for part in (led.linear - lag[:3], led.angular - lag[3:])))
    going = gone_on(scene, dt, state.before, state.motion, placed)
    motion, blocked = _either(lost, fallen(scene, dt, placed, going), slid), jnp.asarray(False)
    if scene.obstacles:
        stopped = stop(scene, placed, motion, dt, state.time)
        alone = hold != Hold.STABLE
        motion, blocked = _either(alone, stopped.motion, motion), alone & stopped.touches
    if scene.guide is not None:
        motion = _either(lost, led_on(scene, dt, placed, going, motion), motion)
    there = moved(placed, motion, dt, scene.guide)
    held = None if scene.guide is None else placed
    there, motion, stands = rest_on(scene.table, scene.body.shape, there, motion, held)
    return CarryState(there, motion, stands | blocked, placed, state.time + dt)


def _either(condition: Array, one: Motion, other: Motion) -> Motion:
    return Motion(*(jnp.where(condition, a, b) for a, b in zip(one, other, strict=True)))
