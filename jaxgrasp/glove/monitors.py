"""Watches over a glove's joints: encoder faults, cable tensions, and the energy that a joint gives back.

Passivity: a glove must not give a hand more energy than it took, as delayed springs do.

The time-domain passivity observer and controller of Hannaford and Ryu [1], a channel each: energy is counted where
torque and angle meet; where a joint has little left to give back, its torque is lowered, and added to against its
speed, since a glove's torques change too slowly for damping alone; where that is not enough, torque is to end.

[1] B. Hannaford, J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Transactions on Robotics and
Automation 18(1), 2002.

Fault detection for encoders: range, speed, and standstill under torque, while the measured torque changes, while a
neighbouring joint bends, or for longer than a living hand stands still.

Fault detection and feedback control of cable torques by the measured tensions.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxgrasp.glove.model import GloveModel

MIN_ANGLE, MAX_ANGLE = np.radians(-60.0), np.radians(150.0)
"""Range of a finger joint [rad]; an angle outside it is a fault."""
MAX_SPEED = 60.0
"""Largest speed of a finger joint [rad/s]: three times the speed of a quick finger."""
TORQUE_CHANGE = 0.03
"""Smallest change of a cable's torque at which its joint yields by an encoder count or more [N.m]."""
PATIENCE = 0.1
"""Longest time for which an encoder may stand still after such a change [s]."""
MIN_FLEXION = 0.15
"""Smallest flexion that is checked for standstill [rad]: below it, a joint may rest at the end of its travel."""
MIN_HOLDING_TORQUE = 0.01
"""Command above which an encoder that stands still is checked against its neighbours and against time [N.m]."""
NEIGHBOUR_MOTION = 0.35
"""Motion of another joint of the finger, 20 degrees, during which a joint under torque moves by an encoder count or
more [rad]: tendons and skin couple the joints, and the torque that a contact exerts on them changes with the posture.
"""
STILL_TIME = 5.0
"""Longest time for which a command above ``MIN_HOLDING_TORQUE`` holds while its encoder shows no motion at all [s]. A
hand that pulls against a cable trembles at 8 to 12 Hz by more than an encoder's count, so a standstill of this length
is that of an encoder, or of a glove that nobody wears."""


class EncoderWatch:
    """Monitor of encoder angles for values that no finger produces.

    A hand without torque may rest for ever. Under torque an encoder that shows no motion is a fault while its cable or
    a neighbouring joint moves, and after ``STILL_TIME`` in any case.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        """Create a monitor without any angles, for the joints of these names, the first word of which is the finger."""
        self._joints = tuple(joints)
        fingers = [joint.split()[0] if joint.split() else joint for joint in joints]
        self._are_neighbours = np.array([[a == b for b in fingers] for a in fingers]) & ~np.eye(
            len(fingers), dtype=bool
        )
        self.reset()

    def reset(self) -> None:
        """Discard all angles and torques seen so far."""
        self._read_at = -np.inf
        count = len(self._joints)
        self._angles = np.full(count, np.nan)
        self._suspect_since = np.full(count, np.inf)
        self._min_torques, self._max_torques = np.full(count, np.inf), np.full(count, -np.inf)
        self._commands = np.zeros(count)
        self._still_since = np.full(count, np.inf)
        self._apart_since = np.full(count, np.inf)
        self._still_angles = np.full((count, count), np.nan)
        """Angles of all joints (columns) when each joint (rows) moved last under torque [rad]."""

    def commanded(self, torques: Float[np.ndarray, "channels"]) -> None:
        """Record the torques ``(channels,)`` [N.m] of a command that leaves now."""
        self._commands = torques

    def fault(self, at: float, angles: Float[np.ndarray, "channels"]) -> str:
        """Check angles [rad] that were read at a time [s]: range, speed, and standstill under torque.

        Returns:
            Description of the fault; empty if there is none.
        """
        dt, last_angles = at - self._read_at, self._angles
        has_moved = angles != last_angles
        self._suspect_since = np.where(has_moved, np.inf, self._suspect_since)
        self._min_torques, self._max_torques = (
            np.where(has_moved, np.inf, self._min_torques),
            np.where(has_moved, -np.inf, self._max_torques),
        )
        self._read_at, self._angles = at, angles
        is_out_of_range = (angles < MIN_ANGLE) | (angles > MAX_ANGLE)
        if is_out_of_range.any():
            k = int(np.argmax(is_out_of_range))
            least, greatest, angle = np.degrees((MIN_ANGLE, MAX_ANGLE, angles[k]))
            return f"the encoder of {self._joints[k]} reads {angle:.0f} degrees: expected {least:.0f} to {greatest:.0f}"
        # A frame that waited comes right before the next one, so that times are no shorter than a frame's.
        is_too_fast = np.abs(angles - last_angles) > MAX_SPEED * max(dt, 4e-3)
        if np.isfinite(dt) and is_too_fast.any():
            k = int(np.argmax(is_too_fast))
            return (
                f"the encoder of {self._joints[k]} jumped by {np.degrees(abs(angles[k] - last_angles[k])):.0f} degrees"
            )
        return self._standstill(at, angles, has_moved)

    def _standstill(self, at: float, angles: np.ndarray, has_moved: np.ndarray) -> str:
        """Check for encoders under torque that show no motion, while a neighbour moves or for ``STILL_TIME``."""
        is_free = has_moved | (self._commands <= MIN_HOLDING_TORQUE)
        self._still_since = np.where(is_free, np.inf, np.minimum(self._still_since, at))
        begins = is_free | np.isnan(self._still_angles).any(1)
        self._still_angles[begins] = angles
        motions = np.where(self._are_neighbours, np.abs(angles - self._still_angles), 0.0)
        is_apart = ~is_free & (motions.max(1) > NEIGHBOUR_MOTION) & (angles > MIN_FLEXION)
        self._apart_since = np.where(is_apart, np.minimum(self._apart_since, at), np.inf)
        is_frozen = at - self._apart_since > PATIENCE
        if is_frozen.any():
            k = int(np.argmax(is_frozen))
            neighbour = int(np.argmax(motions[k]))
            return (
                f"the encoder of {self._joints[k]} stands still while {self._joints[neighbour]} moves by "
                f"{np.degrees(motions[k, neighbour]):.0f} degrees"
            )
        is_still = at - self._still_since > STILL_TIME
        if not is_still.any():
            return ""
        k = int(np.argmax(is_still))
        return (
            f"the encoder of {self._joints[k]} showed no motion for {STILL_TIME:g} s under "
            f"{self._commands[k]:.3f} N.m: it is stuck, or nobody wears the glove"
        )

    def stands_still(self, at: float, torques: Float[np.ndarray, "channels"]) -> str:
        """Check for encoders that stand still while the measured torques [N.m] change.

        Returns:
            Description of the fault; empty if there is none.
        """
        self._min_torques, self._max_torques = np.fmin(self._min_torques, torques), np.fmax(self._max_torques, torques)
        is_suspect = (self._max_torques - self._min_torques > TORQUE_CHANGE) & (self._angles > MIN_FLEXION)
        self._suspect_since = np.where(is_suspect, np.fmin(self._suspect_since, at), np.inf)
        is_stuck = at - self._suspect_since > PATIENCE
        if not is_stuck.any():
            return ""
        return f"the encoder of {self._joints[int(np.argmax(is_stuck))]} stands still while its cable moves"


AVERAGING_TIME = 0.3
"""Time over which measured and commanded torques are averaged, to tell a slack cable from a weak command [s]."""
SLACK_RATIO = 0.25
"""Ratio of measured to commanded average below which a cable counts as slack: friction takes a third."""
SLACK_TOLERANCE = 0.001
"""Tolerance of these averages, for gauges that are a little off [N.m]: a slack cable shows from 0.004 N.m on."""


class TensionWatch:
    """Monitor that compares measured with commanded torques, with tolerances for cable friction and delay.

    A torque is right if it lies between the least and the largest command of the last moments, each widened by an
    absolute and a relative tolerance; only one that is wrong for a while without a pause is a fault. A cable is slack
    whose torque stays far below its commands on the average of a longer time, which shows at weak commands too.
    """

    def __init__(
        self,
        channels: int,
        *,
        absolute: float = 0.02,
        relative: float = 0.5,
        delay: float = 0.06,
        patience: float = 0.1,
    ):
        """Create a monitor that has seen nothing.

        Args:
            channels: how many.
            absolute: tolerance [N.m].
            relative: tolerance, of the command; the capstan of the simulator takes or adds a third.
            delay: how long a command may take to be measured [s].
            patience: how long a torque may be wrong [s].
        """
        self._absolute, self._relative, self._delay, self._patience = absolute, relative, delay, patience
        self._commands: deque[tuple[float, np.ndarray]] = deque()
        self._wrong_since, self._slack_since = np.full(channels, np.inf), np.full(channels, np.inf)
        self._averages, self._averaged_at = np.zeros((2, channels)), np.inf

    def commanded(self, timestamp: float, torques: Float[np.ndarray, "channels"]) -> None:
        """Record the torques ``(channels,)`` [N.m] of a command that leaves at a time [s]."""
        self._commands.append((timestamp, torques))
        # The command that held when the window began stays.
        while len(self._commands) > 1 and self._commands[1][0] < timestamp - self._delay:
            self._commands.popleft()

    def fault(
        self, timestamp: float, measured: Float[np.ndarray, "channels"], saturated: Bool[np.ndarray, "channels"]
    ) -> str:
        """Check measured torques against recent commands; return the description of a fault, or an empty string.

        Args:
            timestamp: when the tensions were measured [s].
            measured: torques [N.m].
            saturated: whose gauge is at its end: those may be larger than measured.
        """
        if not self._commands:
            return ""
        recent = np.array([torques for _, torques in self._commands])
        lowest = recent.min(0) * (1 - self._relative) - self._absolute
        highest = recent.max(0) * (1 + self._relative) + self._absolute
        is_wrong = ((measured < lowest) & ~saturated) | (measured > highest) | ~np.isfinite(measured)
        self._wrong_since = np.where(is_wrong, np.minimum(self._wrong_since, timestamp), np.inf)
        is_fault = timestamp - self._wrong_since > self._patience
        if not is_fault.any():
            return self._slack(timestamp, recent.mean(0), measured)
        k = int(np.argmax(is_fault))
        return (
            f"channel {k} pulls {measured[k]:.3f} N.m: commanded {recent[:, k].min():.3f} to {recent[:, k].max():.3f}"
        )

    def _slack(self, timestamp: float, commanded: np.ndarray, measured: np.ndarray) -> str:
        dt, self._averaged_at = max(timestamp - self._averaged_at, 0.0), timestamp
        current = np.array([commanded, np.where(np.isfinite(measured), measured, 0.0)])
        self._averages += min(dt / AVERAGING_TIME, 1.0) * (current - self._averages)
        commanded_mean, measured_mean = self._averages
        is_slack = measured_mean < SLACK_RATIO * commanded_mean - SLACK_TOLERANCE
        self._slack_since = np.where(is_slack, np.minimum(self._slack_since, timestamp), np.inf)
        is_fault = timestamp - self._slack_since > self._patience
        if not is_fault.any():
            return ""
        k = int(np.argmax(is_fault))
        return (
            f"channel {k} pulls {measured_mean[k]:.4f} N.m on average: commanded {commanded_mean[k]:.4f}; "
            "its cable is slack"
        )

    def reset(self) -> None:
        """Discard commands, averages and suspected faults, for another arming."""
        self._commands.clear()
        self._wrong_since[:] = self._slack_since[:] = np.inf
        self._averages[:], self._averaged_at = 0, np.inf


class TensionControl:
    """Proportional and integral control of torques by their measured tensions; its output still goes through a guard.

    What the guard cuts or delays is taken back from the integral (back-calculation), so that it does not wind up.
    """

    def __init__(self, channels: int, *, proportional: float = 0.3, integral: float = 5.0, unwind: float = 0.05):
        """Create a controller whose integral is zero.

        Args:
            channels: how many.
            proportional: gain.
            integral: gain [1/s].
            unwind: time in which the integral gives back what did not leave [s].

        Raises:
            ValueError: for gains that are negative or not finite, and a time that is not positive.
        """
        for name, value in {"proportional": proportional, "integral": integral}.items():
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}: expected a finite number, zero or more")
        if not (np.isfinite(unwind) and unwind > 0):
            raise ValueError(f"unwind is {unwind}: expected a positive time [s]")
        self._proportional, self._integral, self._unwind = proportional, integral, unwind
        self._integral_sum = np.zeros(channels)
        self._request = np.zeros(channels)

    def request(
        self, requested: Float[np.ndarray, "channels"], measured: Float[np.ndarray, "channels"]
    ) -> Float[np.ndarray, "channels"]:
        """Compute the torques to request from the guard [N.m], from wanted and measured torques [N.m]."""
        # u = r + K_p (r - y) + integral
        self._request = requested + self._proportional * (requested - measured) + self._integral_sum
        return self._request

    def update_integral(
        self,
        applied: Float[np.ndarray, "channels"],
        requested: Float[np.ndarray, "channels"],
        measured: Float[np.ndarray, "channels"],
        dt: float,
    ) -> None:
        """Update the integral after a duration [s] with the torques that the guard let through [N.m]."""
        # d integral = K_i (r - y) dt + (applied - u) dt / unwind
        correction = (applied - self._request) * min(dt / self._unwind, 1.0)
        self._integral_sum += self._integral * dt * (requested - measured) + correction

    def reset(self) -> None:
        """Reset the integral, for another arming."""
        self._integral_sum[:] = 0


CREDIT = 0.5
"""Initial energy budget, as the angle over which the largest torque may push a joint back after arming [rad]."""
MAX_CREDIT = 1.5
"""Largest energy budget, as the angle over which the largest torque acts: a whole flexion [rad]."""
LOW_CREDIT = 0.25
"""Energy budget, as an angle [rad], below which torque is damped and lowered, to zero when nothing is left."""
REFILL = 0.15
"""Permanent refill of the energy budget, as a part of largest torque times 1 rad [1/s]: objects that move need it."""
MAX_DEFICIT = 0.5
"""Largest energy deficit, as the angle of a push in spite of damping, before torque must end [rad]."""
DAMPING = 0.1
"""Largest damping coefficient against a joint's speed, as a part of its largest torque [s/rad]."""
SMOOTHING = 0.015
"""Time constant of the low-pass filter of a joint's speed [s]."""


class PassivityWatch:
    """Energy observer of each joint, from commands as they left and angles as they were read."""

    def __init__(self, model: GloveModel, delay: float = 0.0) -> None:
        """Create an observer that has seen nothing.

        Args:
            model: of the glove.
            delay: from when a command is sent until it holds [s].
        """
        self._joints, self._limits = model.joints, np.array(model.limits)
        self._delay = delay
        self.reset()

    def reset(self) -> None:
        """Reset to the initial energy budget, for another arming."""
        zeros = np.zeros(len(self._limits))
        self.energy = CREDIT * self._limits
        """Energy that each joint may still give back [J]; negative after it gave more."""
        self._commands: deque[tuple[float, np.ndarray]] = deque([(-np.inf, zeros)])
        self._read_at, self._angles, self._speeds = -np.inf, zeros, zeros

    def commanded(self, timestamp: float, torques: Float[np.ndarray, "channels"]) -> None:
        """Record the torques ``(channels,)`` [N.m] of a command that leaves at a time [s]."""
        self._commands.append((timestamp + self._delay, torques))

    def update(self, at: float, angles: Float[np.ndarray, "channels"]) -> str:
        """Update the energies with angles [rad] that were read at a time [s].

        Returns:
            Description of a joint that gave too much energy; empty if there is none.
        """
        dt, angle_change = at - self._read_at, angles - self._angles
        if not dt > 0:
            return ""
        # The command that held in the middle of the movement.
        while len(self._commands) > 1 and self._commands[1][0] <= at - dt / 2:
            self._commands.popleft()
        if np.isfinite(dt):
            # dE = tau dtheta + REFILL tau_max dt
            gained = self._commands[0][1] * angle_change + REFILL * self._limits * dt
            self.energy = np.minimum(self.energy + gained, MAX_CREDIT * self._limits)
            # First-order low-pass filter of dtheta / dt
            self._speeds = self._speeds + min(dt / SMOOTHING, 1.0) * (angle_change / dt - self._speeds)
        self._read_at, self._angles = at, angles
        is_exceeded = self.energy < -MAX_DEFICIT * self._limits
        if not is_exceeded.any():
            return ""
        return (
            f"{self._joints[int(np.argmax(is_exceeded))]} gives the hand more energy than it took: it shakes, or pushes"
        )

    def damp(self, requested: Any) -> Any:
        """Lower and damp the requested torques [N.m] of joints that have little energy left to give.

        Invalid input is returned unchanged, for the guard to refuse.
        """
        is_resisted = self._limits > 0
        filled = np.divide(self.energy, LOW_CREDIT * self._limits, out=np.ones(len(is_resisted)), where=is_resisted)
        share = np.clip(1 - filled, 0, 1)
        if not share.any():
            return requested
        try:
            torques = np.asarray(requested)
        except ValueError:
            return requested
        if torques.dtype.kind not in "fiu" or torques.shape != share.shape:
            return requested
        # tau' = (1 - s) tau + DAMPING s tau_max omega
        return torques * (1 - share) + DAMPING * share * self._limits * self._speeds
