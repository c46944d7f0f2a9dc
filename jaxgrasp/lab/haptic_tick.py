"""One tick of the haptic loop as one compiled program: where the object went since the last, and what is felt now.

A tick is short, and calling a program costs as much as it computes. So there is one call, all that stays the same from
tick to tick is flattened once, and nothing is looked at in between: what only a slipping object needs is a branch.
"""

from functools import cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jaxgrasp.grip.contact_forces import ContactForces
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.scene import Scene, at_time
from jaxgrasp.grip.simulation import SimulationState, integrate, step_and_motion, wrench_residual
from jaxgrasp.grip.tick import StepResult, Touches, find_touches
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.lab.flat_program import FlatProgram, Leaves
from jaxgrasp.lab.followed_grip import FollowedGrip, first_grip, grip_tables, next_grip
from jaxgrasp.lab.glove_hand import GloveHand, felt
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose


class HapticState(NamedTuple):
    """What a tick leaves to the next."""

    carried: SimulationState
    frames: HandFrames
    """The hand's frames, as the glove read it."""
    touches: Touches
    """What the hand touches in those frames, the object and all else where they now are."""
    inertial: Float[Array, "6"]
    """Wrench that accelerates the object, as it is felt [N, N.m]."""
    exerted: ContactForces
    """What is felt of the object."""
    grip: FollowedGrip | None
    """Where contributions follow the grip."""


class Passed(NamedTuple):
    """What became of the object between two ticks."""

    placed: Pose
    """Where it was."""
    tick: StepResult
    stands: Array
    exerted: ContactForces
    missed: Float[Array, "6"]


class HapticTick:
    """The program for one scene and one hand in a glove, compiled at its first call."""

    def __init__(self, scene: Scene, worn: GloveHand, law: Law, follows: bool = False):
        """``follows``: whether the links contribute what the grip asks for that the hand makes."""
        tables = grip_tables(scene.hand) if follows else None
        leaves, self._structure = jax.tree.flatten((scene, worn, tables))
        self._leaves = tuple(map(jnp.asarray, leaves))
        self._law = law

    def start(self, carried: SimulationState) -> HapticState:
        """Before the first tick, of which no earlier one is known: nothing touches yet."""
        scene, worn, tables = jax.tree.unflatten(self._structure, self._leaves)
        grip = None if tables is None else first_grip(scene.contributions)

        def at_first() -> tuple[HandFrames, Touches]:
            posture = worn.posture(jnp.zeros(len(worn.places)), carried.placed)
            return pose_hand(scene.hand, posture), find_touches(scene, posture, carried.placed)

        frames, touches = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(at_first))
        exerted = ContactForces(touches.contacts.points, touches.grasp.torsion)
        return HapticState(carried, frames, touches, jnp.zeros(6), exerted, grip)

    def begun(self, state: HapticState) -> Leaves:
        """The leaves of a state from which ticks go on."""
        leaves, self._state = jax.tree.flatten(state)
        self._program = _compiled(self._structure, self._state, self._law)
        self._placed = jax.tree.leaves(self.state(tuple(range(len(leaves)))).carried.placed)
        return tuple(map(jnp.asarray, leaves))

    def state(self, leaves: tuple[Any, ...]) -> HapticState:
        """A state, from its leaves."""
        return jax.tree.unflatten(self._state, leaves)

    def placed(self, leaves: Leaves) -> Pose:
        """Where the object is in a state, from its leaves."""
        origin, rotation = (leaves[place] for place in self._placed)
        return Pose(origin, rotation)

    def __call__(
        self, state: Leaves, angles: Float[Any, "channels"], wrist: Pose, passed: float, kept: float
    ) -> tuple[Leaves, Leaves, AnyArray, AnyArray]:
        """The leaves of the next state and of what became of the object; the torques that are felt, and their slope.

        Args:
            state: leaves of what the last tick left.
            angles: of the glove's joints [rad].
            wrist: where it is.
            passed: time since the last tick [s]; 0 for the first, at which the object stays where it is.
            kept: share of what was felt of accelerations that is kept.
        """
        wrist_at = wrist.origin, wrist.rotation
        after, become, (torques, slope) = self._program(self._leaves, state, angles, wrist_at, passed, kept)
        return after, become, torques, slope

    def become(self, leaves: Leaves) -> Passed:
        """What became of the object, from its leaves."""
        return self._program.tree(1, leaves)


@cache
def _compiled(structure: Any, state: Any, law: Law) -> FlatProgram:
    """The program for scenes and states of these structures."""
    return FlatProgram(partial(_tick, structure=structure, state_structure=state, law=law))


def _tick(
    leaves: tuple[Array, ...],
    before: Leaves,
    angles: Array,
    wrist: tuple[Array, Array],
    passed: Array,
    kept: Array,
    *,
    structure: Any,
    state_structure: Any,
    law: Law,
) -> tuple[HapticState, Passed, tuple[Array, Array]]:
    scene, worn, tables = jax.tree.unflatten(structure, leaves)
    state: HapticState = jax.tree.unflatten(state_structure, before)
    pose = Pose(*wrist)
    posture = worn.posture(angles, pose)
    frames = pose_hand(scene.hand, posture)
    first = passed <= 0
    become, carried, inertial = _since(scene, state, frames, jnp.where(first, 1.0, passed), kept, law)
    carried, inertial = jax.tree.map(
        lambda was, now: jnp.where(first, was, now), (state.carried, state.inertial), (carried, inertial)
    )
    grip = state.grip
    if grip is not None:
        grip = next_grip(grip, tables, scene.hand, posture, state.touches.contacts, passed)
        scene = eqx.tree_at(lambda s: s.contributions, scene, grip.contributions)
    scene = at_time(scene, carried.time)
    found, now = felt(scene, worn, angles, pose, carried.placed, inertial, carried.motion, law=law)
    touches = Touches(now.contacts, now.grasp, now.blocked)
    after = HapticState(carried, frames, touches, inertial, found.exerted, grip)
    return after, become, (found.torques, found.slope)


def _since(
    scene: Scene, state: HapticState, frames: HandFrames, passed: Array, kept: Array, law: Law
) -> tuple[Passed, SimulationState, Array]:
    """What became of the object since the last tick, where it is, and what accelerates it, as it is felt.

    By the optimum, where no allowed forces took the object along, the contacts exerted what was felt of them.
    """
    carried = state.carried
    now = at_time(scene, carried.time)
    tick, led = step_and_motion(now, passed, carried, state.touches, state.frames, frames, law)
    hold, exerted, missed = tick.assessment.hold, tick.by_hand, wrench_residual(tick)
    if law == "optimum":
        missed = jnp.where(tick.slips, tick.left_by(state.exerted), missed)
        exerted = state.exerted.where(tick.slips, exerted)
    become = Passed(carried.placed, tick, carried.stands, exerted, missed)
    inertial = jnp.where(hold == Hold.LOST, 0, kept * state.inertial + (1 - kept) * tick.inertial)
    return become, integrate(scene, passed, carried, led, missed, hold, tick.rests), inertial
