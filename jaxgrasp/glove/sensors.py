"""Calibrated encoders and strain gauges, and their calibration from recorded pairs.

Counts become joint angles, tensions and torques, and back for the simulator.

Calibration: the straight lines of encoders and gauges by least squares, from pairs that were recorded.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgrasp.files.file_values import is_number
from jaxgrasp.files.replace import replace_file
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
    gauges = Gauges(0 * unit, FULL_TENSION / 4095 * unit, _levers(model))
    return Sensors(Encoders(0 * unit, 5e-6 / 12.5e-3 * unit), gauges)


def _levers(model: GloveModel) -> np.ndarray:
    """Compute the levers at which the largest torque is the largest tension [m]; a channel without a motor has any."""
    limits = np.array(model.limits)
    return np.where(limits > 0, limits, limits.max(initial=0) or 1.0) / FULL_TENSION


def _in_counts(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), -MAX_COUNT, MAX_COUNT).astype(np.int16)


HUGE = 1e9
"""Upper bound on the magnitude of any number in a calibration."""
MIN_PAIRS = 3
"""Smallest number of pairs per channel: two pairs fit any line and leave no residual."""


@dataclass(frozen=True, eq=False)
class CalibrationLine:
    """value = at_zero + counts x per_count for each channel, and how well it fits; arrays ``(channels,)``."""

    at_zero: Float[np.ndarray, "channels"]
    per_count: Float[np.ndarray, "channels"]
    error_at_zero: Float[np.ndarray, "channels"]
    """Standard error of ``at_zero``."""
    error_per_count: Float[np.ndarray, "channels"]
    """Standard error of ``per_count``."""
    residuals: Float[np.ndarray, "pairs channels"]
    """Measured value minus the line's value; NaN for pairs left out."""

    @property
    def rms(self) -> Float[np.ndarray, "channels"]:
        """Root mean square of the residuals of each channel."""
        return np.sqrt(np.nanmean(self.residuals**2, axis=0))


def fit_line(
    counts: Int[np.ndarray, "pairs channels"],
    values: Float[np.ndarray, "pairs channels"],
    used: Bool[np.ndarray, "pairs channels"] | None = None,
) -> CalibrationLine:
    """Fit a straight line to the (count, value) pairs of each channel by least squares.

    Args:
        counts: of a sensor.
        values: measured beside it, in the unit that is wanted; NaN where none was.
        used: which pairs count; all that are finite, if None.

    Raises:
        ValueError: for arrays of different shapes, infinities, and channels of fewer than three pairs or of one count.
    """
    if counts.shape != values.shape or counts.ndim != 2:
        raise ValueError(
            f"counts have shape {counts.shape}, values {values.shape}: expected the same shape (pairs, channels)"
        )
    if np.any(np.isinf(values)):
        i, k = np.argwhere(np.isinf(values))[0]
        raise ValueError(f"values[{i}, {k}] is {values[i, k]}: expected a finite number, or NaN where none is known")
    used = ~np.isnan(values) if used is None else used & ~np.isnan(values)
    residuals = np.full(values.shape, np.nan)
    fits = []
    for k, (x, y, mask) in enumerate(zip(counts.T.astype(float), values.T, used.T)):
        x, y = x[mask], y[mask]
        if len(x) < MIN_PAIRS or np.ptp(x) == 0:
            raise ValueError(
                f"channel {k} has {len(x)} pairs of {len(np.unique(x))} different counts: expected "
                f"{MIN_PAIRS} or more, and at least 2 different"
            )
        mean_count = x.mean()
        spread = np.sum((x - mean_count) ** 2)
        slope = np.sum((x - mean_count) * y) / spread
        at_zero = y.mean() - slope * mean_count
        residuals[mask, k] = y - at_zero - slope * x
        deviation = np.sqrt(np.nansum(residuals[mask, k] ** 2) / (len(x) - 2))
        error_at_zero = deviation * np.sqrt(1 / len(x) + mean_count**2 / spread)
        fits.append((at_zero, slope, error_at_zero, deviation / np.sqrt(spread)))
    at_zero, slopes, errors_at_zero, errors = np.array(fits).T
    return CalibrationLine(at_zero, slopes, errors_at_zero, errors, residuals)


@checked
def fit_encoders(
    counts: Int[np.ndarray, "pairs channels"], angles: Float[np.ndarray, "pairs channels"]
) -> tuple[Encoders, CalibrationLine]:
    """Fit encoders to recorded pairs of counts and joint angles [rad]; return them with the fitted lines.

    Raises:
        ValueError: as ``fit_line``, and for channels whose angle does not depend on the counts.
    """
    line = fit_line(counts, angles)
    _check_slope(line)
    return Encoders(line.at_zero, line.per_count), line


@checked
def fit_gauges(
    counts: Int[np.ndarray, "pairs channels"],
    tensions: Float[np.ndarray, "pairs channels"],
    arm: Float[np.ndarray, "channels"],
    full: float,
) -> tuple[Gauges, CalibrationLine]:
    """Fit gauges to recorded pairs of counts and tensions [N]; return them with the fitted lines.

    Pairs at ``full`` and beyond, where no gauge is linear, are left out.

    Raises:
        ValueError: as ``fit_line``, and for channels whose tension does not depend on the counts.
    """
    line = fit_line(counts, tensions, (tensions >= 0) & (tensions < full))
    _check_slope(line)
    return Gauges(-line.at_zero / line.per_count, line.per_count, arm, full), line


@checked
def save_sensors(sensors: Sensors, path: str | os.PathLike) -> None:
    """Write sensors to a JSON file; an interrupted write leaves the old file unchanged."""
    encoders, gauges = sensors.encoders, sensors.gauges
    content = {
        "encoders": {"zero": encoders.zero.tolist(), "per_count": encoders.per_count.tolist()},
        "gauges": {name: getattr(gauges, name).tolist() for name in ("zero", "per_count", "arm")}
        | {"full": gauges.full},
    }
    replace_file(Path(path), lambda stream: stream.write((json.dumps(content, indent=1) + "\n").encode()))


@checked
def load_sensors(path: str | os.PathLike, channels: int) -> Sensors:
    """Read sensors from a file that ``save_sensors`` wrote.

    Raises:
        ValueError: for a file that is none of these, or of another number of channels; the message names the key.
        OSError: for a file that cannot be read.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not JSON: {error}") from None
    numbers = {
        (part, key): _read_numbers(content, part, key, channels, path)
        for part, keys in (("encoders", ("zero", "per_count")), ("gauges", ("zero", "per_count", "arm")))
        for key in keys
    }
    encoders = Encoders(numbers["encoders", "zero"], numbers["encoders", "per_count"])
    arm, full = numbers["gauges", "arm"], _read_full_tension(content, path)
    gauges = Gauges(numbers["gauges", "zero"], numbers["gauges", "per_count"], arm, full)
    if np.any(arm < 0):
        raise ValueError(f"{path}: arm of gauges is negative at channel {np.argmax(arm < 0)}: expected a lever [m]")
    for name, slopes in {
        "encoders": encoders.per_count,
        "gauges": gauges.per_count,
        "arm of gauges": gauges.arm,
    }.items():
        if np.any(slopes == 0):
            raise ValueError(f"{path}: {name} has a zero at channel {np.argmin(np.abs(slopes))}: expected none")
    return Sensors(encoders, gauges)


def _read_numbers(content: Any, section: str, key: str, channels: int, path: Path) -> np.ndarray:
    try:
        numbers = content[section][key]
    except (KeyError, TypeError):
        raise ValueError(f"{path} has no list of numbers {section}.{key}") from None
    if not isinstance(numbers, list) or not all(is_number(entry, HUGE) for entry in numbers):
        raise ValueError(f"{path} has no list of numbers {section}.{key}")
    if len(numbers) != channels:
        raise ValueError(f"{path}: {section}.{key} has {len(numbers)} numbers: expected {channels}")
    return np.array(numbers, dtype=float)


def _read_full_tension(content: Any, path: Path) -> float:
    full = content["gauges"].get("full")
    if not (is_number(full, HUGE) and full > 1e-6):
        raise ValueError(f"{path}: gauges.full is {str(full)[:40]}: expected a positive tension [N]")
    return float(full)


def _check_slope(line: CalibrationLine) -> None:
    flat = np.abs(line.per_count) <= 1e-12 * np.nanmax(np.abs(line.residuals) + np.abs(line.at_zero), initial=1e-300)
    if np.any(flat):
        raise ValueError(f"channel {np.argmax(flat)} does not change with its counts: expected a slope other than 0")
