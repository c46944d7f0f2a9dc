"""Encoders and strain gauges: counts to joint angles, tensions and torques, and back for the simulator."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.validation.checked import checked

FULL_TENSION = 4.5
"""Tension up to which the paper's gauges are linear [N] (section III-A)."""
MOST = 2**15 - 1


@dataclass(frozen=True, eq=False)
class Encoders:
    """Counts of the cables' travel to joint angles: the paper's simplified calibration, a straight line a channel.

    angle = zero + counts x travel of a count / radius of the pulley; arrays ``(channels,)``.
    """

    zero: Float[np.ndarray, "channels"]
    """Angle at no counts [rad]."""
    per_count: Float[np.ndarray, "channels"]
    """Angle per count [rad]: travel of a count over the radius of its pulley; negative where counts fall as the joint
    bends."""

    def angles(self, counts: Int[np.ndarray, "*batch channels"]) -> Float[np.ndarray, "*batch channels"]:
        """Joint angles [rad]."""
        return self.zero + counts * self.per_count

    def counts(self, angles: Float[np.ndarray, "*batch channels"]) -> Int[np.ndarray, "*batch channels"]:
        """The nearest counts of joint angles [rad], within 16 bits."""
        return _in_counts((angles - self.zero) / self.per_count)


@dataclass(frozen=True, eq=False)
class Gauges:
    """Counts of the strain gauges to cable tensions and the torques they make; arrays ``(channels,)``."""

    zero: Float[np.ndarray, "channels"]
    """Counts at no tension."""
    per_count: Float[np.ndarray, "channels"]
    """Tension of a count [N]."""
    arm: Float[np.ndarray, "channels"]
    """Lever of the cable about its joint [m]."""
    full: float = FULL_TENSION
    """Largest tension that a reading tells [N]."""

    def tensions(
        self, counts: Int[np.ndarray, "*batch channels"]
    ) -> tuple[Float[np.ndarray, "*batch channels"], Bool[np.ndarray, "*batch channels"]]:
        """Tensions [N], 0 to ``full``, and which gauges are at their end, so that the true one may be larger."""
        tensions = (counts - self.zero) * self.per_count
        # Half a count short of the end already is it: what lies beyond rounds there.
        return np.clip(tensions, 0, self.full), tensions >= self.full - np.abs(self.per_count) / 2

    def torques(
        self, counts: Int[np.ndarray, "*batch channels"]
    ) -> tuple[Float[np.ndarray, "*batch channels"], Bool[np.ndarray, "*batch channels"]]:
        """Torques that the cables exert on the joints [N.m], and which gauges are at their end."""
        tensions, saturated = self.tensions(counts)
        return tensions * self.arm, saturated

    def counts(self, tensions: Float[np.ndarray, "*batch channels"]) -> Int[np.ndarray, "*batch channels"]:
        """The nearest counts of tensions [N], which stay at their end beyond it."""
        return _in_counts(self.zero + np.clip(tensions, 0, self.full) / self.per_count)


@dataclass(frozen=True, eq=False)
class Sensors:
    """Encoders and strain gauges: counts of a glove to angles and tensions."""

    encoders: Encoders
    gauges: Gauges


@checked
def nominal_sensors(model: GloveModel) -> Sensors:
    """Sensors before any calibration.

    Largest torque and largest tension belong together (0.12 N.m and 4.5 N: a lever of 26.7 mm); 5 um of travel a count
    on pulleys of 12.5 mm and gauges of 12 bits are ours, since the paper gives neither.
    """
    one = np.ones(len(model.joints))
    gauges = Gauges(0 * one, FULL_TENSION / 4095 * one, np.array(model.limits) / FULL_TENSION)
    return Sensors(Encoders(0 * one, 5e-6 / 12.5e-3 * one), gauges)


def _in_counts(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), -MOST, MOST).astype(np.int16)
