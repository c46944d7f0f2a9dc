"""What the two sides of the loop tell each other: a law of torque by angle, and the glove's state."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class TorqueLaw:
    """Torques about some angles: what a slow computation gives a fast line, so that it can answer fresh angles.

    The line knows no contacts; between two computations it goes along the derivative.
    """

    computed_at: float
    """Time of the computation, on the clock of the side that computed it [s]."""
    is_valid: bool
    """Whether it may be acted on."""
    angles: Float[np.ndarray, "channels"]
    """Those that it was computed for [rad]."""
    torques: Float[np.ndarray, "channels"]
    """Torques by which to resist flexion there [N.m]."""
    derivative: Float[np.ndarray, "channels channels"]
    """Derivative of the torques (rows) by the angles [N.m/rad]."""

    def at(self, angles: Float[np.ndarray, "channels"], reach: float) -> Float[np.ndarray, "channels"]:
        """Torques at other angles [N.m]; beyond a reach [rad] on either side, as at its end."""
        return self.torques + self.derivative @ np.clip(angles - self.angles, -reach, reach)

    def since(self, now: float) -> "TorqueLaw":
        """The law with its age in place of its time, to go to another clock; there, a second call turns it back."""
        return TorqueLaw(now - self.computed_at, self.is_valid, self.angles, self.torques, self.derivative)

    @staticmethod
    def size(channels: int) -> int:
        """Numbers of its vector."""
        return 2 + channels * (2 + channels)

    def vector(self) -> Float[np.ndarray, "size"]:
        """All of it in one."""
        return np.concatenate(
            [[self.computed_at, float(self.is_valid)], self.angles, self.torques, self.derivative.ravel()]
        )

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "TorqueLaw":
        """The law that a vector is of."""
        angles, torques, derivative = np.split(vector[2:], [channels, 2 * channels])
        valid = bool(vector[1] == 1.0 and np.all(np.isfinite(vector)))
        return TorqueLaw(float(vector[0]), valid, angles, torques, derivative.reshape(channels, channels))


@dataclass(frozen=True, eq=False)
class GloveState:
    """What the I/O side knows of its glove."""

    at: float
    """When it said so [s]."""
    link: int
    """A LinkState."""
    guard: int
    """A GuardState."""
    clipped: float
    """Most that the limit cut of any torque at this tick [N.m]: such a trial may have to be discarded."""
    angles_at: float
    """When the angles were read [s]."""
    angles: Float[np.ndarray, "channels"]
    """[rad]"""
    torques: Float[np.ndarray, "channels"]
    """Commanded torques [N.m]."""
    measured: Float[np.ndarray, "channels"]
    """Torques measured by the cables' tension [N.m]."""

    def since(self, now: float) -> "GloveState":
        """The state with ages in place of times, to go to another clock; or with times again, to come from one."""
        rest = (self.link, self.guard, self.clipped, now - self.angles_at)
        return GloveState(now - self.at, *rest, self.angles, self.torques, self.measured)

    @staticmethod
    def size(channels: int) -> int:
        """Numbers of its vector."""
        return 5 + 3 * channels

    def vector(self) -> Float[np.ndarray, "size"]:
        """All of it in one."""
        head = [self.at, self.link, self.guard, self.clipped, self.angles_at]
        return np.concatenate([head, self.angles, self.torques, self.measured])

    @staticmethod
    def of(vector: Float[np.ndarray, "size"], channels: int) -> "GloveState | None":
        """The state that a vector is of; None where it is of none."""
        at, link, guard, clipped, angles_at = vector[:5].tolist()
        if link not in (0, 1, 2, 3, 4) or guard not in (0, 1, 2) or not math.isfinite(at):
            return None
        angles, torques, measured = np.split(vector[5:], [channels, 2 * channels])
        return GloveState(at, int(link), int(guard), clipped, angles_at, angles, torques, measured)
