"""Motion of an object near a table or obstacles over one step, and the forces of all its contacts.

- An object that the hand holds follows it; links, table and obstacles are contacts of the contact engine. The links
  exert the forces of the hand's law where the object moves with them. By as much as table and obstacles move it in the
  hand, each link changes its force as a spring of eq. 6 does, within its friction.
- On an object that the hand does not hold, each link presses by eq. 6 and rubs.
- Table and obstacles are rigid and rub; to an object in the hand obstacles are springs (eq. 1).

The wrench that is left for the hand is what the law distributes at the next instant.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from jaxgrasp.grip.contact_forces import ContactForces, resultant
from jaxgrasp.grip.contact_step import RIGID, ContactRows, ContactStep, solve_contacts
from jaxgrasp.grip.monitor import Hold
from jaxgrasp.grip.motion import Motion, guide_at, spatial_inertia
from jaxgrasp.grip.obstacles import ObstacleContacts, obstacle_contacts
from jaxgrasp.grip.scene import Scene
from jaxgrasp.grip.table_support import FADE, TableFriction, table_points
from jaxgrasp.grip.tick import ContactMemory, StepResult, no_memory
from jaxgrasp.hand.kinematics import joint_torques
from jaxgrasp.model.arrays import AnyArray, Bool, Float
from jaxgrasp.model.hand import HandFrames, Pose
from jaxgrasp.numerics.geometry import rotation_by

DEPTH = 1e-6
"""Depth of a free object that is corrected [m]."""
CORRECTIONS = (1.0, 0.3, 0.1, 0.03)
"""Shares of the depth that are corrected: the first that gains no energy."""
PUSHED_OUT = 0.2
"""Share of the depth in the table that an object beside a hand leaves in a step."""
SLOWLY = 1e-3
"""Largest speed at which it does so [m/s]."""
QUIET = 1e-4
"""Speed below which hand and object count as at rest [m/s]."""
ASLEEP = 1e-4
"""Speed below which an object that the hand does not hold comes to rest [m/s]."""
FORGETTING_TIME = 0.1
"""Time constant with which the table takes over what its friction bore while the object was dragged [s]."""
FORGOTTEN = 1e-3
"""Share below which that friction has gone."""


class Surroundings(NamedTuple):
    """Points of an object that may meet the table, its contacts with obstacles, and whether any is near."""

    points: Float[Array, "m 3"]
    heights: Float[Array, "m"]
    obstacles: ObstacleContacts | None
    is_near: Bool[Array, ""]


def surroundings(scene: Scene, placed: Pose, motions: tuple[Motion, ...], dt: float | AnyArray) -> Surroundings:
    """Find what an object may meet in a step of ``dt`` seconds with any of some motions."""
    points, heights = table_points(scene, placed)
    extent = jnp.max(jnp.linalg.norm(points, axis=-1))
    speeds = [jnp.linalg.norm(m.linear) + extent * jnp.linalg.norm(m.angular) for m in motions]
    travel = dt * (jnp.max(jnp.stack(speeds)) + dt * jnp.linalg.norm(jnp.asarray(scene.gravity)))
    nearest, obstacles = jnp.min(heights), None
    if scene.obstacles:
        obstacles = obstacle_contacts(scene, placed)
        coming = dt * jnp.linalg.norm(obstacles.velocities, axis=-1)
        nearest = jnp.minimum(nearest, jnp.min(obstacles.gaps - coming))
    return Surroundings(points, heights, obstacles, nearest < FADE + 2 * travel)


class ContactOutcome(NamedTuple):
    """Motion of an object in a step among contacts, its instant with the forces that acted, and what it leaves."""

    motion: Motion
    tick: StepResult
    stands: Array
    memory: ContactMemory


def step_among_contacts(
    scene: Scene,
    dt: float | AnyArray,
    placed: Pose,
    old_motion: Motion,
    free_motion: Motion,
    memory: ContactMemory,
    tick: StepResult,
    followed: Motion,
    around: Surroundings,
    current: HandFrames,
    later: HandFrames,
) -> ContactOutcome:
    """Move an object near table or obstacles by one step.

    Args:
        scene: scene with obstacles at their poses and velocities.
        dt: length of the step [s].
        placed: pose of the object at the start.
        old_motion: motion that led there.
        free_motion: motion at the end of the step under gravity alone.
        memory: of the step before.
        tick: instant of the hand's law at the start.
        followed: motion of the hand's contacts.
        around: surroundings at the start.
        current: frames of the hand at the start.
        later: frames of the hand at the end.
    """
    inertia = spatial_inertia(scene.body, placed.rotation)
    holds, has_hand = tick.assessment.hold == Hold.STABLE, tick.assessment.hold != Hold.LOST
    resistance = RIGID * jnp.asarray(scene.body.mass) / dt
    groups = [
        _hand_rows(scene, dt, tick, followed, holds, resistance, current, later),
        _table_rows(scene, dt, around.points, around.heights, resistance, has_hand),
        _support_rows(scene, dt, placed, tick, holds, resistance),
    ]
    if around.obstacles is not None:
        groups.append(_obstacle_rows(around.obstacles, dt, placed, has_hand, resistance))
    counts = [len(group.friction) for group in groups]
    rows: ContactRows = jax.tree.map(lambda *parts: jnp.concatenate(parts), *groups)
    # In the hand the object moves relative to it about as in the last step.
    in_hand = jnp.concatenate(followed) + jnp.concatenate(memory.drift)
    guess = jnp.where(holds, in_hand, jnp.concatenate(old_motion))
    if scene.guide is None:
        result = _solved_and_lifted_out(
            scene, dt, placed, old_motion, free_motion, inertia, rows, guess, counts, around, has_hand
        )
    else:
        basis = guide_at(scene.guide, placed.origin)
        result = solve_contacts(inertia, jnp.concatenate(free_motion), rows, dt, guess, basis)
    twist = _put_to_sleep(result.twist, around, holds)
    motion = Motion(twist[:3], twist[3:])

    starts = [sum(counts[:k]) for k in range(len(counts) + 1)]
    hand, table = (slice(*starts[0:2]), slice(starts[1], starts[3]))
    exerted = ContactForces(result.forces[hand], None if tick.moments is None else result.moments[hand])
    support = resultant(rows.points[table], result.forces[table])
    by_obstacles = jnp.zeros(6)
    if around.obstacles is not None:
        by_obstacles = resultant(rows.points[starts[3] :], result.forces[starts[3] :])
    # What acts moves the object: M (v - v_free) / dt is the wrench of all contacts.
    change = inertia @ (twist - jnp.concatenate(free_motion)) / dt
    by_hand = exerted.wrench(tick.grasp)
    support = support + (change - by_hand - support - by_obstacles if scene.guide is None else 0)
    weight = jnp.append(scene.body.mass * jnp.asarray(scene.gravity), jnp.zeros(3))
    wrench = by_hand + support
    inertial = wrench + by_obstacles + weight
    couples = exerted.couples(tick.grasp)
    torques = joint_torques(scene.hand, current, tick.contacts.points, exerted.forces, couples) + tick.blocked
    acted = eqx.tree_at(
        lambda t: (t.wrench, t.inertial, t.support, t.exerted, t.torques),
        tick,
        (wrench, inertial, support, exerted.forces, torques),
    )
    if exerted.moments is not None:
        acted = eqx.tree_at(lambda t: t.moments, acted, exerted.moments)
    stands = jnp.any(jnp.linalg.norm(result.forces[starts[1] :], axis=-1) > 0)
    remembered = _remembered(dt, placed, memory, followed, motion, around, holds, rows, result, table, starts[3])
    return ContactOutcome(motion, acted, stands, remembered)


def _rows(points: Array, normals: Array, **columns: Array) -> ContactRows:
    """Build rows; columns that are left out are zero."""
    count = points.shape[0]
    values = {
        name: jnp.zeros((count, 3) if name in ("velocity", "dragged") else count, points.dtype)
        for name in ContactRows._fields[2:]
    }
    values |= {name: jnp.broadcast_to(value, values[name].shape) for name, value in columns.items()}
    return ContactRows(points, jnp.broadcast_to(normals, points.shape), **values)


def _hand_rows(
    scene: Scene,
    dt: float | AnyArray,
    tick: StepResult,
    followed: Motion,
    holds: Array,
    resistance: Array,
    current: HandFrames,
    later: HandFrames,
) -> ContactRows:
    grasp, present = tick.grasp, tick.contacts.present > 0
    points, normals = jnp.asarray(grasp.points), jnp.asarray(grasp.normals)
    turns = later.links.rotation @ current.links.rotation.swapaxes(-1, -2)
    moved = jnp.einsum("lij,lj->li", turns, tick.contacts.points - current.links.origin) + later.links.origin
    of_links = (moved - tick.contacts.points) / dt
    skew = (turns - turns.swapaxes(-1, -2)) / (2 * dt)
    link_spin = jnp.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], -1)
    of_object = followed.linear + jnp.cross(followed.angular, points)
    along = jnp.sum(tick.exerted * normals, -1)
    # c K dt: by so much a spring of eq. 6 changes in a step at a speed of 1 m/s
    spring = present * scene.contributions * scene.stiffness * dt
    friction = jnp.broadcast_to(jnp.asarray(scene.friction, points.dtype), along.shape)
    radius = jnp.zeros_like(along)
    if scene.torsion is not None:
        radius = jnp.where(friction > 0, scene.torsion / jnp.where(friction > 0, friction, 1), 0)
    moments = jnp.zeros_like(along) if tick.moments is None else tick.moments
    return _rows(
        points,
        normals,
        friction=friction,
        spin_radius=radius,
        velocity=jnp.where(holds, of_object, of_links),
        spin=jnp.sum(jnp.where(holds, followed.angular, link_spin) * normals, -1),
        pressed=present * jnp.where(holds, along, grasp.squeeze),
        dragged=jnp.where(holds & present[:, None], tick.exerted - along[:, None] * normals, 0),
        twisted=jnp.where(holds & present, moments, 0),
        normal_resistance=spring,
        tangential_resistance=jnp.where(holds, spring, present * resistance),
    )


def _table_rows(
    scene: Scene, dt: float | AnyArray, points: Array, heights: Array, resistance: Array, has_hand: Array | bool = False
) -> ContactRows:
    up = jnp.asarray(scene.table.rotation)[:, 2]
    # A gap closes within the step at most; out of the table an object beside the hand comes slowly.
    leaving = jnp.minimum(PUSHED_OUT * jnp.maximum(-heights, 0) / dt, SLOWLY)
    leaving = jnp.where(has_hand & (scene.guide is None), leaving, 0)
    coming = (leaving - jnp.maximum(heights, 0) / dt)[:, None] * up
    friction = jnp.asarray(scene.table_friction, points.dtype)
    return _rows(
        points,
        up,
        friction=friction,
        velocity=coming,
        normal_resistance=resistance,
        tangential_resistance=resistance,
    )


def _support_rows(
    scene: Scene, dt: float | AnyArray, placed: Pose, tick: StepResult, holds: Array, resistance: Array
) -> ContactRows:
    """Return the rows of the points on which the table bears its share beside a hand that holds the object."""
    up = jnp.asarray(scene.table.rotation)[:, 2]
    heights = (jnp.asarray(placed.origin) - scene.table.origin + tick.table_points) @ up
    rows = _table_rows(scene, dt, tick.table_points, heights, jnp.where(holds, resistance, 0))
    pressed = jnp.where(holds, tick.table_pressed, 0)
    return rows._replace(pressed=pressed, floor=pressed)


def _obstacle_rows(
    contacts: ObstacleContacts, dt: float | AnyArray, placed: Pose, has_hand: Array, resistance: Array
) -> ContactRows:
    coming = jnp.where(has_hand, 0, -jnp.maximum(contacts.gaps, 0) / dt)[:, None] * contacts.normals
    spring = contacts.stiffness * dt + contacts.damping
    return _rows(
        contacts.points - placed.origin,
        contacts.normals,
        friction=contacts.friction,
        velocity=contacts.velocities + coming,
        pressed=jnp.where(has_hand, -contacts.stiffness * contacts.gaps, 0),
        normal_resistance=jnp.where(has_hand, spring, resistance),
        tangential_resistance=resistance,
    )


class _Attempt(NamedTuple):
    """Search for a step that does not end in the table or an obstacle."""

    attempts: Array
    shift: Float[Array, "m"]
    """Of each contact the depth that linear motion does not take into account [m]."""
    result: ContactStep
    done: Array


def _solved_and_lifted_out(
    scene: Scene,
    dt: float | AnyArray,
    placed: Pose,
    old_motion: Motion,
    free_motion: Motion,
    inertia: Array,
    rows: ContactRows,
    guess: Array,
    counts: list[int],
    around: Surroundings,
    has_hand: Array,
) -> ContactStep:
    """Solve a step; correct that of a free object that would end in the table or an obstacle, as its contacts move on
    arcs and not on straight lines: with energy that the step takes away, and no other."""
    up, mass = jnp.asarray(scene.table.rotation)[:, 2], jnp.asarray(scene.body.mass)
    free_twist, gravity = jnp.concatenate(free_motion), jnp.asarray(scene.gravity)
    arms = around.points

    def end_heights(twist: Array) -> Array:
        turn = rotation_by(twist[3:] * dt)
        return around.heights + (dt * twist[:3] + arms @ turn.T - arms) @ up

    def energy(twist: Array) -> Array:
        return twist @ inertia @ twist / 2 - mass * dt * (gravity @ twist[:3])

    def missed_and_deepest(twist: Array) -> tuple[Array, Array]:
        """Return the shift of each contact, and the depth at the end, below zero."""
        linear = around.heights + dt * (twist[:3] + jnp.cross(twist[3:], arms)) @ up
        ends = [end_heights(twist)]
        missed = [jnp.minimum(around.heights, 0) + ends[0] - linear]
        if around.obstacles is not None:
            before = around.obstacles
            turn = rotation_by(twist[3:] * dt)
            end = obstacle_contacts(scene, Pose(placed.origin + dt * twist[:3], turn @ placed.rotation))
            velocities = twist[:3] + jnp.cross(twist[3:], before.points - placed.origin)
            travel = dt * jnp.sum(velocities * before.normals, -1)
            missed.append(jnp.minimum(before.gaps, 0) + jnp.minimum(end.gaps - before.gaps - travel, 0))
            ends.append(end.gaps - dt * jnp.sum(before.velocities * before.normals, -1))
        zeros = jnp.zeros(counts[0]), jnp.zeros(counts[2])
        return jnp.concatenate([zeros[0], missed[0], zeros[1], *missed[1:]]), jnp.min(jnp.concatenate(ends))

    old_twist = jnp.concatenate(old_motion)
    available = old_twist @ inertia @ old_twist / 2

    # The plain step and its corrections are one piece of compiled code.
    def attempt(state: _Attempt) -> _Attempt:
        is_first = state.attempts == 0
        share = jnp.asarray((0.0, *CORRECTIONS), state.shift.dtype)[state.attempts]
        velocity = rows.velocity - share * state.shift[:, None] / dt * rows.normals
        start = jnp.where(is_first, guess, state.result.twist)
        solved = solve_contacts(inertia, free_twist, rows._replace(velocity=velocity), dt, start)
        is_allowed = is_first | (energy(solved.twist) <= available)
        result = jax.tree.map(lambda new, old: jnp.where(is_allowed, new, old), solved, state.result)
        missed, deepest = missed_and_deepest(solved.twist)
        is_too_deep = ~has_hand & (deepest < -DEPTH)
        done = jnp.where(is_first, ~is_too_deep, is_allowed)
        return _Attempt(state.attempts + 1, jnp.where(is_first, missed, state.shift), result, done)

    nothing = ContactStep(jnp.zeros_like(guess), jnp.zeros_like(rows.points), jnp.zeros_like(rows.friction))
    first = _Attempt(jnp.zeros((), jnp.int32), jnp.zeros_like(rows.friction), nothing, jnp.asarray(False))
    return lax.while_loop(lambda state: (state.attempts <= len(CORRECTIONS)) & ~state.done, attempt, first).result


def _put_to_sleep(twist: Array, around: Surroundings, holds: Array) -> Array:
    """Return zero for an object that has come to rest."""
    speeds = jnp.linalg.norm(twist[:3] + jnp.cross(twist[3:], around.points), axis=-1)
    return jnp.where(~holds & (jnp.max(speeds) < ASLEEP), 0, twist)


def _remembered(
    dt: float | AnyArray,
    placed: Pose,
    memory: ContactMemory,
    followed: Motion,
    motion: Motion,
    around: Surroundings,
    holds: Array,
    rows: ContactRows,
    result: ContactStep,
    table: slice,
    obstacles: int,
) -> ContactMemory:
    """Return what the next step of an object in the hand continues from."""
    normals = rows.normals
    along = jnp.sum(result.forces * normals, -1)
    across = result.forces - along[:, None] * normals
    speeds = [jnp.linalg.norm(m.linear + jnp.cross(m.angular, around.points), axis=-1) for m in (followed, motion)]
    moves = jnp.max(jnp.stack(speeds)) > QUIET
    fading = memory.friction.share * jnp.exp(-dt / FORGETTING_TIME)
    share = jnp.where(moves, 1.0, jnp.where(fading > FORGOTTEN, fading, 0))
    friction = TableFriction(resultant(rows.points[table], across[table]), share)
    resistance = jnp.zeros(6)
    if around.obstacles is not None:
        contacts = around.obstacles
        point_velocity = motion.linear + jnp.cross(motion.angular, rows.points[obstacles:])
        approach = jnp.sum((point_velocity - contacts.velocities) * contacts.normals, -1)
        damping = jnp.where(along[obstacles:] > 0, -contacts.damping * approach, 0)
        damped = across[obstacles:] + damping[:, None] * contacts.normals
        resistance = resultant(rows.points[obstacles:], damped)
    drift = Motion(motion.linear - followed.linear, motion.angular - followed.angular)
    remembered = ContactMemory(drift, friction, resistance)
    return jax.tree.map(lambda new, none: jnp.where(holds, new, none), remembered, no_memory())
