"""Presentation of a trial's two intervals: rendered stimuli, durations, and a check that they were felt."""

import contextlib
import math
import time
from collections.abc import Iterator
from typing import Any

from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.procedures.matching import Matching
from jaxgrasp.psychophysics.running.person import Person
from jaxgrasp.psychophysics.stimulus import NotFeltError, Rendered, Stimulus, StimulusLostError
from jaxgrasp.psychophysics.trial import Trial, intensity


class Intervals:
    """Intervals of a trial, presented once, with a record of them whether or not the trial counts."""

    def __init__(self, plan: Plan, trial: Trial, stimulus: Stimulus, person: Person) -> None:
        """Prepare the intervals of a trial; nothing is rendered yet."""
        self._plan, self._trial, self._stimulus, self._person = plan, trial, stimulus, person
        self._rendered: list[Rendered] = []
        self._durations: list[float] = []

    def present_pair(self) -> tuple[Rendered, Rendered]:
        """Present the two stimuli one after the other, and return what was rendered.

        Raises:
            StimulusLostError: where one was not felt as it should have been.
        """
        first = self._render(1)
        if self._plan.session.pause:
            self._person.pause(self._plan.session.pause)
        return first, self._render(2)

    def adjust_to_match(self) -> float:
        """Present the reference, let the person adjust the comparison, and return its final intensity.

        Raises:
            StimulusLostError: where either was not felt as it should have been.
        """
        procedure = self._plan.procedure
        assert isinstance(procedure, Matching)
        self._render(1)
        trial, level, start_s = self._trial, self._trial.level, time.perf_counter()
        self._stimulus.begin(trial.second)
        shows, setting = "comparison", None
        with self._end_on_error():
            while (move := self._person.adjust(trial, intensity(trial.reference, level))) != "done":
                if move in ("up", "down"):
                    level = max(level + (procedure.step if move == "up" else -procedure.step), -1.0)
                ended = self._stimulus.end()
                setting = ended if shows == "comparison" else setting
                shows = "reference" if move == "reference" else "comparison"
                self._stimulus.begin(trial.reference if shows == "reference" else intensity(trial.reference, level))
        ended = self._stimulus.end()
        # Who says "done" at the reference means what was last felt beside it.
        self._add(ended if shows == "comparison" or setting is None else setting, start_s)
        return intensity(trial.reference, level)

    def record(self) -> dict[str, Any]:
        """Return the fields of the record for the intervals that have ended."""
        return {
            "felt": [_finite_or_none(rendered.felt_intensity) for rendered in self._rendered],
            "torque": [_finite_or_none(rendered.torque) for rendered in self._rendered],
            "saturated": any(rendered.saturated for rendered in self._rendered),
            "whole": [_finite_or_none(rendered.full_intensity_s) for rendered in self._rendered],
            "moved": [_finite_or_none(rendered.motion_deg) for rendered in self._rendered],
            "durations": [round(duration, 3) for duration in self._durations],
        }

    def _render(self, interval: int) -> Rendered:
        """Render the stimulus of interval 1 or 2, and check that it was felt."""
        start_s = time.perf_counter()
        self._stimulus.begin(self._trial.first if interval == 1 else self._trial.second)
        with self._end_on_error():
            self._person.feel(self._trial, interval, self._plan.session.duration)
        try:
            rendered = self._stimulus.end()
        except StimulusLostError as error:
            if error.rendered is not None:
                self._add(error.rendered, start_s)
            raise
        self._add(rendered, start_s)
        self._check(rendered, self._durations[-1])
        return rendered

    def _add(self, rendered: Rendered, start_s: float) -> None:
        self._rendered.append(rendered)
        self._durations.append(time.perf_counter() - start_s)

    def _check(self, rendered: Rendered, duration_s: float) -> None:
        least = self._plan.session
        # An observer who is simulated needs no time, and moves nothing.
        if self._person.observer is not None:
            return
        if duration_s < least.least_interval:
            raise NotFeltError(f"it was felt for {duration_s:.2f} s: take at least {least.least_interval:g} s")
        # What nobody measured is NaN, which is not less.
        if rendered.motion_deg < least.least_movement:
            raise NotFeltError(
                f"the hand moved by {rendered.motion_deg:.1f} degrees: expected at least {least.least_movement:g}"
            )
        if rendered.intensity > 0 and rendered.full_intensity_s < least.least_whole:
            raise NotFeltError(
                f"it was felt at full intensity for {rendered.full_intensity_s:.2f} s: expected at least "
                f"{least.least_whole:g} s"
            )

    @contextlib.contextmanager
    def _end_on_error(self) -> Iterator[None]:
        """End a stimulus where its trial is left by an exception, which is raised even if the stimulus was lost."""
        try:
            yield
        except BaseException:
            with contextlib.suppress(StimulusLostError):
                self._stimulus.end()
            raise


def _finite_or_none(value: float) -> float | None:
    return round(value, 9) if math.isfinite(value) else None
