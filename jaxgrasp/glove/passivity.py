"""Whether a glove gives a hand more energy than it took: what springs that answer late do, and what shakes.

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
"""Angle by which a joint may be pushed back by the largest torque, for what was wound up before it was armed [rad]."""
KEPT = 1.5
"""Angle over which energy that a joint took in by the largest torque is remembered: a whole flexion [rad]."""
LOW = 0.25
"""What is left [rad] below which torque is damped, and given up, all of it where nothing is left."""
REFILL = 0.15
"""Part of its largest torque times 1 rad that a joint may give each second for ever: objects that move do [1/s]."""
BEYOND = 0.5
"""Angle by which it may be pushed back, in spite of damping, before torque is to end [rad]."""
DAMPING = 0.1
"""Most that is added against a joint's speed, as a part of its largest torque [s/rad]."""
SMOOTHING = 0.015
"""Time over which a joint's speed is taken [s]."""


class PassivityWatch:
    """Energy of each joint, from commands as they left and angles as they were read."""

    def __init__(self, model: GloveModel, delay: float = 0.0) -> None:
        """A watch that has seen nothing.

        Args:
            model: of the glove.
            delay: from when a command is sent until it holds [s].
        """
        self._joints, self._limits = model.joints, np.array(model.limits)
        self._delay = delay
        self.forget()

    def forget(self) -> None:
        """As new, for another arming."""
        nothing = np.zeros(len(self._limits))
        self.energy = CREDIT * self._limits
        """What each joint may still give back [J]; below zero where it gave more."""
        self._commands: deque[tuple[float, np.ndarray]] = deque([(-np.inf, nothing)])
        self._at, self._angles, self._speeds = -np.inf, nothing, nothing

    def commanded(self, now: float, torques: Float[np.ndarray, "channels"]) -> None:
        """A command that leaves [N.m]."""
        self._commands.append((now + self._delay, torques))

    def moved(self, at: float, angles: Float[np.ndarray, "channels"]) -> str:
        """Angles that were read at a time [rad]; what is wrong, in words, and nothing if all is well."""
        passed, turned = at - self._at, angles - self._angles
        if not passed > 0:
            return ""
        # What held in the middle of the movement.
        while len(self._commands) > 1 and self._commands[1][0] <= at - passed / 2:
            self._commands.popleft()
        if np.isfinite(passed):
            took = self._commands[0][1] * turned + REFILL * self._limits * passed
            self.energy = np.minimum(self.energy + took, KEPT * self._limits)
            self._speeds = self._speeds + min(passed / SMOOTHING, 1.0) * (turned / passed - self._speeds)
        self._at, self._angles = at, angles
        lost = self.energy < -BEYOND * self._limits
        if not lost.any():
            return ""
        return f"{self._joints[int(np.argmax(lost))]} gives the hand more energy than it took: it shakes, or pushes"

    def damped(self, wanted: Any) -> Any:
        """Torques that are asked for [N.m], less of them and damped where a joint has little left to give.

        What are no torques stay what they are, for the guard to refuse.
        """
        share = np.clip(1 - self.energy / (LOW * self._limits), 0, 1)
        if not share.any():
            return wanted
        try:
            asked = np.asarray(wanted)
        except ValueError:
            return wanted
        if asked.dtype.kind not in "fiu" or asked.shape != share.shape:
            return wanted
        return asked * (1 - share) + DAMPING * share * self._limits * self._speeds
