"""Passivity of each joint: a glove must not give a hand more energy than it took, as delayed springs do.

The time-domain passivity observer and controller of Hannaford and Ryu [1], a channel each: energy is counted where
torque and angle meet; where a joint has little left to give back, its torque is lowered, and added to against its
speed, since a glove's torques change too slowly for damping alone; where that is not enough, torque is to end.

[1] B. Hannaford, J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Transactions on Robotics and
Automation 18(1), 2002.
"""

from collections import deque
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.model import GloveModel

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
        share = np.clip(1 - self.energy / (LOW_CREDIT * self._limits), 0, 1)
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
