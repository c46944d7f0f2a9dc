"""Thermal model of the motors: the torque limits for moments, and for ever."""

import math

import numpy as np
from jaxtyping import Float

from jaxgrasp.glove.model import GloveModel

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
        margin = np.clip((1 - self._squares / self._continuous**2) / FADING, 0, 1)
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
