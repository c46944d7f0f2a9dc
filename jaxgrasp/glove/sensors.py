"""Calibrated encoders and strain gauges: counts to joint angles, tensions and torques, and back for the simulator."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.validation.checked import checked

FULL_TENSION = 4.5
"""Tension up to which the paper's gauges are linear [N] (section III-A)."""
MAX_COUNT = 2**15 - 1


@dataclass(frozen=True, eq=False)
class Encoders:
    """Calibration of encoders, from counts of cable travel to joint angles: the paper's straight line per channel.

    angle = zero + counts x travel of a count / radius of the pulley; arrays ``(channels,)``.
    """

    zero: Float[np.ndarray, "channels"]
    """Angle at count 0 [rad]."""
    per_count: Float[np.ndarray, "channels"]
    """Angle per count [rad]: travel of a count over the radius of its pulley; negative where counts fall as the joint
    bends."""

    def angles(self, counts: Int[np.ndarray, "*batch channels"]) -> Float[np.ndarray, "*batch channels"]:
        """Convert counts to joint angles [rad]."""
        return self.zero + counts * self.per_count

    def counts(self, angles: Float[np.ndarray, "*batch channels"]) -> Int[np.ndarray, "*batch channels"]:
        """Convert joint angles [rad] to the nearest counts, within 16 bits."""
        return _in_counts((angles - self.zero) / self.per_count)


@dataclass(frozen=True, eq=False)
class Gauges:
    """Calibration of strain gauges, from counts to cable tensions and their torques; arrays ``(channels,)``."""

    zero: Float[np.ndarray, "channels"]
    """Counts at zero tension."""
    per_count: Float[np.ndarray, "channels"]
    """Tension of a count [N]."""
    arm: Float[np.ndarray, "channels"]
    """Lever of the cable about its joint [m]."""
    full: float = FULL_TENSION
    """Largest tension that a gauge measures [N]."""

    def tensions(
        self, counts: Int[np.ndarray, "*batch channels"]
    ) -> tuple[Float[np.ndarray, "*batch channels"], Bool[np.ndarray, "*batch channels"]]:
        """Convert counts to tensions [N], 0 to ``full``, and a mask of saturated gauges (true tension is larger)."""
        tensions = (counts - self.zero) * self.per_count
        # Half a count short of the end already is it: what lies beyond rounds there.
        return np.clip(tensions, 0, self.full), tensions >= self.full - np.abs(self.per_count) / 2

    def torques(
        self, counts: Int[np.ndarray, "*batch channels"]
    ) -> tuple[Float[np.ndarray, "*batch channels"], Bool[np.ndarray, "*batch channels"]]:
        """Convert counts to the cables' torques on the joints [N.m] and a mask of the gauges at their end."""
        tensions, saturated = self.tensions(counts)
        return tensions * self.arm, saturated

    def counts(self, tensions: Float[np.ndarray, "*batch channels"]) -> Int[np.ndarray, "*batch channels"]:
        """Convert tensions [N] to the nearest counts; tensions outside 0 to ``full`` are clipped."""
        return _in_counts(self.zero + np.clip(tensions, 0, self.full) / self.per_count)


@dataclass(frozen=True, eq=False)
class Sensors:
    """Calibration of a glove's encoders and strain gauges."""

    encoders: Encoders
    gauges: Gauges


@checked
def nominal_sensors(model: GloveModel) -> Sensors:
    """Create the nominal sensors of a glove, before any calibration.

    Largest torque and largest tension belong together (0.12 N.m and 4.5 N: a lever of 26.7 mm); 5 um of travel a count
    on pulleys of 12.5 mm and gauges of 12 bits are ours, since the paper gives neither.
    """
    unit = np.ones(len(model.joints))
    gauges = Gauges(0 * unit, FULL_TENSION / 4095 * unit, np.array(model.limits) / FULL_TENSION)
    return Sensors(Encoders(0 * unit, 5e-6 / 12.5e-3 * unit), gauges)


def _in_counts(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), -MAX_COUNT, MAX_COUNT).astype(np.int16)
