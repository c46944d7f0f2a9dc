"""Torque limiter before the line, with the motors' thermal model and the log of its latches.

Commands are bounded in size and rate, and are zero after any fault.

Thermal model of the motors: the torque limits for moments, and for ever.

Log of latches: a line of JSON for each latch, with the cause, the time and the last frames.

Each line is an object:

========  ==================================================================================================
key       what it holds
========  ==================================================================================================
time      UTC, as ISO 8601 has it
at        time on the host's clock [s], which the frames' times are on
cause     why torque ended, in words
link      a LinkState, by its name; ``trouble`` why there is none
counts    what host and device had counted by then: frames, faults of the line, the device's last STATUS
turns     turns of the loop by then, its ``overruns``, and the ``worst`` lateness [ms]
frames    the last frames, oldest first: ``at``, ``way`` (``in`` from the device, ``out`` to it), and their fields
========  ==================================================================================================
"""

import json
import math
import os
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.model import GloveModel
from jaxgrasp.validation.checked import checked

FADING = 0.2
"""Part of the warmth that a motor can bear over which its torque fades from the limit to what it holds for ever."""


class MotorThermalModel:
    """Warmth of the windings above their surroundings, as the square of the torque that would hold it for ever.

    A winding warms with the square of its current, and cools by its time constant (a motor's catalogue has both
    numbers). Torque is given up gradually, so that nothing jumps in the hand.
    """

    def __init__(self, model: GloveModel) -> None:
        """Create a model of motors that are cold."""
        self._limits = np.array(model.limits)
        self._continuous = None if model.continuous is None else np.array(model.continuous)
        self._heating = model.heating
        self._squares = np.zeros(len(model.limits))
        self._updated_at = math.inf

    def raise_to(self, channel: int, share: float) -> None:
        """Raise a motor's warmth to a reported share of the warmth that it bears for ever, if the estimate is lower."""
        if self._continuous is not None and 0 <= channel < len(self._squares):
            self._squares[channel] = max(self._squares[channel], share * self._continuous[channel] ** 2)

    def torque_limits(self, timestamp: float, torques: Float[np.ndarray, "channels"]) -> Float[np.ndarray, "channels"]:
        """Compute the largest torque of each channel now [N.m], after ``torques`` [N.m] held since the last call."""
        if self._continuous is None:
            return self._limits
        # T dq/dt = tau^2 - q, solved exactly over the step
        weight = -math.expm1(-max(0.0, timestamp - self._updated_at) / self._heating)
        self._updated_at = timestamp
        self._squares += weight * (torques**2 - self._squares)
        squares = self._continuous**2
        # A channel without a motor never warms.
        ratio = np.divide(self._squares, squares, out=np.zeros(len(squares)), where=squares > 0)
        margin = np.clip((1 - ratio) / FADING, 0, 1)
        return self._continuous + margin * (self._limits - self._continuous)


def holding_time(model: GloveModel, torques: Float[np.ndarray, "*batch channels"]) -> Float[np.ndarray, "*batch"]:
    """Compute how long cold motors hold torques, cut to their limits, before the first fades [s]; inf if none does."""
    if model.continuous is None:
        return np.full(torques.shape[:-1], math.inf)
    limits, continuous = np.array(model.limits), np.array(model.continuous)
    clipped = np.minimum(torques, limits)
    is_fading = clipped > continuous
    margin = np.divide(clipped - continuous, limits - continuous, out=np.zeros(clipped.shape), where=is_fading)
    squares = continuous**2 * (1 - FADING * margin)
    # q(t) = tau^2 (1 - exp(-t / T)) reaches the fading range at t = -T ln(1 - q / tau^2)
    ratio = np.divide(squares, clipped**2, out=np.zeros(clipped.shape), where=is_fading)
    return np.asarray(np.where(is_fading, -model.heating * np.log1p(-ratio), math.inf).min(-1))


Projection = Literal["clip", "scale"]
HUGE = 1e9


class GuardState(IntEnum):
    """State of a guard. The codes are stable in files."""

    DISARMED = 0
    """No torque leaves: the guard was never armed, or was disarmed."""
    ARMED = 1
    """The requested torques leave, within bounds."""
    LATCHED = 2
    """No torque leaves after a fault, until the guard is armed again."""


@dataclass(frozen=True, eq=False)
class GuardOutput:
    """Torques that leave at one step, and the parts that were cut; arrays ``(channels,)``."""

    state: GuardState
    counts: np.ndarray
    """Torques that leave, in counts as they go over the wire, 16 bits."""
    torques: np.ndarray
    """Torques that leave [N.m]."""
    assisting: np.ndarray
    """Requested torques that would flex the finger [N.m]; zero or more."""
    beyond: np.ndarray
    """Requested torques beyond the limit, or given up to keep the direction [N.m]; zero or more."""
    held_back: np.ndarray
    """Allowed torque minus the torque after scale, ramp and rate limit [N.m]; negative where a torque has yet to
    fall."""

    @property
    def is_clipped(self) -> bool:
        """True if the limit or the sign cut a torque: an experiment must be able to discard such a trial."""
        return bool(np.any(self.beyond > 0) or np.any(self.assisting > 0))


class Guard:
    """Torque limiter of a glove: 0 <= torque <= limit, bounded rate of change, ramp after arming.

    Where motors are warm, the limit is what they can hold for ever.

    Anything that is not a finite number for each channel, a clock that runs backwards, a reading that is too old: all
    become zero at once, and stay so until ``arm`` is called. ``step`` raises nothing.
    """

    def __init__(
        self,
        model: GloveModel,
        *,
        projection: Projection = "clip",
        scale: float = 1.0,
        ramp: float = 2.0,
        oldest: float = 0.05,
        longest: float = 0.02,
    ):
        """Create a guard that is not armed.

        Args:
            model: the glove.
            projection: ``"clip"`` each channel at its limit; ``"scale"`` all together, so that their direction stays.
            scale: of all torques, from 0 to 1: 0.05 for the first time with power on.
            ramp: time from arming until the whole scale is reached [s].
            oldest: age of a reading beyond which it says nothing [s].
            longest: time that a step counts as at most [s], so that none can jump after a pause.

        Raises:
            ValueError: for another projection, or numbers that are not in their ranges.
        """
        if projection not in ("clip", "scale"):
            raise ValueError(f"projection is {projection!r}: expected 'clip' or 'scale'")
        for name, value in {"ramp": ramp, "oldest": oldest, "longest": longest}.items():
            if not (isinstance(value, int | float) and np.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value}: expected a positive time [s]")
        self.model = model
        self.state = GuardState.DISARMED
        self.cause = ""
        """Reason for the latch."""
        self._projection, self._ramp = projection, ramp
        self._max_age, self._max_dt = oldest, longest
        self._limits, self._max_counts = np.array(model.limits), np.array(model.max_counts)
        self._thermal_model = MotorThermalModel(model)
        self._level = np.zeros(len(model.joints))
        self._armed_at = self._stepped_at = -np.inf
        self.rescale(scale)

    def rescale(self, scale: float) -> None:
        """Set the scale of all torques, 0 to 1, from the next arming on.

        Raises:
            ValueError: for another number, and while it is armed.
        """
        if not (isinstance(scale, int | float) and 0 <= scale <= 1):
            raise ValueError(f"scale is {scale}: expected 0 to 1")
        if self.state == GuardState.ARMED:
            raise ValueError("the scale cannot change while the guard is armed: disarm it first")
        self._scale = scale

    def arm(self, timestamp: float) -> None:
        """Let torques through from a time on [s], ramped up from zero; clear the cause of the last latch."""
        if not np.isfinite(timestamp):
            raise ValueError(f"timestamp is {timestamp}: expected a finite time [s]")
        self.state, self.cause = GuardState.ARMED, ""
        self._level[:] = 0
        self._armed_at = self._stepped_at = timestamp

    def disarm(self) -> None:
        """Set the output to zero from the next step on; a latched guard stays latched."""
        if self.state == GuardState.ARMED:
            self.state = GuardState.DISARMED
        self._level[:] = 0

    def trip(self, cause: str) -> None:
        """Latch an armed guard with this cause: the output is zero until it is armed again; the first cause is kept."""
        if self.state == GuardState.ARMED:
            self.state, self.cause = GuardState.LATCHED, cause
        self._level[:] = 0

    def learn_warmth(self, channel: int, share: float) -> None:
        """Raise a motor's estimated warmth to the device's report, a share of the warmth that it bears for ever."""
        self._thermal_model.raise_to(channel, share)

    def stop(self, cause: str) -> None:
        """Latch the guard in any state with this cause: emergency stop, the output is zero."""
        self.state, self.cause = GuardState.LATCHED, cause
        self._level[:] = 0

    def step(self, timestamp: float, requested: Any, measured_at: float) -> GuardOutput:
        """Compute the torques that may leave now from the requested torques.

        Args:
            timestamp: on a clock that never runs backwards [s].
            requested: torques by which to resist flexion ``(channels,)`` [N.m].
            measured_at: when the angles were read that these torques answer [s], on the same clock.
        """
        request = self._checked_request(timestamp, requested, measured_at)
        dt = min(timestamp - self._stepped_at, self._max_dt) if self.state == GuardState.ARMED else 0.0
        if self.state != GuardState.ARMED:
            zeros = np.zeros(len(self._limits))
            return GuardOutput(self.state, zeros.astype(np.int16), zeros, zeros, zeros, zeros)
        self._stepped_at = timestamp
        # A channel without a motor is asked for nothing: what it lacks is not cut.
        request = np.where(self._limits > 0, request, 0.0)
        resisting = np.maximum(request, 0)
        allowed = self._projected(resisting, self._thermal_model.torque_limits(timestamp, self._level))
        target = allowed * self._scale * min(1.0, (timestamp - self._armed_at) / self._ramp)
        max_change = self.model.rate * dt
        # |d tau| <= rate dt
        self._level += np.clip(target - self._level, -max_change, max_change)
        # Down, so that no count exceeds its level; and no rounding of the level may exceed the limit.
        counts = np.clip(np.floor(self._level / self.model.quantum), 0, self._max_counts).astype(np.int16)
        torques = counts * self.model.quantum
        return GuardOutput(self.state, counts, torques, resisting - request, resisting - allowed, allowed - self._level)

    def _checked_request(self, timestamp: float, requested: Any, measured_at: float) -> np.ndarray:
        """Convert the request to a float array ``(channels,)`` [N.m]; on invalid input, trip and return zeros."""
        zeros = np.zeros(len(self._limits))
        try:
            array, timestamp, measured_at = np.asarray(requested), float(timestamp), float(measured_at)
        except (TypeError, ValueError, OverflowError):
            array = np.asarray(None)
        if array.dtype.kind not in "fiu":
            self.trip("the requested torques are not an array of numbers")
            return zeros
        request = array.astype(float)
        # A comparison with NaN is false: each condition says what must hold.
        for is_satisfied, cause in (
            (
                timestamp >= self._stepped_at and np.isfinite(timestamp),
                f"the clock ran backwards or is not finite: {timestamp} after {self._stepped_at}",
            ),
            (request.shape == zeros.shape, f"torques have shape {request.shape}: expected {zeros.shape}"),
            (bool(np.all(np.isfinite(request))), "a torque is not finite"),
            (
                0 <= timestamp - measured_at <= self._max_age,
                f"the angles were read {timestamp - measured_at:.3g} s ago",
            ),
        ):
            if not is_satisfied:
                self.trip(cause)
                return zeros
        return request

    def _projected(self, resisting: np.ndarray, limits: np.ndarray) -> np.ndarray:
        if self._projection == "clip":
            return np.minimum(resisting, limits)
        # No finite number may overflow on its way.
        ratios = np.divide(
            np.minimum(resisting, HUGE * limits), limits, out=np.zeros(len(limits)), where=self._limits > 0
        )
        largest_ratio = float(np.max(ratios))
        return np.minimum(resisting / max(largest_ratio, 1.0), limits)


def append_latch(path: str | os.PathLike, record: dict[str, Any]) -> None:
    """Append a record as one line of JSON, in a single write; a line that was cut before is ended first.

    Raises:
        OSError: where it cannot be written.
    """
    line = json.dumps({"time": datetime.now(UTC).isoformat(timespec="milliseconds"), **record})
    with open(path, "a+b", buffering=0) as file:
        is_cut = file.seek(0, os.SEEK_END) > 0
        if is_cut:
            file.seek(-1, os.SEEK_END)
            is_cut = file.read(1) != b"\n"
        file.write(b"\n" * is_cut + line.encode() + b"\n")


def check_latch_log(path: str | os.PathLike) -> None:
    """Check that the log can be opened for writing.

    Raises:
        OSError: where it cannot.
    """
    open(path, "ab").close()


@checked
def read_latches(path: str | os.PathLike) -> list[dict[str, Any]]:
    """Read the records of a log, oldest first; an incomplete line of a host that died is skipped.

    Raises:
        ValueError: for a whole line that is no record.
        OSError: for a file that cannot be read.
    """
    with open(path, encoding="utf-8") as file:
        lines = file.read().split("\n")
    records = []
    for number, line in enumerate(lines, 1):
        try:
            record = json.loads(line) if line else None
        except ValueError:
            # Cut at the end, or where another host went on after it.
            continue
        if record is None:
            continue
        if not (isinstance(record, dict) and isinstance(record.get("cause"), str) and "time" in record):
            raise ValueError(f"{path} line {number} is {line[:40]!r}: expected the record of a latch")
        records.append(record)
    return records
