"""Simulation of a hand and an object over time: contacts, forces, verdict, and motion of the object.

- STABLE: the object follows its contacts.
- SLIPPING: the object lags behind by the part of the wrench that the contacts do not exert. By the closed form each
  contact's force is cut to its friction, whether or not other forces would hold. By the optimum, which slips only where
  no forces hold, the contacts exert the closest feasible wrench, measured by the motion of the object.
- LOST: the object keeps its motion, and falls.

The wrench balances the object's weight and its acceleration with the contacts. A guide carries its part of that. Near
the table or an obstacle the contact engine moves the object (``object_step``): they stop it, rub on it, and move it in
the hand as its springs say. Nothing bounces.
"""

from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.force.reachable import nearest_wrench
from jaxgrasp.grip.contact_forces import ContactForces, cut_to_cones
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.motion import (
    Body,
    Motion,
    follow,
    follow_along,
    guide_at,
    height_above,
    mobility,
    motion_between,
    moved,
    spatial_inertia,
)
from jaxgrasp.grip.object_step import ContactOutcome, Surroundings, step_among_contacts, surroundings
from jaxgrasp.grip.scene import Scene, at_time, check_scene
from jaxgrasp.grip.tick import ContactMemory, StepResult, Touches, assess_touches, find_touches, no_memory
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.model.task import smooth_step
from jaxgrasp.numerics.geometry import rotation_by
from jaxgrasp.validation.checked import checked

NEWTON_STEPS = 4
"""Newton steps of an implicit step in time, which starts close to its solution."""
MIDPOINT_STEPS = 3
"""Fixed-point iterations for the twist whose momentum is right at the midpoint: each multiplies the error by about the
angle turned in half a step."""
HALVINGS = 40
"""Bisections for the largest motion that gains no energy."""


class Record(NamedTuple):
    """Result of one instant of a simulation."""

    placed: Pose
    """Pose of the object."""
    tick: StepResult
    hold: Hold
    stands: bool
    """True if the table or an obstacle carried the object."""
    exerted: Float[Array, "L 3"]
    """Forces of the contacts on the object [N]."""
    wrench_residual: Float[Array, "6"]
    """Part of the wrench that contacts and table do not exert [N, N.m]."""
    moments: Float[Array, "L"] | None = None
    """Moments of soft fingers on the object about their normals [N.m]; None where all are hard."""


Tree = TypeVar("Tree")


def stacked(record: list[Tree]) -> Tree:
    """Stack the trees of all instants into one tree of NumPy arrays with a leading axis of time."""
    return jax.device_get(jax.tree.map(lambda *parts: np.stack(parts), *record))


class SimulationState(NamedTuple):
    """State of the object between two instants."""

    placed: Pose
    motion: Motion
    """Motion that led to this pose."""
    stands: Array
    before: Pose
    """Pose at the previous instant."""
    time: Array
    """Time since the start [s]."""
    memory: ContactMemory
    """Friction and motion at contacts in the last step."""


class ObjectStep(NamedTuple):
    """An instant, and the motion of the object to the next one."""

    tick: StepResult
    followed: Motion
    """Motion of the hand's contacts; the object's own without contacts."""
    motion: Motion
    """Motion among contacts, where table or obstacles are near."""
    is_near: Array
    """True where table or obstacles are near."""
    stands: Array
    """True if table or obstacles bear any of the object."""
    memory: ContactMemory


@checked
def simulate(scene: Scene, postures: Posture, placed: Pose, dt: float, *, law: Law = "closed-form") -> list[Record]:
    """Simulate an object while a hand goes through postures.

    A stable object follows its contacts, as far as table and obstacles let it; a slipping object lags by the wrench
    residual; a lost object falls. A loop in Python calls compiled steps, so that only an object that
    slips by the optimum pays for the closest wrench.

    Args:
        scene: hand, object, table, guide, obstacles, and the laws of their contacts.
        postures: postures with a leading axis T of instants; the hand is at rest before the first and after the last,
            so that a sudden start jolts the object.
        placed: pose of the object at the start, at rest.
        dt: time from one instant to the next [s].
        law: force law that decides whether the object slips, as for [`jaxgrasp.grip.monitor`][].

    Returns:
        A Record for each posture: pose of the object, StepResult, and hold. The load of a guide is the tick's wrench
        less that of its forces.

    Raises:
        ValueError: for postures without that axis, a step of time that is not positive, an invalid guide, and obstacles
            without the object's outline.
    """
    check_instants(scene, postures, dt)
    frames = pose_hand(scene.hand, postures)
    count = frames.axes.shape[0]
    carried = initial_state(scene, placed)
    records = []
    for k in range(count):
        posture, current = (jax.tree.map(lambda x, k=k: x[k], tree) for tree in (postures, frames))
        later = jax.tree.map(lambda x, k=k: x[min(k + 1, count - 1)], frames)
        record, carried = advance(scene, dt, carried, posture, current, later, law=law)
        records.append(record)
    return records


def check_instants(scene: Scene, postures: Posture, dt: float) -> None:
    """Raise ValueError for a step of time, postures or a scene that no simulation can take."""
    if not dt > 0:
        raise ValueError(f"dt is {dt!r}: expected a positive time [s]")
    check_scene(scene)
    if np.ndim(postures.angles) != 2:
        raise ValueError(f"postures.angles has shape {np.shape(postures.angles)}: expected (T, J), T instants")


def initial_state(scene: Scene, placed: Pose) -> SimulationState:
    """Return the state of an object at rest at a pose, at time 0."""
    start = Pose(*map(jnp.asarray, (placed.origin, placed.rotation)))
    zero_motion = Motion(jnp.zeros(3), jnp.zeros(3))
    return SimulationState(
        start,
        zero_motion,
        height_above(scene.table, scene.body.shape, start) <= 0,
        start,
        jnp.zeros(()),
        no_memory(),
    )


def advance(
    scene: Scene,
    dt: float,
    carried: SimulationState,
    posture: Posture,
    current: HandFrames,
    later: HandFrames,
    *,
    law: Law,
) -> tuple[Record, SimulationState]:
    """Compute one instant of ``simulate``, and the object's state at the next.

    Args:
        scene: as for ``simulate``; it is not checked again.
        dt: time to the next instant [s].
        carried: state of the object.
        posture: posture of the hand.
        current: frames of the hand in that posture.
        later: frames of the hand at the next instant.
        law: as for ``simulate``.
    """
    step = _tick(scene, dt, carried, posture, current, later, law=law)
    tick = step.tick
    hold = Hold(int(tick.assessment.hold))
    exerted, residual = tick.by_hand, wrench_residual(tick)
    if law == "optimum" and bool(tick.slips & ~step.is_near):
        exerted, residual = closest_forces(scene, tick, carried.placed)
    record = Record(carried.placed, tick, hold, bool(carried.stands), exerted.forces, residual, exerted.moments)
    return record, integrate(scene, dt, carried, step, residual)


@partial(jax.jit, static_argnames="law")
def _tick(
    scene: Scene,
    dt: float | AnyArray,
    state: SimulationState,
    posture: Posture,
    current: HandFrames,
    later: HandFrames,
    *,
    law: Law,
) -> ObjectStep:
    """Compute an instant, and the motion of the object to the next."""
    scene = at_time(scene, state.time)
    return step_object(scene, dt, state, find_touches(scene, posture, state.placed), current, later, law)


class Approach(NamedTuple):
    """What is known of a step before its forces are."""

    followed: Motion
    falling: Motion
    """Motion under gravity alone."""
    around: Surroundings
    memory: ContactMemory
    inertial: Float[Array, "6"]
    """Wrench that accelerates the object with its contacts [N, N.m]."""


def step_object(
    scene: Scene,
    dt: float | AnyArray,
    state: SimulationState,
    touches: Touches,
    current: HandFrames,
    later: HandFrames,
    law: Law,
) -> ObjectStep:
    """Compute an instant for detected contacts and obstacles at their poses in the scene, and where table or obstacles
    are near, the motion among them."""
    approach = approach_step(scene, dt, state, touches, current, later)
    tick, _ = assess_touches(scene, current, state.placed, touches, approach.inertial, law, memory=approach.memory)
    return finish_step(scene, dt, state, approach, tick, current, later)


def approach_step(
    scene: Scene,
    dt: float | AnyArray,
    state: SimulationState,
    touches: Touches,
    current: HandFrames,
    later: HandFrames,
) -> Approach:
    """Compute the motions of a step with the hand and without it, and what the object may meet."""
    contacts, grasp = touches.contacts, touches.grasp
    placed, old = state.placed, state.motion
    is_lost = ~jnp.any(contacts.present > 0)
    weights = jnp.asarray(grasp.squeeze) * contacts.present
    # Where no contact squeezes, as with contributions of 0, all that are present lead the object alike.
    weights = jnp.where(jnp.any(weights > 0), weights, jnp.where(is_lost, 1.0, contacts.present))
    contact_motion = _following_motion(scene, dt, current, later, contacts.points, weights, placed)
    followed = select_motion(is_lost, old, contact_motion)
    free_motion = integrate_free(scene, dt, state.before, old, placed)
    falling = accelerate_by_gravity(scene, dt, placed, free_motion)
    around = surroundings(scene, placed, (old, followed, falling), dt)
    memory = jax.tree.map(lambda part, none: jnp.where(around.is_near, part, none), state.memory, no_memory())
    # Of an object that table or obstacles move in the hand, the hand accelerates what moves with it.
    drift = memory.drift
    acceleration = jnp.concatenate(
        [(new + shift - before) / dt for new, shift, before in zip(followed, drift, old, strict=True)]
    )
    inertia = spatial_inertia(scene.body, placed.rotation)
    # w = M a + (0, omega x I omega)
    spin = jnp.append(jnp.zeros(3), jnp.cross(followed.angular, inertia[3:, 3:] @ followed.angular))
    return Approach(followed, falling, around, memory, inertia @ acceleration + spin)


def finish_step(
    scene: Scene,
    dt: float | AnyArray,
    state: SimulationState,
    approach: Approach,
    tick: StepResult,
    current: HandFrames,
    later: HandFrames,
) -> ObjectStep:
    """Compute the motion of the object in a step, by the forces of its instant ``tick``."""
    followed, falling, around, memory, _ = approach

    def far() -> ContactOutcome:
        return ContactOutcome(falling, tick, jnp.asarray(False), no_memory())

    def near() -> ContactOutcome:
        return step_among_contacts(
            scene, dt, state.placed, state.motion, falling, memory, tick, followed, around, current, later
        )

    outcome = lax.cond(around.is_near, near, far)
    return ObjectStep(outcome.tick, followed, outcome.motion, around.is_near, outcome.stands, outcome.memory)


def _following_motion(
    scene: Scene,
    dt: float | AnyArray,
    current: HandFrames,
    later: HandFrames,
    points: Array,
    weights: Array,
    placed: Pose,
) -> Motion:
    """Compute the motion of an object that follows its contacts."""
    if scene.guide is None:
        return motion_between(placed, follow(current, later, points, weights, placed), dt)
    return follow_along(scene.guide, current, later, points, weights, placed, dt)


def wrench_residual(tick: StepResult) -> Array:
    """Return the part of the wrench that the contacts do not exert; zero where they or the table hold the object."""
    return jnp.where((tick.assessment.hold == Hold.STABLE) | tick.rests, 0, tick.left_by(tick.by_hand))


def closest_forces(scene: Scene, tick: StepResult, placed: Pose) -> tuple[ContactForces, Array]:
    """Compute the feasible forces whose wrench is closest to the required one, measured by the motion that the residual
    gives to the object; and the residual."""
    required, inertia = tick.wrench - tick.support, spatial_inertia(scene.body, placed.rotation)
    free = None if scene.guide is None else guide_at(scene.guide, placed.origin)
    closest = nearest_wrench(tick.grasp, required, inertia=inertia, free=free)
    # The search ends within its tolerance of the cones; what is felt is inside them.
    exerted = cut_to_cones(tick.grasp, ContactForces(closest.forces, closest.moments))
    return exerted, required - closest.wrench


@jax.jit
def integrate(
    scene: Scene, dt: float | AnyArray, state: SimulationState, step: ObjectStep, residual: Array
) -> SimulationState:
    """Integrate the object's pose and motion over one step: by the engine near table or obstacles, else with its
    contacts, less the lag by the wrench residual, or falling."""
    placed, is_lost = state.placed, step.tick.assessment.hold == Hold.LOST
    # Delta v = M^-1 r dt
    lag = mobility(scene.body, placed, scene.guide) @ residual * dt
    lagging = Motion(step.followed.linear - lag[:3], step.followed.angular - lag[3:])
    motion = select_motion(step.is_near | is_lost, step.motion, lagging)
    if scene.guide is not None:
        free_motion = integrate_free(scene, dt, state.before, state.motion, placed)
        motion = select_motion(is_lost, integrate_guided(scene, dt, placed, free_motion, motion), motion)
    pose = moved(placed, motion, dt, scene.guide)
    return SimulationState(pose, motion, step.stands, placed, state.time + dt, step.memory)


def select_motion(condition: Array, first: Motion, second: Motion) -> Motion:
    """Return the first motion where the condition holds, else the second."""
    return Motion(*(jnp.where(condition, a, b) for a, b in zip(first, second, strict=True)))


def accelerate_by_gravity(scene: Scene, dt: float | AnyArray, placed: Pose, free_motion: Motion) -> Motion:
    """Return an object's motion after an instant of gravity, from the motion that it has without it."""
    if scene.guide is None:
        spin = integrate_spin(scene.body, placed.rotation, free_motion.angular, dt)
        return Motion(free_motion.linear + dt * jnp.asarray(scene.gravity), spin)
    pull = jnp.append(scene.body.mass * jnp.asarray(scene.gravity), jnp.zeros(3))
    # Delta v = M^-1 (m g, 0) dt
    change = mobility(scene.body, placed, scene.guide) @ pull * dt
    return Motion(free_motion.linear + change[:3], free_motion.angular + change[3:])


def integrate_free(scene: Scene, dt: float | AnyArray, before: Pose, motion_before: Motion, placed: Pose) -> Motion:
    """Return the later motion of an object on which only its guide acts.

    The momentum along the guide is conserved, since the guide's twists are constant in the world and its forces do no
    work along them; and so is the kinetic energy.

    Args:
        scene: scene with the body and its guide.
        dt: length of the step to ``placed`` [s].
        before: pose before that step.
        motion_before: motion in that step.
        placed: pose after it.
    """
    if scene.guide is None:
        return motion_before
    middle, middle_motion = _halfway(scene, dt, before, jnp.concatenate(motion_before))
    momentum = spatial_inertia(scene.body, middle.rotation) @ middle_motion
    # v = M^-1 p, scaled by sqrt(E / E_new)
    motion = mobility(scene.body, placed, scene.guide) @ _momentum_about(momentum, middle, placed)
    energy, new_energy = middle_motion @ momentum, motion @ spatial_inertia(scene.body, placed.rotation) @ motion
    motion = motion * jnp.sqrt(jnp.where(new_energy > 0, energy / jnp.where(new_energy > 0, new_energy, 1), 1))
    return Motion(motion[:3], motion[3:])


def integrate_guided(scene: Scene, dt: float | AnyArray, placed: Pose, free_motion: Motion, motion: Motion) -> Motion:
    """Find the steady twist along a guide that has a motion's momentum at the midpoint, scaled down where it would gain
    energy: over that of ``free_motion`` and the work of gravity, from which a curved guide deviates a little."""
    momentum = spatial_inertia(scene.body, placed.rotation) @ jnp.concatenate(motion)
    twist = jnp.concatenate(motion)
    for _ in range(MIDPOINT_STEPS):
        middle, _ = _halfway(scene, dt, placed, twist)
        middle_motion = mobility(scene.body, middle, scene.guide) @ _momentum_about(momentum, placed, middle)
        twist = _twist_about(middle_motion, middle, placed)
    energy = (
        jnp.concatenate(free_motion) @ spatial_inertia(scene.body, placed.rotation) @ jnp.concatenate(free_motion) / 2
    )

    def gains_energy(share: Array) -> Array:
        middle, middle_motion = _halfway(scene, dt, placed, share * twist)
        travel = moved(placed, Motion(share * twist[:3], share * twist[3:]), dt, scene.guide).origin - placed.origin
        work = scene.body.mass * jnp.asarray(scene.gravity) @ travel
        return middle_motion @ spatial_inertia(scene.body, middle.rotation) @ middle_motion / 2 > energy + work

    def halve(_, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        share = (low + high) / 2
        gains = gains_energy(share)
        return jnp.where(gains, low, share), jnp.where(gains, share, high)

    unit = jnp.ones_like(energy)
    share = jnp.where(gains_energy(unit), lax.fori_loop(0, HALVINGS, halve, (0 * unit, unit))[0], 1)
    return Motion(share * twist[:3], share * twist[3:])


def _halfway(scene: Scene, dt: float | AnyArray, placed: Pose, twist: Array) -> tuple[Pose, Array]:
    """Return the pose after half the time of a steady twist, and the motion of the centre there."""
    middle = moved(placed, Motion(twist[:3], twist[3:]), dt / 2, scene.guide)
    return middle, _twist_about(twist, placed, middle)


def _twist_about(twist: Array, old: Pose, new: Pose) -> Array:
    """Shift the reference point of a twist from one pose's origin to another's."""
    arm = jnp.asarray(new.origin) - old.origin
    return jnp.concatenate([twist[:3] + jnp.cross(twist[3:], arm), twist[3:]])


def _momentum_about(momentum: Array, old: Pose, new: Pose) -> Array:
    """Shift the reference point of a momentum from one pose's origin to another's."""
    arm = jnp.asarray(old.origin) - new.origin
    return jnp.concatenate([momentum[:3], momentum[3:] + jnp.cross(arm, momentum[:3])])


def integrate_spin(body: Body, rotation: AnyArray, angular: AnyArray, dt: float | AnyArray) -> Array:
    """Return the angular velocity of a free body after ``dt`` seconds.

    Euler's equations, I w' + w x I w = 0, by an implicit step in the body's own axes, where the inertia is constant:
    the step gains no energy.
    """
    inertia = body.inertia_matrix() / body.mass
    local = jnp.asarray(rotation).T @ angular

    def residual(spin: Array) -> Array:
        return inertia @ (spin - local) + dt * jnp.cross(spin, inertia @ spin)

    spin = local
    for _ in range(NEWTON_STEPS):
        spin = spin - jnp.linalg.solve(jax.jacfwd(residual)(spin), residual(spin))
    return jnp.asarray(rotation) @ spin


def lift_and_turn(
    closed: Posture, times: AnyArray, *, lift: float, turn: float, axis: AnyArray, release: Posture | None = None
) -> Posture:
    """Plan the postures of a hand that lifts an object: a quarter of the time each to hold, lift, turn, and hold or let
    go.

    Args:
        closed: posture that holds the object, with the wrist at its start.
        times: ``(T,)``, ascending [s].
        lift: height of the lift, along the world's z [m].
        turn: angle about ``axis`` through the wrist [rad].
        axis: unit vector ``(3,)`` in the world.
        release: posture whose angles release the object; ``None`` to hold on.

    Returns:
        Postures with a leading axis T, which start and stop smoothly.
    """
    phase = (jnp.asarray(times) - times[0]) / (times[-1] - times[0]) * 4
    lift_share, turn_share, open_share = (smooth_step(phase - start) for start in (1.0, 2.0, 3.0))
    rotation = jax.vmap(rotation_by)(turn * turn_share[:, None] * jnp.asarray(axis)) @ closed.wrist.rotation
    origin = closed.wrist.origin + lift * lift_share[:, None] * jnp.array([0.0, 0.0, 1.0])
    angles = jnp.broadcast_to(closed.angles, (len(phase), closed.angles.shape[0]))
    if release is not None:
        angles = angles + open_share[:, None] * (release.angles - closed.angles)
    return Posture(Pose(origin, rotation), angles)
