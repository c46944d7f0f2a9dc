"""One tick of the haptic loop as one compiled program: motion of the object since the last tick, and the torques.

A tick is short, and calling a program costs as much as its computation. So there is one call, all constants of a scene
are flattened once, and no value is read in between: the extra work for a slipping object is a branch.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from jaxgrasp.grip.contact_forces import ContactForces
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.scene import Scene, at_time
from jaxgrasp.grip.simulation import (
    ObjectStep,
    SimulationState,
    approach_step,
    finish_step,
    integrate,
    wrench_residual,
)
from jaxgrasp.grip.tick import StepResult, Touches, find_touches
from jaxgrasp.hand.detection import Contacts
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.hand.to_grasp import GripType, contributions_of, grip_type
from jaxgrasp.lab.glove_hand import FeltInstant, GloveHand, TouchingHand, felt_instant, resistance_of
from jaxgrasp.model.arrays import AnyArray, Float, Int
from jaxgrasp.model.hand import Hand, HandFrames, Pose, Posture
from jaxgrasp.numerics.compiled_code import COMPILED_FOR_TICKS, jit_here

SETTLING_TIME = 0.15
"""Time after which another grip applies [s]."""
BLENDING_TIME = 0.1
"""Time constant of the change of contributions to those of another grip [s]."""

Leaves = tuple[AnyArray, ...]


class FlatProgram:
    """A compiled function of arrays, and of tuples of them, that returns several trees as tuples of their leaves.

    Taking trees of modules apart and building them would cost as much as a tick computes: a tree is built only on
    request.
    """

    def __init__(self, function: Callable[..., tuple[Any, ...]]):
        """Wrap the function, which is compiled at its first call."""
        self._structures: tuple[Any, ...] = ()

        def flat(*args: Any) -> tuple[Leaves, ...]:
            parts = [jax.tree.flatten(part) for part in function(*args)]
            self._structures = tuple(structure for _, structure in parts)
            return tuple(tuple(leaves) for leaves, _ in parts)

        self._program = jit_here(flat, COMPILED_FOR_TICKS)

    def __call__(self, *args: Any) -> tuple[Leaves, ...]:
        """Return the leaves of each tree."""
        return self._program(*args)

    def tree(self, part: int, leaves: Leaves) -> Any:
        """Build a tree of the result from its leaves."""
        return jax.tree.unflatten(self._structures[part], leaves)


class FollowedGrip(NamedTuple):
    """Grip whose contributions apply, with the contributions of the links (section II-E).

    A new grip applies only after ``STEADY``, since a fingertip that comes and goes is no new grip; then the
    contributions change over ``BLEND``, so that torques do not jump.
    """

    kind: Int[Array, ""]
    """Code of the grip whose contributions apply."""
    latest: Int[Array, ""]
    """Type of the last detected grip."""
    since: Float[Array, ""]
    """Time since this type was first detected [s]."""
    contributions: Float[Array, "L"]


def grip_tables(hand: Hand) -> Float[np.ndarray, "kinds L"]:
    """Return the contributions of the links to each type of grip, by its code."""
    return np.stack([contributions_of(hand, kind) for kind in GripType])


def first_grip(contributions: Float[Array, "L"]) -> FollowedGrip:
    """Return the start: the scene's own contributions, until a grip is recognised."""
    no_grip = jnp.asarray(GripType.NONE, jnp.int32)
    return FollowedGrip(no_grip, no_grip, jnp.zeros(()), jnp.asarray(contributions))


def next_grip(
    before: FollowedGrip, tables: Array, hand: Hand, posture: Posture, contacts: Contacts, dt: Array
) -> FollowedGrip:
    """Update the grip after ``dt`` seconds by the current contacts; without any contact, or a recognised grip, it is
    unchanged."""
    current = grip_type(hand, posture, contacts)
    is_known = current > GripType.UNKNOWN
    since = jnp.where(current == before.latest, before.since + dt, 0.0)
    kind = jnp.where(is_known & (since >= SETTLING_TIME), current, before.kind)
    target = jnp.where(kind > GripType.UNKNOWN, tables[kind], before.contributions)
    share = 1 - jnp.exp(-dt / BLENDING_TIME)
    return FollowedGrip(kind, current, since, before.contributions + share * (target - before.contributions))


class HapticState(NamedTuple):
    """State carried from one tick to the next."""

    carried: SimulationState
    frames: HandFrames
    """Frames of the hand, as the glove read it."""
    touches: Touches
    """Contacts of the hand in those frames, with object and obstacles at their current poses."""
    inertial: Float[Array, "6"]
    """Wrench that accelerates the object, low-pass filtered [N, N.m]."""
    exerted: ContactForces
    """Rendered forces of the contacts."""
    grip: FollowedGrip | None
    """Followed grip; None with constant contributions."""


class TickOutcome(NamedTuple):
    """Pose, contact state and applied forces of the object after one tick."""

    placed: Pose
    """Pose at the start of the tick."""
    tick: StepResult
    stands: Array
    exerted: ContactForces
    wrench_residual: Float[Array, "6"]


class HapticTick:
    """Program for a scene and a hand in a glove, compiled at its first call."""

    def __init__(self, scene: Scene, glove: GloveHand, law: Law, follows: bool = False):
        """Flatten the constants; ``follows`` lets the contributions follow the grip that the hand makes."""
        tables = grip_tables(scene.hand) if follows else None
        leaves, self._structure = jax.tree.flatten((scene, glove, tables))
        self._leaves = tuple(map(jnp.asarray, leaves))
        self._law = law

    def start(self, carried: SimulationState) -> HapticState:
        """Return the state before the first tick, without contacts."""
        scene, glove, tables = jax.tree.unflatten(self._structure, self._leaves)
        grip = None if tables is None else first_grip(scene.contributions)

        def initial_frames_and_touches() -> tuple[HandFrames, Touches]:
            posture = glove.posture(jnp.zeros(len(glove.joint_indices)), carried.placed)
            return pose_hand(scene.hand, posture), find_touches(scene, posture, carried.placed)

        frames, touches = jax.tree.map(
            lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(initial_frames_and_touches)
        )
        exerted = ContactForces(touches.contacts.points, touches.grasp.torsion)
        return HapticState(carried, frames, touches, jnp.zeros(6), exerted, grip)

    def initial_leaves(self, state: HapticState) -> Leaves:
        """Flatten a state into the leaves that the compiled tick expects."""
        leaves, self._state = jax.tree.flatten(state)
        self._program = _compiled(self._structure, self._state, self._law)
        self._placed = jax.tree.leaves(self.state(tuple(range(len(leaves)))).carried.placed)
        return tuple(map(jnp.asarray, leaves))

    def state(self, leaves: tuple[Any, ...]) -> HapticState:
        """Build a state from its leaves."""
        return jax.tree.unflatten(self._state, leaves)

    def placed(self, leaves: Leaves) -> Pose:
        """Return the pose of the object from the leaves of a state."""
        origin, rotation = (leaves[index] for index in self._placed)
        return Pose(origin, rotation)

    def __call__(
        self, state: Leaves, angles: Float[Any, "channels"], wrist: Pose, dt: float, smoothing: float
    ) -> tuple[Leaves, Leaves, AnyArray, AnyArray]:
        """Run a tick; return the leaves of the next state and of the outcome, the torques, and their slope.

        Args:
            state: leaves of the state after the last tick.
            angles: angles of the glove's joints [rad].
            wrist: pose of the wrist.
            dt: time since the last tick [s]; 0 for the first, at which the object stays at its pose.
            smoothing: weight of the previous acceleration in the low-pass filter, 0 to 1.
        """
        wrist_at = wrist.origin, wrist.rotation
        after, outcome, (torques, slope) = self._program(self._leaves, state, angles, wrist_at, dt, smoothing)
        return after, outcome, torques, slope

    def outcome(self, leaves: Leaves) -> TickOutcome:
        """Build the outcome from its leaves."""
        return self._program.tree(1, leaves)


@cache
def _compiled(structure: Any, state: Any, law: Law) -> FlatProgram:
    """Return the program for scenes and states of these structures."""
    return FlatProgram(partial(_tick, structure=structure, state_structure=state, law=law))


def _tick(
    leaves: tuple[Array, ...],
    before: Leaves,
    angles: Array,
    wrist: tuple[Array, Array],
    dt: Array,
    smoothing: Array,
    *,
    structure: Any,
    state_structure: Any,
    law: Law,
) -> tuple[HapticState, TickOutcome, tuple[Array, Array]]:
    scene, glove, tables = jax.tree.unflatten(structure, leaves)
    state: HapticState = jax.tree.unflatten(state_structure, before)
    pose = Pose(*wrist)
    posture = glove.posture(angles, pose)
    frames = pose_hand(scene.hand, posture)
    is_first = dt <= 0
    step_s = jnp.where(is_first, 1.0, dt)
    scene_before, current = at_time(scene, state.carried.time), state.frames
    approach = approach_step(scene_before, step_s, state.carried, state.touches, current, frames)
    before_step = FeltInstant(
        scene_before, current, state.carried.placed, state.touches, approach.inertial, approach.memory
    )

    def after_step(tick: StepResult) -> tuple[FeltInstant, _AfterStep]:
        """Move the object by the forces of the step that is over, and find the contacts of the new posture."""
        step = finish_step(scene_before, step_s, state.carried, approach, tick, current, frames)
        outcome, carried, inertial = _advance_object(scene_before, state, step, step_s, smoothing, law)
        carried, inertial = jax.tree.map(
            lambda old, new: jnp.where(is_first, old, new), (state.carried, state.inertial), (carried, inertial)
        )
        grip, felt_scene = state.grip, scene
        if grip is not None:
            grip = next_grip(grip, tables, scene.hand, posture, state.touches.contacts, dt)
            felt_scene = eqx.tree_at(lambda s: s.contributions, scene, grip.contributions)
        felt_scene = at_time(felt_scene, carried.time)
        instant, touching = felt_instant(felt_scene, glove, angles, pose, carried.placed, inertial, carried.memory)
        return instant, _AfterStep(outcome, carried, grip, touching)

    # The forces of the step and of the new posture are computed by one piece of code, which runs twice: it is most of
    # what is compiled.
    def of_instant(k: Array, loop: tuple[FeltInstant, _AfterStep, Any]) -> tuple[FeltInstant, _AfterStep, Any]:
        instant, after, _ = loop
        tick, solutions = instant.assess(law)
        instant, after = lax.cond(k == 0, after_step, lambda _: (instant, after), tick)
        return instant, after, (tick, solutions)

    def first_results() -> tuple[_AfterStep, Any]:
        forces = before_step.assess(law)
        return after_step(forces[0])[1], forces

    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(first_results))
    instant, after, (tick, solutions) = lax.fori_loop(0, 2, of_instant, (before_step, *nothing))
    felt = resistance_of(glove, instant, after.touching, tick, solutions, law)
    touches = Touches(tick.contacts, tick.grasp, tick.blocked)
    next_state = HapticState(after.carried, frames, touches, instant.inertial, felt.exerted, after.grip)
    return next_state, after.outcome, (felt.torques, felt.slope)


class _AfterStep(NamedTuple):
    """Results of the step that is over, and the hand in its new posture."""

    outcome: TickOutcome
    carried: SimulationState
    grip: FollowedGrip | None
    touching: TouchingHand


def _advance_object(
    scene: Scene, state: HapticState, step: ObjectStep, dt: Array, smoothing: Array, law: Law
) -> tuple[TickOutcome, SimulationState, Array]:
    """Compute the outcome since the last tick, the object's next state, and its filtered inertial wrench.

    By the optimum, where no allowed forces moved the object along, the contacts exert the forces that were rendered.
    """
    tick = step.tick
    hold, exerted, residual = tick.assessment.hold, tick.by_hand, wrench_residual(tick)
    if law == "optimum":
        slips = tick.slips & ~step.is_near
        residual = jnp.where(slips, tick.left_by(state.exerted), residual)
        exerted = state.exerted.where(slips, exerted)
    outcome = TickOutcome(state.carried.placed, tick, state.carried.stands, exerted, residual)
    # w <- a w + (1 - a) w_new
    inertial = jnp.where(hold == Hold.LOST, 0, smoothing * state.inertial + (1 - smoothing) * tick.inertial)
    return outcome, integrate(scene, dt, state.carried, step, residual), inertial
