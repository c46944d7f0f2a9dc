"""Computing side of the haptic loop: from angles to contacts, forces and torques, and the motion of the object."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from jaxgrasp.glove.loop.exchange import GloveState, TorqueLaw
from jaxgrasp.glove.loop.rendering import TickTimes, run_at_rate
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.grip.monitor import Hold, Law
from jaxgrasp.grip.scene import Scene, check_scene
from jaxgrasp.grip.simulation import Record, initial_state
from jaxgrasp.hand.to_grasp import GripType
from jaxgrasp.lab.glove_hand import GloveHand, glove_hand
from jaxgrasp.lab.haptic_tick import HapticState, HapticTick, Leaves
from jaxgrasp.model.arrays import AnyArray, Float
from jaxgrasp.model.hand import Link, Pose
from jaxgrasp.numerics.geometry import is_rotation
from jaxgrasp.validation.checked import checked

MAX_DT = 0.05
"""Largest time step of a tick [s], so that a pause does not throw the object."""
OFF_ROTATION = 1e-3
"""Largest error of a wrist's axes from a rotation matrix."""
MAX_ANGLE = np.pi
"""Angle that no joint of a hand reaches [rad]: a larger reading is invalid."""
MAX_DISTANCE = 100.0
"""Distance from the world's origin that no wrist reaches [m]."""
MIN_DT = 2e-4
"""Time between two ticks below which the later one only renders: the object stays at the pose of the earlier one [s].
"""

LIFT, LIFT_STEPS = 0.02, 40
"""Height by which an object is lifted to measure its stiffness in the hand [m], and steps until there."""


class Followed(NamedTuple):
    """State of the N objects that a picture shows, beside the hand."""

    placed: Pose
    """``(N,)``"""
    wrenches: Float[np.ndarray, "N 6"]
    """Wrench that accelerates the object; for several objects, the wrench of the hand on each [N, N.m]."""
    contributions: Float[np.ndarray, "L"]
    """Contributions of the links that apply."""
    time: float = 0.0
    """Time since the start of the scene [s]."""
    grip: GripType | None = None
    """Grip whose contributions apply; None for constant contributions."""


class TickAnswer(NamedTuple):
    """Result of a tick."""

    torques: AnyArray
    """Torques of the glove against flexion ``(channels,)`` [N.m]."""
    slope: AnyArray
    """Their derivative by the flexions [N.m/rad]."""
    commit: Callable[[], None]
    """Function that commits the tick, so that the next one continues from it."""


class HandHaptics(ABC):
    """A hand in a glove with its torques, driven by ``tick``."""

    model: GloveModel
    fixed_angles: Float[AnyArray, "J"]
    """Angles of all joints [rad]; joints that the glove does not read keep them."""
    smoothing: float
    """Time constant of the filter of accelerations [s]."""
    _last_timestamp: float | None = None

    @property
    @abstractmethod
    def glove(self) -> GloveHand:
        """Return the hand in its glove."""

    @property
    @abstractmethod
    def followed(self) -> Followed:
        """Return the current state of all objects."""

    @property
    @abstractmethod
    def links(self) -> tuple[Link, ...]:
        """Return the L links of the hand."""

    @abstractmethod
    def contact_forces(self) -> tuple[Float[np.ndarray, "C 3"], Float[np.ndarray, "C 3"]]:
        """Return the forces on the objects [N] and the normals into them at the last tick, of L links for each object;
        no forces before the first."""

    @abstractmethod
    def compute_torques(
        self, dt: float, smoothing: float, angles: Float[np.ndarray, "channels"], wrist: Pose
    ) -> TickAnswer:
        """Compute the torques ``dt`` seconds after the last tick, 0 for the first; ``smoothing`` is the weight of the
        previous acceleration in the low-pass filter, 0 to 1."""

    def tick(self, timestamp: float, angles: Float[np.ndarray, "channels"], wrist: Pose) -> TorqueLaw:
        """Compute the law of torques for the glove's readings.

        Args:
            timestamp: time [s].
            angles: angles of the glove's joints [rad].
            wrist: pose of the wrist in the world.

        Returns:
            A law, valid if all its numbers are finite, and time, angles and wrist possible for a hand. After an invalid
            law the next tick continues from the state before it.
        """
        if not (np.isfinite(timestamp) and _is_possible(angles, wrist)):
            return invalid_law(timestamp, angles)
        dt = 0.0 if self._last_timestamp is None else min(timestamp - self._last_timestamp, MAX_DT)
        # A time step of nearly zero gives no velocities.
        dt = dt if dt >= MIN_DT else 0.0
        # a = exp(-dt / T)
        weight = float(np.exp(-dt / self.smoothing)) if self.smoothing > 0 else 0.0
        answer = self.compute_torques(dt, weight, np.asarray(angles, float), wrist)
        law = torque_law(timestamp, angles, (answer.torques, answer.slope))
        if law.is_valid and (dt > 0 or self._last_timestamp is None):
            answer.commit()
            self._last_timestamp = timestamp
        return law

    @property
    def _fixed_flexions(self) -> Float[np.ndarray, "channels"]:
        """Return the fixed angles of the glove's joints [rad]."""
        return np.asarray(self.fixed_angles, float)[list(self.glove.joint_indices)]

    def warm_up(self, wrist: Pose) -> None:
        """Compile the programs of ticks, before the glove is armed; the objects stay at their poses."""
        spare = copy(self)
        for k in range(2):
            spare.tick(0.01 * k, self._fixed_flexions, wrist)


@dataclass
class Haptics(HandHaptics):
    """A hand in a glove and an object, driven by ``tick``; the first tick compiles for 10 to 25 s."""

    scene: Scene
    model: GloveModel
    fixed_angles: Float[AnyArray, "J"]
    """Angles of all joints [rad]; joints that the glove does not read keep them."""
    placed: Pose
    """Pose of the object, at the start and then at the last tick."""
    law: Law = "closed-form"
    """Force law of the hand, for the torques and for the motion of the object."""
    smoothing: float = 0.02
    """Time constant of the filter of accelerations [s]: between two ticks they are differences of the glove's readings,
    whose last digits are noise. 0 for no filter."""
    follows: bool = False
    """True if the contributions of the links follow the grip that the hand makes; False for the scene's own
    contributions throughout."""

    def __post_init__(self) -> None:
        check_scene(self.scene)
        self._glove = glove_hand(self.scene.hand, self.model, self.fixed_angles)
        self._program = HapticTick(self.scene, self._glove, self.law, self.follows)
        self._initial_state = self._program.start(initial_state(self.scene, self.placed))
        self._leaves = self._program.initial_leaves(self._initial_state)
        self._outcome: Leaves | None = None

    def restart(self, scene: Scene, placed: Pose) -> None:
        """Replace the scene by another of the same structure, with its object at rest at ``placed``; other numbers
        compile no program."""
        self.scene, self.placed = scene, placed
        self._program = HapticTick(scene, self._glove, self.law, self.follows)
        self._leaves = self._program.initial_leaves(self._initial_state._replace(carried=initial_state(scene, placed)))
        self._outcome, self._last_timestamp = None, None

    @property
    def _state(self) -> HapticState:
        return self._program.state(self._leaves)

    @property
    def inertial(self) -> Array:
        """Return the filtered wrench that accelerates the object ``(6,)`` [N, N.m]."""
        return self._state.inertial

    @property
    def glove(self) -> GloveHand:
        return self._glove

    @property
    def followed(self) -> Followed:
        state = self._state
        contributions = self.scene.contributions if state.grip is None else state.grip.contributions
        arrays = (self.placed, state.inertial, contributions, state.carried.time)
        placed, inertial, contributions, time = jax.device_get(arrays)
        pose = Pose(np.asarray(placed.origin)[None], np.asarray(placed.rotation)[None])
        return Followed(pose, inertial[None], np.asarray(contributions), float(time), self.grip)

    @property
    def links(self) -> tuple[Link, ...]:
        return self.scene.hand.links

    def contact_forces(self) -> tuple[Float[np.ndarray, "C 3"], Float[np.ndarray, "C 3"]]:
        state = self._state
        forces, normals = jax.device_get((state.exerted.forces, state.touches.contacts.normals))
        if self._last_timestamp is None:
            return np.zeros_like(forces), normals
        return np.asarray(forces, float), np.asarray(normals, float)

    def lifted_stiffness(self) -> float:
        """Compute the largest stiffness that the glove feels at the fixed angles, once the hand has lifted the object
        [N.m/rad]: the largest eigenvalue of the torques' slope. The object of these haptics stays at its pose."""
        spare = copy(self)
        for k in range(LIFT_STEPS + 1):
            law = spare.tick(0.01 * k, self._fixed_flexions, pose_at(np.array([0, 0, LIFT * k / LIFT_STEPS])))
        return float(np.linalg.eigvals(law.derivative).real.max())

    @property
    def instant(self) -> Record | None:
        """Return the record of the tick before the last: contacts, forces, hold."""
        if self._outcome is None:
            return None
        placed, tick, stands, exerted, residual = self._program.outcome(self._outcome)
        hold = Hold(int(tick.assessment.hold))
        return Record(placed, tick, hold, bool(stands), exerted.forces, residual, exerted.moments)

    @property
    def grip(self) -> GripType | None:
        """Return the grip whose contributions apply; None for constant contributions."""
        grip = self._state.grip
        return None if grip is None else GripType(int(grip.kind))

    def compute_torques(
        self, dt: float, smoothing: float, angles: Float[np.ndarray, "channels"], wrist: Pose
    ) -> TickAnswer:
        leaves, outcome, torques, slope = self._program(self._leaves, angles, wrist, dt, smoothing)

        def commit() -> None:
            self._outcome = outcome if dt > 0 else None
            self._leaves, self.placed = leaves, self._program.placed(leaves)

        return TickAnswer(torques, slope, commit)


def _is_possible(angles: Float[np.ndarray, "channels"], wrist: Pose) -> bool:
    """Return whether a hand can have these angles and this wrist: impossible readings must not move the object, finite
    or not."""
    # Comparisons with NaN are false.
    largest_angle, distance = np.max(np.abs(angles), initial=0), np.max(np.abs(np.asarray(wrist.origin)))
    return bool(
        largest_angle <= MAX_ANGLE
        and distance <= MAX_DISTANCE
        and is_rotation(np.asarray(wrist.rotation), OFF_ROTATION)
    )


def torque_law(
    timestamp: float, angles: Float[np.ndarray, "channels"], torques_and_slope: tuple[AnyArray, AnyArray]
) -> TorqueLaw:
    """Build the law from torques and their derivative at a time and angles: valid if all its numbers are finite."""
    torques, slope = (np.asarray(part, np.float64) for part in jax.device_get(torques_and_slope))
    valid = bool(np.all(np.isfinite(torques)) and np.all(np.isfinite(slope)))
    return TorqueLaw(timestamp, valid, np.asarray(angles, float), torques, slope)


def invalid_law(timestamp: float, angles: Float[np.ndarray, "channels"]) -> TorqueLaw:
    """Return a law that is marked as invalid."""
    channels = len(angles)
    return TorqueLaw(timestamp, False, np.asarray(angles, float), np.zeros(channels), np.zeros((channels, channels)))


@checked
def run_loop(
    tick: Callable[[float, Float[np.ndarray, "channels"], Pose], TorqueLaw],
    state: Callable[[], GloveState | None],
    write: Callable[[TorqueLaw], None],
    wrist: Callable[[float], Pose | None],
    rate: float,
    goes_on: Callable[[float], bool],
) -> TickTimes:
    """Tick at a constant rate until ``goes_on`` returns False; return the times of the ticks.

    Args:
        tick: law at a time, angles and the wrist's pose, such as a warmed-up ``Haptics.tick``.
        state: current state of the glove.
        write: receiver of the law.
        wrist: pose of the wrist at a time [s]; None while it is unknown, so that no law is written.
        rate: rate of the ticks [Hz].
        goes_on: function called after each tick with the time; False ends the loop.
    """

    def step(timestamp: float) -> None:
        glove_state = state()
        pose = wrist(timestamp)
        if glove_state is not None and pose is not None and np.all(np.isfinite(glove_state.angles)):
            write(tick(timestamp, glove_state.angles, pose))

    return run_at_rate(step, rate, goes_on)


def pose_at(origin: Float[AnyArray, "3"], rotation: Float[AnyArray, "3 3"] | None = None) -> Pose:
    """Build a pose in NumPy: for small arrays JAX takes longer to create them than to compute with them."""
    return Pose(np.asarray(origin, float), np.eye(3) if rotation is None else np.asarray(rotation, float))
