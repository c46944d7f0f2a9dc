"""What encoders say, against what a hand can do and what the strain gauges feel."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

LEAST_ANGLE, MOST_ANGLE = np.radians(-60.0), np.radians(150.0)
"""No finger's joint goes beyond these [rad]."""
MOST_SPEED = 60.0
"""No finger bends faster [rad/s]: three times what a quick one does."""
MOVED = 0.03
"""A change of a cable's torque that a joint yields to, if only by a count of its encoder [N.m]."""
PATIENCE = 0.1
"""Time for which an encoder may stand still after such a change [s]."""
CLEAR = 0.15
"""Joints that are bent less may stand at the end of their travel, and yield to nothing [rad]."""


class EncoderWatch:
    """Whether angles are those of fingers; it never says that a hand at rest is a fault."""

    def __init__(self, joints: Sequence[str]) -> None:
        """A watch that has seen nothing."""
        self._joints = tuple(joints)
        self.forget()

    def forget(self) -> None:
        """As though nothing had come yet."""
        self._at = -np.inf
        count = len(self._joints)
        self._angles = np.full(count, np.nan)
        self._odd_since = np.full(count, np.inf)
        self._least, self._most = np.full(count, np.inf), np.full(count, -np.inf)

    def fault(self, at: float, angles: Float[np.ndarray, "channels"]) -> str:
        """What is wrong with angles that were read at a time [s], in words; nothing if all is well."""
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
        """What is wrong with encoders that stood still while these torques changed [N.m], in words."""
        self._least, self._most = np.fmin(self._least, torques), np.fmax(self._most, torques)
        odd = (self._most - self._least > MOVED) & (self._angles > CLEAR)
        self._odd_since = np.where(odd, np.fmin(self._odd_since, at), np.inf)
        still = at - self._odd_since > PATIENCE
        if not still.any():
            return ""
        return f"the encoder of {self._joints[int(np.argmax(still))]} stands still while its cable moves"
