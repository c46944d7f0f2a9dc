"""Run of a person's trials, one after another, from the end of the records on.

Presentation of a trial's two intervals: rendered stimuli, durations, and a check that they were felt.
"""

import contextlib
import datetime
import importlib.metadata
import math
import os
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jaxgrasp.psychophysics.person import Person
from jaxgrasp.psychophysics.plan import Plan, hint, instructions
from jaxgrasp.psychophysics.procedures import Matching
from jaxgrasp.psychophysics.records import (
    FORMAT,
    SUFFIX,
    Journal,
    TrialRecord,
    check_other,
    check_plan,
    read_records,
    replay,
    subjects,
)
from jaxgrasp.psychophysics.schedule import Schedule
from jaxgrasp.psychophysics.trial import NotFeltError, Rendered, Stimulus, StimulusLostError, Trial, intensity, level_of
from jaxgrasp.validation.checked import checked

LET_GO = "the glove let go; wait until it is armed again"
"""Reason that a person is told where a stimulus was lost."""


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
        self._stimulus.set_condition(self._trial.condition)
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


EVERYONE = "all"
"""Code of all persons' answers together in an analysis."""
LONGEST_ANSWER = 200
"""Characters that are kept of an answer to a question of the study."""
CODE = re.compile(r"[A-Za-z0-9_-]{1,32}")


class NoConsentError(ValueError):
    """A person who does not agree to what the study asks; the experiment is over."""


@checked
def run_experiment(
    plan: Plan,
    subject: str,
    folder: str | os.PathLike,
    stimulus: Stimulus,
    person: Person,
    *,
    resume: bool = False,
    recorded: Callable[[TrialRecord], None] = lambda record: None,
    lost: Callable[[StimulusLostError], None] | None = None,
) -> int:
    """Ask all that the plan asks of a person; what is on record is not asked again.

    Args:
        plan: of the experiment.
        subject: code of the person: letters, digits, ``-`` and ``_``; no name.
        folder: for the records, a file for each person.
        stimulus: renders intensities.
        person: who answers.
        resume: go on where the records of this person end; begin where there are none.
        recorded: called with the record of each trial once it is on disk.
        lost: called where a stimulus was not felt as it should have been; when it returns, that trial is asked again.
            Without one the error is raised.

    Returns:
        How many trials are on record.

    Raises:
        ValueError: for a code that is none, records of this person without ``resume``, or a condition that the
            stimulus cannot render.
        RecordError: for records that cannot be read, or that another plan made.
        NoConsentError: where the person does not agree to what the plan's study asks.
        StimulusLostError: where a stimulus was not felt as it should have been; on record is that the trial was
            discarded, and why.
        OSError: for records that cannot be written.
    """
    folder = Path(folder)
    path = check_records(plan, subject, folder, resume=resume, observer=person.observer)
    exists = path.exists()
    folder.mkdir(parents=True, exist_ok=True)
    person.is_lost = stimulus.is_lost
    # What cannot be rendered is refused before the first question.
    for condition in plan.within.conditions:
        stimulus.set_condition(condition)
    with Journal(path, _first_record(plan, subject, person.observer)) as journal:
        schedule = Schedule(plan, subject)
        check_plan(journal.records, plan, person.observer, path)
        n_done = len(replay(schedule, subject, journal.records, path))
        if exists:
            journal.append({"record": "resumed", "at": _timestamp(), "trials": n_done})
        if schedule.next() is not None:
            if person.observer is None:
                _ask_consent_and_questions(plan, person, journal)
            person.show_instructions(instructions(plan))
        while (trial := schedule.next()) is not None:
            if (
                n_done
                and n_done > plan.session.practice
                and (n_done - plan.session.practice) % plan.session.break_every == 0
            ):
                person.take_break(n_done, plan.most_trials())
            score, record = _present_until_felt(trial, plan, stimulus, person, journal, lost)
            journal.append(record)
            schedule.score(score)
            n_done += 1
            recorded(record)
            if trial.task == "choice" and (plan.session.feedback or trial.is_practice):
                person.show_outcome(trial, record["right"])
        return n_done


def _ask_consent_and_questions(plan: Plan, person: Person, journal: Journal) -> None:
    """Ask for a person's consent and the answers to the study's questions, once for all sessions.

    Raises:
        NoConsentError: where the person does not agree; that is on record.
    """
    study, record_types = plan.study, {record["record"] for record in journal.records if record.get("agreed", True)}
    if study.consent and "consent" not in record_types:
        agreed = person.ask_consent(study.consent)
        journal.append({"record": "consent", "agreed": agreed, "at": _timestamp()})
        if not agreed:
            raise NoConsentError("the person did not agree: nothing was asked")
    if study.questions and "about" not in record_types:
        about = {question: person.ask_question(question)[:LONGEST_ANSWER] for question in study.questions}
        journal.append({"record": "about", "answers": about, "at": _timestamp()})


def check_records(plan: Plan, subject: str, folder: Path, *, resume: bool, observer: dict[str, float] | None) -> Path:
    """Return the path of a person's records, after a check that they do not exist or can be continued.

    Raises:
        ValueError: for a code that is none, or records of this person without ``resume``.
        RecordError: for records that cannot be read, or that another plan made.
    """
    if not CODE.fullmatch(subject):
        raise ValueError(f"subject is {subject!r}: expected a code of letters, digits, - and _, and no name")
    if subject == EVERYONE:
        raise ValueError(f"subject is {subject!r}, which stands for all persons together: expected another code")
    schedule = Schedule(plan, subject)
    for other_path in subjects(folder):
        check_other(other_path, plan)
    path = folder / f"{subject}{SUFFIX}"
    if path.exists():
        if not resume:
            raise ValueError(f"{path} already exists: add --resume to continue it, or take another code")
        records = read_records(path)[0]
        check_plan(records, plan, observer, path)
        replay(schedule, subject, records, path)
    return path


def _present_until_felt(
    trial: Trial,
    plan: Plan,
    stimulus: Stimulus,
    person: Person,
    journal: Journal,
    lost: Callable[[StimulusLostError], None] | None,
) -> tuple[float, dict[str, Any]]:
    """Repeat ``_present`` until a trial counts; each trial that does not count has a record of its own."""
    while True:
        start_s, intervals = time.perf_counter(), Intervals(plan, trial, stimulus, person)
        try:
            return _present(trial, plan, intervals, person)
        except StimulusLostError as error:
            discard = {"cause": str(error), "seconds": round(time.perf_counter() - start_s, 3), "at": _timestamp()}
            journal.append({"record": "discarded", **asdict(trial), **intervals.record(), **discard})
            if lost is None:
                raise
            # The person first: whoever arms the glove again may take a while.
            person.announce_repeat(f"{error}.\n{hint(plan)}" if isinstance(error, NotFeltError) else LET_GO)
            lost(error)


def _present(trial: Trial, plan: Plan, intervals: Intervals, person: Person) -> tuple[float, dict[str, Any]]:
    """Present a trial, and return its score and its record."""
    start_s = time.perf_counter()
    if plan.session.duration:
        person.wait_until_ready(trial)
    if trial.task == "setting":
        setting = intervals.adjust_to_match()
        score = level_of(trial.reference, setting)
        answer: dict[str, Any] = {"setting": setting}
    else:
        choice = person.choose(trial, intervals.present_pair())
        if choice not in (1, 2):
            raise ValueError(f"the answer is {choice!r}: expected 1 or 2")
        score = float(choice == trial.stronger)
        answer = {"answer": choice, "right": bool(score)}
    seconds = {"seconds": round(time.perf_counter() - start_s, 3), "at": _timestamp()}
    return score, {"record": "trial", **asdict(trial), **answer, **intervals.record(), **seconds}


def _first_record(plan: Plan, subject: str, observer: dict[str, float] | None) -> dict[str, Any]:
    version = importlib.metadata.version("jaxgrasp")
    head = {"record": "begun", "format": FORMAT, "subject": subject, "observer": observer, "software": version}
    head |= {"at": _timestamp()}
    return {**head, "plan": plan.table()}


def _timestamp() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
