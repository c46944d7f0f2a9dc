"""The computing side of the haptic loop: angles to contacts, forces and torques, and where the object goes."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.tick_times import TickTimes
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.carry import Instant, advance, closest_forces, set_down
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.scene import Scene, check_scene
from jaxgrasp.lab.glove_hand import Felt, felt, felt_slipping, frames_of, glove_hand
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import HandFrames, Pose, Posture
from jaxgrasp.validation.checked import checked

LONGEST = 0.05
"""Time that a tick counts as at most [s], so that a pause does not throw the object."""


@dataclass
class Haptics:
    """A hand in a glove and an object, driven by ``tick``; a tick compiles at its first call, some 40 s."""

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
    instant: Instant | None = field(default=None, init=False)
    """Record of the last tick but one: contacts, forces, hold."""

    def __post_init__(self) -> None:
        check_scene(self.scene)
        self._worn = glove_hand(self.scene.hand, self.model, self.others)
        self._carried = set_down(self.scene, self.placed)
        self._before: tuple[float, Posture, HandFrames] | None = None
        self._inertial = np.zeros(6)

    def tick(self, now: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TorqueLaw:
        """What the glove is to do, from what it reads.

        Args:
            now: time [s].
            angles: of the glove's joints [rad].
            wrist: of the hand, in the world.

        Returns:
            A law that is valid if all its numbers are finite.
        """
        posture = self._worn.posture(angles, wrist)
        frames = frames_of(self.scene.hand, posture)
        if self._before is not None and now > self._before[0]:
            passed = min(now - self._before[0], LONGEST)
            self.instant, self._carried = advance(
                self.scene, passed, self._carried, self._before[1], self._before[2], frames, law=self.law
            )
            self.placed = self._carried.placed
            self._accelerate(self.instant, passed)
        self._before = now, posture, frames
        found = self._felt(angles, wrist)
        return law_of(now, angles, (found.torques, found.slope))

    def _accelerate(self, instant: Instant, passed: float) -> None:
        """What accelerates the object, as it is felt."""
        if instant.hold == Hold.LOST:
            self._inertial = np.zeros(6)
            return
        kept = np.exp(-passed / self.smoothing) if self.smoothing > 0 else 0.0
        self._inertial = kept * self._inertial + (1 - kept) * np.asarray(instant.tick.inertial)

    def _felt(self, angles: Float[np.ndarray, "channels"], wrist: Pose) -> Felt:
        asked = self.scene, self._worn, angles, wrist, self.placed, self._inertial
        found = felt(*asked, law=self.law)
        if self.law == "optimum" and bool(found.slips):
            return felt_slipping(*asked)
        return found


def law_of(now: float, angles: Float[np.ndarray, "channels"], found: tuple[Array, Array]) -> TorqueLaw:
    """Torques and their derivative, computed for a time and angles, as a law: valid if all its numbers are finite."""
    torques, slope = (np.asarray(part, np.float64) for part in jax.device_get(found))
    valid = bool(np.all(np.isfinite(torques)) and np.all(np.isfinite(slope)))
    return TorqueLaw(now, valid, np.asarray(angles, float), torques, slope)


def warm_up(haptics: Haptics, wrist: Pose) -> None:
    """Compile what ticks need, before anything is armed; the object stays where it is."""
    spare = Haptics(haptics.scene, haptics.model, haptics.others, haptics.placed, haptics.law, haptics.smoothing)
    angles = np.asarray(haptics.others, float)[list(spare._worn.places)]
    for k in range(2):
        spare.tick(0.01 * k, angles, wrist)
    if spare.law == "optimum":
        # What only an object needs that slips: twice, for where it goes and for what is felt.
        felt_slipping(spare.scene, spare._worn, angles, wrist, spare.placed, np.zeros(6))
        assert spare.instant is not None
        closest_forces(spare.scene, spare.instant.tick.grasp, spare.instant.tick.wrench, spare.placed)


@checked
def run_loop(
    tick: Callable[[float, Float[np.ndarray, "channels"], Pose], TorqueLaw],
    state: Callable[[], GloveState | None],
    write: Callable[[TorqueLaw], None],
    wrist: Callable[[float], Pose | None],
    rate: float,
    goes_on: Callable[[float], bool],
) -> TickTimes:
    """Tick at a steady rate for as long as it goes on; how punctual it was.

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
    """A pose of arrays, which compiles like all others."""
    return Pose(jnp.asarray(origin, float), jnp.eye(3) if rotation is None else jnp.asarray(rotation))
