"""Fault detection and feedback control of cable torques by the measured tensions."""

from collections import deque

import numpy as np
from jaxtyping import Bool, Float

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
