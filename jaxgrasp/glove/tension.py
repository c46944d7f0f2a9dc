"""Fault detection and feedback control of cable torques by the measured tensions."""

from collections import deque

import numpy as np
from jaxtyping import Bool, Float

SLOW = 0.3
"""Time over which measured and commanded torques are averaged, to tell a slack cable from a weak command [s]."""
SLACK = 0.25
"""Ratio of measured to commanded average below which a cable counts as slack: friction takes a third."""
FINEST = 0.001
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

    def commanded(self, now: float, torques: Float[np.ndarray, "channels"]) -> None:
        """Record the torques ``(channels,)`` [N.m] of a command that leaves at a time [s]."""
        self._commands.append((now, torques))
        # The command that held when the window began stays.
        while len(self._commands) > 1 and self._commands[1][0] < now - self._delay:
            self._commands.popleft()

    def fault(
        self, now: float, measured: Float[np.ndarray, "channels"], saturated: Bool[np.ndarray, "channels"]
    ) -> str:
        """Check measured torques against recent commands; return the description of a fault, or an empty string.

        Args:
            now: when the tensions were measured [s].
            measured: torques [N.m].
            saturated: whose gauge is at its end: those may be larger than measured.
        """
        if not self._commands:
            return ""
        recent = np.array([torques for _, torques in self._commands])
        least = recent.min(0) * (1 - self._relative) - self._absolute
        most = recent.max(0) * (1 + self._relative) + self._absolute
        wrong = ((measured < least) & ~saturated) | (measured > most) | ~np.isfinite(measured)
        self._wrong_since = np.where(wrong, np.minimum(self._wrong_since, now), np.inf)
        late = now - self._wrong_since > self._patience
        if not late.any():
            return self._slack(now, recent.mean(0), measured)
        k = int(np.argmax(late))
        return (
            f"channel {k} pulls {measured[k]:.3f} N.m: commanded {recent[:, k].min():.3f} to {recent[:, k].max():.3f}"
        )

    def _slack(self, now: float, commanded: np.ndarray, measured: np.ndarray) -> str:
        passed, self._averaged_at = max(now - self._averaged_at, 0.0), now
        latest = np.array([commanded, np.where(np.isfinite(measured), measured, 0.0)])
        self._averages += min(passed / SLOW, 1.0) * (latest - self._averages)
        wanted, found = self._averages
        is_slack = found < SLACK * wanted - FINEST
        self._slack_since = np.where(is_slack, np.minimum(self._slack_since, now), np.inf)
        slack = now - self._slack_since > self._patience
        if not slack.any():
            return ""
        k = int(np.argmax(slack))
        return f"channel {k} pulls {found[k]:.4f} N.m on the average: commanded {wanted[k]:.4f}; its cable is slack"

    def forget(self) -> None:
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
        self._sum = np.zeros(channels)
        self._asked = np.zeros(channels)

    def ask(
        self, wanted: Float[np.ndarray, "channels"], measured: Float[np.ndarray, "channels"]
    ) -> Float[np.ndarray, "channels"]:
        """Compute the torques to request from the guard [N.m], from wanted and measured torques [N.m]."""
        self._asked = wanted + self._proportional * (wanted - measured) + self._sum
        return self._asked

    def left(
        self,
        given: Float[np.ndarray, "channels"],
        wanted: Float[np.ndarray, "channels"],
        measured: Float[np.ndarray, "channels"],
        passed: float,
    ) -> None:
        """Update the integral after a duration [s] with the torques that the guard let through [N.m]."""
        back = (given - self._asked) * min(passed / self._unwind, 1.0)
        self._sum += self._integral * passed * (wanted - measured) + back

    def forget(self) -> None:
        """Reset the integral, for another arming."""
        self._sum[:] = 0
