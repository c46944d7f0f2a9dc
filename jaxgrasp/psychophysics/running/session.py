"""Run of a person's trials, one after another, from the end of the records on."""

import datetime
import importlib.metadata
import os
import re
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jaxgrasp.psychophysics.instructions import hint, instructions
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.running.intervals import Intervals
from jaxgrasp.psychophysics.running.person import Person
from jaxgrasp.psychophysics.running.recorded_trials import TrialRecord, check_other, check_plan, replay
from jaxgrasp.psychophysics.running.records import FORMAT, SUFFIX, Journal, read_records, subjects
from jaxgrasp.psychophysics.schedule import Schedule
from jaxgrasp.psychophysics.stimulus import NotFeltError, Stimulus, StimulusLostError
from jaxgrasp.psychophysics.trial import Trial, level_of
from jaxgrasp.validation.checked import checked

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
        ValueError: for a code that is none, or records of this person without ``resume``.
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
            lost(error)
            person.announce_repeat(f"{error}.\n{hint(plan)}" if isinstance(error, NotFeltError) else "the glove let go")


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
