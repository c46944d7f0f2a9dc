"""The computing side of the haptic loop: angles to contacts, forces and torques, and where the object goes."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.tick_times import TickTimes
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.scene import Scene, check_scene
from jaxgrasp.grip.simulation import Record, initial_state
from jaxgrasp.hand.grip_type import GripType
from jaxgrasp.lab.flat_program import Leaves
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand
from jaxgrasp.lab.haptic_tick import HapticState, HapticTick
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Pose
from jaxgrasp.numerics.rotation import is_rotation
from jaxgrasp.validation.checked import checked

LONGEST = 0.05
"""Time that a tick counts as at most [s], so that a pause does not throw the object."""
OFF_ROTATION = 1e-3
"""By how much a wrist's axes may miss being square and of length one."""
MOST_BENT = np.pi
"""No joint of a hand is bent so far [rad]: what reads more is no angle."""
FARTHEST = 100.0
"""No wrist is so far from the world's origin [m]."""
SHORTEST = 2e-4
"""Time between two ticks below which the later one only looks: where the object is stays as the earlier left it [s]."""


class Followed(NamedTuple):
    """What a picture of the N objects needs to know, beside the hand."""

    placed: Pose
    """``(N,)``"""
    wrenches: Float[np.ndarray, "N 6"]
    """What accelerates the object; of several, what the hand exerts on each [N, N.m]."""
    contributions: Float[np.ndarray, "L"]
    """Contributions of the links, as they count."""
    time: float = 0.0
    """Since the scene began [s]."""
    grip: GripType | None = None
    """The grip whose contributions count; None where they do not follow it."""


class TickAnswer(NamedTuple):
    """What one tick found."""

    torques: AnyArray
    """By which the glove is to resist flexion ``(channels,)`` [N.m]."""
    slope: AnyArray
    """Their derivative by the flexions [N.m/rad]."""
    keep: Callable[[], None]
    """Lets the next tick go on from this one."""


class HandHaptics(ABC):
    """A hand in a glove, and what it feels, driven by ``tick``."""

    others: Float[AnyArray, "J"]
    """Angles of all joints [rad]; those that the glove does not read stay there."""
    smoothing: float
    """Time constant of the accelerations that are felt [s]."""
    _before: float | None = None

    @property
    @abstractmethod
    def worn(self) -> GloveHand:
        """The hand in its glove."""

    @property
    @abstractmethod
    def followed(self) -> Followed:
        """Where everything is."""

    @abstractmethod
    def felt_after(self, passed: float, kept: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TickAnswer:
        """What is felt so long after the tick before [s], 0 for the first; ``kept`` is the share of what was felt of
        accelerations that is kept."""

    def tick(self, now: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TorqueLaw:
        """What the glove is to do, from what it reads.

        Args:
            now: time [s].
            angles: of the glove's joints [rad].
            wrist: of the hand, in the world.

        Returns:
            A law that is valid if all its numbers are finite, and time, angles and wrist are such as a hand has. After
            one that is not, the next goes on from before it.
        """
        if not (np.isfinite(now) and _is_a_hands(angles, wrist)):
            return refused_law(now, angles)
        passed = 0.0 if self._before is None else min(now - self._before, LONGEST)
        # What has hardly passed, or not at all, says nothing of how fast anything moves.
        passed = passed if passed >= SHORTEST else 0.0
        kept = float(np.exp(-passed / self.smoothing)) if self.smoothing > 0 else 0.0
        found = self.felt_after(passed, kept, np.asarray(angles, float), wrist)
        law = law_of(now, angles, (found.torques, found.slope))
        if law.is_valid and (passed > 0 or self._before is None):
            found.keep()
            self._before = now
        return law

    def warm_up(self, wrist: Pose) -> None:
        """Compile what ticks need, before anything is armed; the objects stay where they are."""
        spare = copy(self)
        angles = np.asarray(self.others, float)[list(self.worn.places)]
        for k in range(2):
            spare.tick(0.01 * k, angles, wrist)


@dataclass
class Haptics(HandHaptics):
    """A hand in a glove and an object, driven by ``tick``; a tick compiles at its first call, some 30 s."""

    scene: Scene
    model: GloveModel
    others: Float[AnyArray, "J"]
    """Angles of all joints [rad]; those that the glove does not read stay there."""
    placed: Pose
    """Where the object stands at first."""
    law: Law = "closed-form"
    """Which forces the hand applies: what is felt, and what the object does."""
    smoothing: float = 0.02
    """Time constant of the accelerations that are felt [s]: between two ticks they are differences of what the glove
    reads, whose last digits are noise. 0 for as they are."""
    follows: bool = False
    """Whether the links contribute what the grip asks for that the hand makes, which is recognised as it goes; else the
    scene's own contributions count throughout."""

    def __post_init__(self) -> None:
        check_scene(self.scene)
        self._worn = glove_hand(self.scene.hand, self.model, self.others)
        self._program = HapticTick(self.scene, self._worn, self.law, self.follows)
        self._begin = self._program.start(initial_state(self.scene, self.placed))
        self._leaves = self._program.begun(self._begin)
        self._passed: Leaves | None = None

    def restart(self, scene: Scene, placed: Pose) -> None:
        """Another scene of the same kind, its object at rest there; nothing is compiled for other numbers."""
        self.scene, self.placed = scene, placed
        self._program = HapticTick(scene, self._worn, self.law, self.follows)
        self._leaves = self._program.begun(self._begin._replace(carried=initial_state(scene, placed)))
        self._passed, self._before = None, None

    @property
    def _state(self) -> HapticState:
        return self._program.state(self._leaves)

    @property
    def inertial(self) -> Array:
        """Wrench that accelerates the object, as it is felt ``(6,)`` [N, N.m]."""
        return self._state.inertial

    @property
    def worn(self) -> GloveHand:
        return self._worn

    @property
    def followed(self) -> Followed:
        state = self._state
        contributions = self.scene.contributions if state.grip is None else state.grip.contributions
        wanted = (self.placed, state.inertial, contributions, state.carried.time)
        placed, inertial, contributions, time = jax.device_get(wanted)
        there = Pose(np.asarray(placed.origin)[None], np.asarray(placed.rotation)[None])
        return Followed(there, inertial[None], np.asarray(contributions), float(time), self.grip)

    @property
    def instant(self) -> Record | None:
        """Record of the last tick but one: contacts, forces, hold."""
        if self._passed is None:
            return None
        placed, tick, stands, exerted, missed = self._program.become(self._passed)
        hold = Hold(int(tick.assessment.hold))
        return Record(placed, tick, hold, bool(stands), exerted.forces, missed, exerted.moments)

    @property
    def grip(self) -> GripType | None:
        """The grip whose contributions count; None where they do not follow it."""
        grip = self._state.grip
        return None if grip is None else GripType(int(grip.kind))

    def felt_after(self, passed: float, kept: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TickAnswer:
        leaves, become, torques, slope = self._program(self._leaves, angles, wrist, passed, kept)

        def keep() -> None:
            self._passed = become if passed > 0 else None
            self._leaves, self.placed = leaves, self._program.placed(leaves)

        return TickAnswer(torques, slope, keep)


def _is_a_hands(angles: Float[np.ndarray, "channels"], wrist: Pose) -> bool:
    """Whether a hand can be there: what cannot be must not move the object, finite or not."""
    # A comparison with NaN is false.
    bent, far = np.max(np.abs(angles), initial=0), np.max(np.abs(np.asarray(wrist.origin)))
    return bool(bent <= MOST_BENT and far <= FARTHEST and is_rotation(np.asarray(wrist.rotation), OFF_ROTATION))


def law_of(now: float, angles: Float[np.ndarray, "channels"], found: tuple[AnyArray, AnyArray]) -> TorqueLaw:
    """Torques and their derivative, computed for a time and angles, as a law: valid if all its numbers are finite."""
    torques, slope = (np.asarray(part, np.float64) for part in jax.device_get(found))
    valid = bool(np.all(np.isfinite(torques)) and np.all(np.isfinite(slope)))
    return TorqueLaw(now, valid, np.asarray(angles, float), torques, slope)


def refused_law(now: float, angles: Float[np.ndarray, "channels"]) -> TorqueLaw:
    """A law that nobody may follow."""
    channels = len(angles)
    return TorqueLaw(now, False, np.asarray(angles, float), np.zeros(channels), np.zeros((channels, channels)))


@checked
def run_loop(
    tick: Callable[[float, Float[np.ndarray, "channels"], Pose], TorqueLaw],
    state: Callable[[], GloveState | None],
    write: Callable[[TorqueLaw], None],
    wrist: Callable[[float], Pose | None],
    rate: float,
    goes_on: Callable[[float], bool],
) -> TickTimes:
    """StepResult at a steady rate for as long as it goes on; how punctual it was.

    Args:
        tick: the law at a time, angles and the wrist's pose, such as a warmed-up ``Haptics.tick``.
        state: what the glove does.
        write: takes the law to follow.
        wrist: the hand's pose at a time [s]; None while nobody knows it, so that no law is written.
        rate: of the ticks [Hz].
        goes_on: called after each tick with the time; False ends it.
    """
    times = TickTimes(1.0 / rate)
    due = time.perf_counter()
    while True:
        begun = time.perf_counter()
        read = state()
        pose = wrist(begun)
        if read is not None and pose is not None and np.all(np.isfinite(read.angles)):
            write(tick(begun, read.angles, pose))
        over = time.perf_counter()
        times.add(begun - due, over - begun)
        if not goes_on(over):
            return times
        due = max(due + times.period, over)
        time.sleep(max(0.0, due - time.perf_counter()))


def pose_at(origin: Float[AnyArray, "3"], rotation: Float[AnyArray, "3 3"] | None = None) -> Pose:
    """A pose in NumPy: what is small costs JAX more to make than to compute with."""
    return Pose(np.asarray(origin, float), np.eye(3) if rotation is None else np.asarray(rotation, float))
