"""Force on the wrist: the net contact wrench as an output device of six channels.

The finger joints of a glove bear a part of what the contacts do to a hand, the wrist bears the rest: by virtual work,
joint torques times joint speeds plus wrist wrench times wrist twist is the power of the contacts. An arm master that
renders the wrench implements [`jaxgrasp.teleop.WristDevice`][].
"""

import math
from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float

from jaxgrasp.validation.checked import checked

MAX_SILENCE = 0.05
"""Time without a command after which a simulated device renders nothing [s]."""
FORCE_LIMIT, TORQUE_LIMIT = 20.0, 2.0
"""Largest force and torque along each axis [N, N.m]."""
RATES = (200.0,) * 3 + (20.0,) * 3
"""Largest change of each channel [N/s, N.m/s]."""


@checked
def wrist_wrench(
    points: Float[np.ndarray, "L 3"], forces: Float[np.ndarray, "L 3"], origin: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "6"]:
    """Compute the wrench that the contacts exert on the hand about its wrist [N, N.m].

    Args:
        points: contact points [m].
        forces: of the hand on the object [N]; the hand feels their opposites.
        origin: of the wrist, in the same axes as the points [m].
    """
    # F = -sum f, M = -sum (p - o) x f
    return -np.concatenate([forces.sum(0), np.cross(points - origin, forces).sum(0)])


class WristDevice(ABC):
    """Device that exerts a wrench on a person's wrist: three forces and three torques."""

    @abstractmethod
    def command(self, timestamp: float, wrench: Float[np.ndarray, "6"]) -> None:
        """Set the wrench on the person's wrist [N, N.m]; one that is not finite stops the device."""

    @abstractmethod
    def read(self, timestamp: float) -> Float[np.ndarray, "6"]:
        """Return the wrench that the device exerts at a time that never runs backwards [N, N.m]."""

    @abstractmethod
    def stop(self, cause: str) -> None:
        """Execute the emergency stop: the device exerts nothing until ``release``."""

    @abstractmethod
    def release(self) -> None:
        """End the emergency stop; the wrench rises from zero."""


class SimulatedWrist(WristDevice):
    """Simulated arm master: limits, bounded rates of change, and a watchdog of its own."""

    def __init__(
        self, force_limit: float = FORCE_LIMIT, torque_limit: float = TORQUE_LIMIT, max_silence: float = MAX_SILENCE
    ) -> None:
        """Create a device that exerts nothing.

        Raises:
            ValueError: for a limit or a time that is not positive.
        """
        for name, value in {
            "force_limit": force_limit,
            "torque_limit": torque_limit,
            "max_silence": max_silence,
        }.items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value}: expected a positive number")
        self._limits = np.array([force_limit] * 3 + [torque_limit] * 3)
        self._max_silence = max_silence
        self.cause = ""
        """Reason of the emergency stop; empty while the device runs."""
        self._commanded, self._level = np.zeros(6), np.zeros(6)
        self._commanded_at, self._read_at = -math.inf, math.nan

    def command(self, timestamp: float, wrench: Float[np.ndarray, "6"]) -> None:
        if not np.isfinite(wrench).all():
            self.stop("a commanded wrench is not finite")
            return
        self._commanded, self._commanded_at = np.clip(wrench, -self._limits, self._limits), timestamp

    def read(self, timestamp: float) -> Float[np.ndarray, "6"]:
        # A comparison with NaN is false: nothing has changed before the first reading.
        dt = timestamp - self._read_at if timestamp > self._read_at else 0.0
        self._read_at = timestamp
        is_silent = timestamp - self._commanded_at > self._max_silence
        if self.cause or is_silent or not self._commanded.any():
            # Silence and a command of nothing take the wrench away at once, as the glove's watchdog does.
            self._level = np.zeros(6)
        else:
            largest = np.array(RATES) * dt
            self._level = self._level + np.clip(self._commanded - self._level, -largest, largest)
        return self._level.copy()

    def stop(self, cause: str) -> None:
        self.cause = self.cause or cause

    def release(self) -> None:
        self.cause, self._commanded_at = "", -math.inf
