"""Fault detection for encoders: range, speed, and standstill while the measured torque changes."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

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


class EncoderWatch:
    """Monitor of encoder angles for values that no finger produces; a hand at rest is never a fault."""

    def __init__(self, joints: Sequence[str]) -> None:
        """Create a monitor without any angles, for the joints of these names."""
        self._joints = tuple(joints)
        self.reset()

    def reset(self) -> None:
        """Discard all angles and torques seen so far."""
        self._read_at = -np.inf
        count = len(self._joints)
        self._angles = np.full(count, np.nan)
        self._suspect_since = np.full(count, np.inf)
        self._min_torques, self._max_torques = np.full(count, np.inf), np.full(count, -np.inf)

    def fault(self, at: float, angles: Float[np.ndarray, "channels"]) -> str:
        """Check the range and speed of angles [rad] that were read at a time [s].

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
        return ""

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
