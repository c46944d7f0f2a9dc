"""Trials of an experiment: task, level and intensities.

Interface of a stimulus with an intensity, as an experiment uses it.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

Task = Literal["choice", "setting"]
"""Task of a trial: choice of the stronger of two stimuli, or setting of one to match the other."""


@dataclass(frozen=True)
class Presentation:
    """Next presentation of a procedure: level of the comparison, and order of the pair."""

    level: float
    """Level of the comparison: its difference from the reference by the reference, or its intensity where that is zero;
    of a setting, where it starts."""
    comparison_first: bool
    series: int = 0
    """Number of the series within its session, from 0."""


@dataclass(frozen=True)
class Trial:
    """Trial of a person's whole experiment."""

    number: int
    """From 1, practice included."""
    session: int
    """From 1; practice is of the session that follows it."""
    series: int
    is_practice: bool
    task: Task
    reference: float
    level: float
    first: float
    """Intensity of what comes first; of a setting, the reference."""
    second: float
    """Intensity of what comes second; of a setting, where it starts."""
    condition: str = ""
    """Condition of the plan's factor within persons; empty where there is none."""

    @property
    def stronger(self) -> int:
        """Right answer of a choice, 1 or 2."""
        return 1 if self.first > self.second else 2


def intensity(reference: float, level: float) -> float:
    """Compute the intensity of a comparison at a level.

    It is larger than the reference by that share, or the level itself where the reference is zero.
    """
    return reference * (1 + level) if reference > 0 else level


def level_of(reference: float, comparison: float) -> float:
    """Compute the level of a comparison from its intensity; the inverse of ``intensity``."""
    return comparison / reference - 1 if reference > 0 else comparison


@dataclass(frozen=True)
class Rendered:
    """Outcome of the rendering of an intensity."""

    intensity: float
    """Intensity asked for, in the stimulus' unit."""
    felt_intensity: float
    """Largest intensity that was felt, in the same unit; for a prediction, the largest that the device can render."""
    torque: float
    """Largest joint torque that it asks for [N.m]; NaN where it is unknown."""
    saturated: bool
    """True where any torque was cut, so that the trial differs from the plan."""
    max_duration_s: float = math.inf
    """Time for which a glove whose motors are cold can render it [s]."""
    full_intensity_s: float = math.nan
    """Time for which nine tenths of it at least were felt [s]; NaN where it was not measured."""
    motion_deg: float = math.nan
    """Largest angle by which a joint that feels it moved meanwhile [degrees]; NaN where it was not measured."""


class StimulusLostError(OSError):
    """Stimulus that was not felt, or not all the time: the trial does not count, and is to be asked again."""

    def __init__(self, reason: str, rendered: Rendered | None = None) -> None:
        """Create the error of a lost stimulus.

        Args:
            reason: message of the error.
            rendered: outcome of the rendering before the stimulus was lost; None where there is none.
        """
        super().__init__(reason)
        self.rendered = rendered


class NotFeltError(StimulusLostError):
    """Rendered stimulus for which the person did not move enough, or long enough: the trial is to be asked again."""


class Stimulus(ABC):
    """A weight, a stiffness, or a torque that can be felt."""

    @abstractmethod
    def predict(self, intensity: float) -> Rendered:
        """Return the expected outcome of an intensity, without a person."""

    def set_condition(self, condition: str) -> None:
        """Set the condition in which later intensities are rendered; the empty text for the only one.

        Raises:
            ValueError: for a condition that this stimulus cannot render: by default every one but ``force``.
        """
        if condition not in ("", "force"):
            raise ValueError(f"condition is {condition!r}: expected 'force', which alone {type(self).__name__} renders")

    @abstractmethod
    def begin(self, intensity: float) -> None:
        """Begin to render an intensity, in place of the one before.

        Raises:
            StimulusLostError: where it cannot be rendered.
        """

    def is_lost(self) -> bool:
        """Return whether the stimulus that began has been lost meanwhile, so that ``end`` will raise; never waits."""
        return False

    @abstractmethod
    def end(self) -> Rendered:
        """End the stimulus, and return the outcome over all of its time.

        Raises:
            StimulusLostError: where it was not felt all the time.
        """


class PredictedStimulus(Stimulus):
    """Stimulus that nobody can feel: its prediction counts as its outcome."""

    def __init__(self) -> None:
        self._intensity = 0.0

    def set_condition(self, condition: str) -> None:
        """Accept every condition: a simulated observer's noise depends on it, a prediction does not."""

    def begin(self, intensity: float) -> None:
        self._intensity = intensity

    def end(self) -> Rendered:
        return self.predict(self._intensity)


class IdealStimulus(PredictedStimulus):
    """Stimulus that renders every intensity exactly, without a limit."""

    def predict(self, intensity: float) -> Rendered:
        return Rendered(intensity, intensity, float("nan"), False)
