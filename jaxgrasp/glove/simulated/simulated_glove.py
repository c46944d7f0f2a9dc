"""Simulated glove on a simulated hand: a device of the native protocol, its cables, and fingers that bend.

Capstan friction with stick and slip of a cable around its guides, for the simulator.
"""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.protocol.device import MAX_HEATING, Device
from jaxgrasp.glove.protocol.frames import Flag, Frame, Kind
from jaxgrasp.glove.sensors import Sensors


@dataclass(eq=False)
class Cable:
    """Cables from motors to fingers, each with one state: how far its friction is wound up, from -1 to 1.

    Around guides of an angle, tension grows by exp(friction x angle) against the motion (Euler and Eytelwein's
    capstan); friction winds up over a short travel before it slides (Dahl, 1968) and is larger at rest than in motion
    (Stribeck), so that what moves slowly sticks and slips.
    """

    channels: int
    wrap: float = np.pi
    """Total wrap angle around the guides [rad]."""
    sliding: float = 0.08
    """Coefficient of friction in motion."""
    resting: float = 0.12
    """Coefficient of friction at rest."""
    slow: float = 0.002
    """Speed scale of the transition from rest to motion [m/s]."""
    winding: float = 2e-4
    """Travel over which friction winds up [m]."""
    state: Float[np.ndarray, "channels"] = field(init=False)

    def __post_init__(self):
        self.state = np.zeros(self.channels)

    def pull(
        self, motor: Float[np.ndarray, "channels"], speed: Float[np.ndarray, "channels"], dt: float
    ) -> Float[np.ndarray, "channels"]:
        """Compute the tensions at the fingers [N].

        Args:
            motor: tensions at the motors [N].
            speed: of the cables [m/s], positive where fingers pull them out, as they bend.
            dt: time since the last call [s].
        """
        # Exactly over the step for a constant speed, so that no step is too long.
        reach = np.sign(speed)
        self.state = reach + (self.state - reach) * np.exp(-np.abs(speed) * dt / self.winding)
        friction = self.sliding + (self.resting - self.sliding) * np.exp(-((speed / self.slow) ** 2))
        return motor * np.exp(friction * self.wrap * self.state)


STEP = 5e-4
"""Longest step of the fingers' motion [s]."""
STATUS_EVERY = 25
"""Number of frames from one STATUS to the next: ten a second at a frame every 4 ms."""


SKIN_TEMPERATURE = 34.0
"""Temperature of a finger's skin without heat [deg C]."""
HEATER_RISE, HEATER_TIME = 27.0, 9.0
"""Rise under a heater that is on for ever [deg C], and its time constant [s]: less than what the device allows for."""


@dataclass(frozen=True)
class Fingers:
    """Impedance of the user's joints: a spring and a damper toward a target angle, and an inertia."""

    stiffness: float = 1.0
    """Stiffness of each joint [N.m/rad]."""
    damping: float = 0.01
    """Damping of each joint [N.m.s/rad]."""
    inertia: float = 5e-5
    """Inertia of each joint [kg.m^2]."""
    wander: float = 0.0
    """Speed at which the target angles wander to and fro [rad/s]: 0 for a hand that can stand perfectly still."""
    wander_range: float = 2e-3
    """Largest angle by which they wander to either side [rad]."""

    def quiet_stiffness(self, delay: float) -> float:
        """Return the stiffest spring at a joint that these fingers feel without trembling [N.m/rad].

        Args:
            delay: time from a motion to the spring's torque [s].
        """
        # K - J w^2 + j D w = -S exp(-j w T) at the limit of stability: the left side times exp(j w T) has the phase pi.
        if delay <= 0:
            return math.inf
        low, high = 0.0, math.pi / delay
        for _ in range(60):
            middle = (low + high) / 2
            phase = math.atan2(self.damping * middle, self.stiffness - self.inertia * middle**2) + middle * delay
            low, high = (middle, high) if phase < math.pi else (low, middle)
        return math.hypot(self.damping * low, self.stiffness - self.inertia * low**2)


class SimulatedGlove:
    """Simulated glove with a user's fingers in it, driven by calls to ``step``; times are seconds of the world."""

    def __init__(
        self,
        model: GloveModel,
        sensors: Sensors,
        *,
        fingers: Fingers | None = None,
        cable: Cable | None = None,
        sensations: int = 0,
    ):
        """Create an idle glove on an open hand.

        Args:
            model: the glove.
            sensors: what it has, exactly.
            fingers: of the person in it.
            cable: friction of the cables; none if None.
            sensations: number of fingers that have a vibration and a heat channel each, thumb first.
        """
        self.device = Device(
            channels=len(model.joints),
            most=model.max_counts,
            continuous=model.continuous_counts,
            # What a frame has no room for fades sooner.
            heating=min(max(round(100 * model.heating), 1), MAX_HEATING),
            slew=round(model.rate / model.quantum / 1000),
            quantum=round(model.quantum * 1e7),
            seed=random.randrange(2**32),
            vibrators=sensations,
            heaters=sensations,
        )
        self.skin_temperatures = np.full(sensations, SKIN_TEMPERATURE)
        """Temperatures of the skin under the heaters [deg C]."""
        count = len(model.joints)
        self.angles, self.speeds = np.zeros(count), np.zeros(count)
        self.tensions = np.zeros(count)
        """Tensions of the cables at the fingers [N]."""
        self.are_encoders_stuck = False
        """Fault: ANGLES frames repeat the last counts."""
        self.frozen: int | None = None
        """Fault: index of the channel whose encoder repeats its last count."""
        self.jump: int | None = None
        """Fault: counts that the first encoder reports in place of its own."""
        self.slack: int | None = None
        """Fault: index of the channel whose cable has come off."""
        self._model, self._sensors, self._cable = model, sensors, cable
        self._fingers = fingers or Fingers()
        self._start_angles = self._target_angles = np.zeros(count)
        self._movement_start, self._movement_duration = 0.0, 1e-9
        self._turn = 0
        self._encoder_counts = sensors.encoders.counts(self.angles)

    def bend(self, timestamp: float, targets: Float[np.ndarray, "channels"], duration: float) -> None:
        """Begin a movement of the fingers to target angles ``(channels,)`` [rad] that lasts a time [s]."""
        self._start_angles, self._target_angles, self._movement_start, self._movement_duration = (
            self.targets(timestamp),
            targets,
            timestamp,
            max(duration, 1e-9),
        )

    def targets(self, timestamp: float) -> Float[np.ndarray, "channels"]:
        """Compute the target angles of the movement at a time [rad]: a quintic with zero speed at both ends."""
        share = np.clip((timestamp - self._movement_start) / self._movement_duration, 0, 1)
        return self._start_angles + (self._target_angles - self._start_angles) * share**3 * (
            10 - 15 * share + 6 * share**2
        )

    def _wander(self, timestamp: float) -> float:
        """Compute how far the target angles have wandered at a time [rad]: a triangle wave of constant speed."""
        amplitude = self._fingers.wander_range
        travelled = (self._fingers.wander * timestamp + amplitude) % (4 * amplitude)
        return amplitude - abs(travelled - 2 * amplitude)

    def step(self, timestamp: float, dt: float, clock: int) -> None:
        """Advance the fingers by a duration [s], and the device to a time on its own clock [us]."""
        self._warm_skin(dt)
        counts = np.array(self.device.step(clock)[: len(self.angles)])
        motor = counts * self._model.quantum / self._sensors.gauges.arm
        steps = max(1, int(np.ceil(min(dt, 0.1) / STEP)))
        targets = self.targets(timestamp) + (self._wander(timestamp) if self._fingers.wander else 0.0)
        for _ in range(steps):
            self._move(targets, motor, min(dt, 0.1) / steps)

    def _warm_skin(self, dt: float) -> None:
        """Warm or cool the skin for a duration [s], exactly, and let the device's sensors measure it."""
        heating = np.array(self.device.are_heating[: len(self.skin_temperatures)], bool)
        # T' = (T_rest + h heating - T) / time constant
        towards = SKIN_TEMPERATURE + HEATER_RISE * heating
        self.skin_temperatures += (towards - self.skin_temperatures) * -np.expm1(-dt / HEATER_TIME)
        for k, temperature in enumerate(self.skin_temperatures):
            self.device.measure_skin(k, int(100 * temperature))

    def _move(self, targets: np.ndarray, motor: np.ndarray, dt: float) -> None:
        arm, hand = self._sensors.gauges.arm, self._fingers
        self.tensions = motor if self._cable is None else self._cable.pull(motor, self.speeds * arm, dt)
        if self.slack is not None:
            self.tensions = np.where(np.arange(len(motor)) == self.slack, 0.0, self.tensions)
        pull = hand.stiffness * (targets - self.angles) - self.tensions * arm
        # The damper at the end of the step, so that it can only slow down.
        # J domega/dt = K (target - angle) - tension arm - D omega
        self.speeds = (self.speeds + dt * pull / hand.inertia) / (1 + dt * hand.damping / hand.inertia)
        self.angles = self.angles + dt * self.speeds

    def next_frame(self, clock: int) -> Frame:
        """Create the device's next frame: answers first, then two ANGLES for each TENSIONS, and STATUS at times."""
        answer = self.device.answer(clock)
        if answer is not None:
            return answer
        self._turn = (self._turn + 1) % (3 * STATUS_EVERY)
        if self._turn % STATUS_EVERY == 0:
            return self.device.status(clock)
        if self._turn % STATUS_EVERY == STATUS_EVERY // 2 and self.device.is_sensed:
            return self.device.skin(clock)
        if self._turn % 3 == 0:
            counts = self._sensors.gauges.counts(self.tensions)
            saturated = self._sensors.gauges.tensions(counts)[1].any()
            return self.device.frame(clock, Kind.TENSIONS, _plain(counts), Flag.SATURATED if saturated else Flag(0))
        if not self.are_encoders_stuck:
            counts = self._sensors.encoders.counts(self.angles)
            is_frozen = np.arange(len(counts)) == self.frozen
            self._encoder_counts = np.where(is_frozen, self._encoder_counts, counts)
        encoder_counts = _plain(self._encoder_counts)
        return self.device.frame(
            clock, Kind.ANGLES, encoder_counts if self.jump is None else (self.jump, *encoder_counts[1:])
        )


def _plain(counts: Sequence[int] | np.ndarray) -> tuple[int, ...]:
    return tuple(int(count) for count in counts)
