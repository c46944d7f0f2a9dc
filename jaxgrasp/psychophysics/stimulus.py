"""The stimulus as an experiment sees it: something with an intensity, rendered by whoever implements this."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass


@dataclass(frozen=True)
class Rendered:
    """What came of an intensity."""

    intensity: float
    """Intensity asked for, in the stimulus' unit."""
    felt: float
    """The most of it that was felt, in the same unit; of a prediction, what the device could render."""
    torque: float
    """Largest joint torque that it asks for [N.m]; NaN where nobody knows."""
    saturated: bool
    """Whether any torque was cut: the trial is not what the plan says."""
    lasts: float = math.inf
    """How long a glove whose motors are cold renders it so [s]."""
    whole: float = math.nan
    """Time for which nine tenths of it at least were felt [s]; NaN where nobody measured."""
    moved: float = math.nan
    """Angle by which that joint moved meanwhile which moved most, of those that feel it [degrees]; NaN likewise."""


class StimulusLostError(OSError):
    """What was to be felt was not, or not all the time: the trial does not count, and is to be asked again."""

    def __init__(self, why: str, rendered: Rendered | None = None) -> None:
        """``rendered``: what came of it before it was lost, where anything did."""
        super().__init__(why)
        self.rendered = rendered


class NotFeltError(StimulusLostError):
    """There was something to be felt, and a person did not do what it takes: it is to be asked again."""


class Stimulus(ABC):
    """A weight, a stiffness, or a torque that can be felt."""

    @abstractmethod
    def predict(self, intensity: float) -> Rendered:
        """What would come of an intensity, without a person."""

    @abstractmethod
    def begin(self, intensity: float) -> None:
        """Let it be felt, from now on, in place of what was before.

        Raises:
            StimulusLostError: where it cannot be.
        """

    @abstractmethod
    def end(self) -> Rendered:
        """Let it end; what came of it, over all of its time.

        Raises:
            StimulusLostError: where it was not felt all the time.
        """


class PredictedStimulus(Stimulus):
    """Nothing that can be felt: what is predicted counts as what came of it."""

    def __init__(self) -> None:
        self._intensity = 0.0

    def begin(self, intensity: float) -> None:
        self._intensity = intensity

    def end(self) -> Rendered:
        return self.predict(self._intensity)


class IdealStimulus(PredictedStimulus):
    """Whatever is asked for, without a limit."""

    def predict(self, intensity: float) -> Rendered:
        return Rendered(intensity, intensity, float("nan"), False)
