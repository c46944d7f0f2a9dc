"""Fault detection for encoders: range, speed, and standstill while the measured torque changes."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

LEAST_ANGLE, MOST_ANGLE = np.radians(-60.0), np.radians(150.0)
"""Range of a finger joint [rad]; an angle outside it is a fault."""
MOST_SPEED = 60.0
"""Largest speed of a finger joint [rad/s]: three times the speed of a quick finger."""
MOVED = 0.03
"""Smallest change of a cable's torque at which its joint yields by an encoder count or more [N.m]."""
PATIENCE = 0.1
"""Longest time for which an encoder may stand still after such a change [s]."""
CLEAR = 0.15
"""Smallest flexion that is checked for standstill [rad]: below it, a joint may rest at the end of its travel."""


class EncoderWatch:
    """Monitor of encoder angles for values that no finger produces; a hand at rest is never a fault."""

    def __init__(self, joints: Sequence[str]) -> None:
        """Create a monitor without any angles, for the joints of these names."""
        self._joints = tuple(joints)
        self.forget()

    def forget(self) -> None:
        """Discard all angles and torques seen so far."""
        self._at = -np.inf
        count = len(self._joints)
        self._angles = np.full(count, np.nan)
        self._odd_since = np.full(count, np.inf)
        self._least, self._most = np.full(count, np.inf), np.full(count, -np.inf)

    def fault(self, at: float, angles: Float[np.ndarray, "channels"]) -> str:
        """Check the range and speed of angles [rad] that were read at a time [s].

        Returns:
            Description of the fault; empty if there is none.
        """
        passed, before = at - self._at, self._angles
        moved = angles != before
        self._odd_since = np.where(moved, np.inf, self._odd_since)
        self._least, self._most = np.where(moved, np.inf, self._least), np.where(moved, -np.inf, self._most)
        self._at, self._angles = at, angles
        beyond = (angles < LEAST_ANGLE) | (angles > MOST_ANGLE)
        if beyond.any():
            k = int(np.argmax(beyond))
            return f"the encoder of {self._joints[k]} says {np.degrees(angles[k]):.0f} degrees, which no finger does"
        # A frame that waited comes right before the next one, so that times are no shorter than a frame's.
        fast = np.abs(angles - before) > MOST_SPEED * max(passed, 4e-3)
        if np.isfinite(passed) and fast.any():
            k = int(np.argmax(fast))
            return f"the encoder of {self._joints[k]} jumped by {np.degrees(abs(angles[k] - before[k])):.0f} degrees"
        return ""

    def stands_still(self, at: float, torques: Float[np.ndarray, "channels"]) -> str:
        """Check for encoders that stand still while the measured torques [N.m] change.

        Returns:
            Description of the fault; empty if there is none.
        """
        self._least, self._most = np.fmin(self._least, torques), np.fmax(self._most, torques)
        odd = (self._most - self._least > MOVED) & (self._angles > CLEAR)
        self._odd_since = np.where(odd, np.fmin(self._odd_since, at), np.inf)
        still = at - self._odd_since > PATIENCE
        if not still.any():
            return ""
        return f"the encoder of {self._joints[int(np.argmax(still))]} stands still while its cable moves"
