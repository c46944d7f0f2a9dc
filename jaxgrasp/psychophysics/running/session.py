"""A person's trials, one after another, from wherever the records end."""

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

from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.procedures.matching import Matching
from jaxgrasp.psychophysics.running.person import Person
from jaxgrasp.psychophysics.running.recorded_trials import check_other, check_plan, replay
from jaxgrasp.psychophysics.running.records import FORMAT, SUFFIX, Journal, read_records, subjects
from jaxgrasp.psychophysics.schedule import Schedule
from jaxgrasp.psychophysics.stimulus import NotFeltError, Rendered, Stimulus, StimulusLostError
from jaxgrasp.psychophysics.trial import Trial, intensity, level_of
from jaxgrasp.validation.checked import checked

EVERYONE = "all"
"""Stands for all persons' answers together, where these are analysed."""
CODE = re.compile(r"[A-Za-z0-9_-]{1,32}")


@checked
def run_experiment(
    plan: Plan,
    subject: str,
    folder: str | os.PathLike,
    stimulus: Stimulus,
    person: Person,
    *,
    resume: bool = False,
    recorded: Callable[[Trial], None] = lambda trial: None,
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
        recorded: called with each trial once it is on disk.
        lost: called where a stimulus was not felt as it should have been; when it returns, that trial is asked again.
            Without one the error is raised.

    Returns:
        How many trials are on record.

    Raises:
        ValueError: for a code that is none, or records of this person without ``resume``.
        RecordError: for records that cannot be read, or that another plan made.
        StimulusLostError: where a stimulus was not felt as it should have been; on record is that the trial was
            discarded, and why.
        OSError: for records that cannot be written.
    """
    folder = Path(folder)
    path = check_records(plan, subject, folder, resume=resume, observer=person.observer)
    there = path.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with Journal(path, _begun(plan, subject, person.observer)) as journal:
        schedule = Schedule(plan, subject)
        check_plan(journal.records, plan, person.observer, path)
        done = len(replay(schedule, subject, journal.records, path))
        if there:
            journal.append({"record": "resumed", "at": _now(), "trials": done})
        while (trial := schedule.next()) is not None:
            if done and done > plan.session.practice and (done - plan.session.practice) % plan.session.break_every == 0:
                person.rest(done, plan.most_trials())
            score, record = _asked_until_felt(trial, plan, stimulus, person, journal, lost)
            journal.append(record)
            schedule.score(score)
            done += 1
            recorded(trial)
            if trial.task == "choice" and (plan.session.feedback or trial.is_practice):
                person.told(trial, record["right"])
        return done


def check_records(plan: Plan, subject: str, folder: Path, *, resume: bool, observer: dict[str, float] | None) -> Path:
    """The file of a person's records, which are not there, or can be gone on with.

    Raises:
        ValueError: for a code that is none, or records of this person without ``resume``.
        RecordError: for records that cannot be read, or that another plan made.
    """
    if not CODE.fullmatch(subject):
        raise ValueError(f"subject is {subject!r}: expected a code of letters, digits, - and _, and no name")
    if subject == EVERYONE:
        raise ValueError(f"subject is {subject!r}, which stands for all persons together: expected another code")
    for other in subjects(folder):
        check_other(other, plan)
    path = folder / f"{subject}{SUFFIX}"
    if path.exists():
        if not resume:
            raise ValueError(f"{path} is there already: --resume goes on with it; or take another code")
        records = read_records(path)[0]
        check_plan(records, plan, observer, path)
        replay(Schedule(plan, subject), subject, records, path)
    return path


def _asked_until_felt(
    trial: Trial,
    plan: Plan,
    stimulus: Stimulus,
    person: Person,
    journal: Journal,
    lost: Callable[[StimulusLostError], None] | None,
) -> tuple[float, dict[str, Any]]:
    """As ``_asked``; each time that does not count has a record of its own."""
    while True:
        begun = time.perf_counter()
        try:
            return _asked(trial, plan, stimulus, person)
        except StimulusLostError as error:
            seconds = round(time.perf_counter() - begun, 3)
            journal.append(
                {"record": "discarded", **asdict(trial), "cause": str(error), "seconds": seconds, "at": _now()}
            )
            if lost is None:
                raise
            lost(error)


def _asked(trial: Trial, plan: Plan, stimulus: Stimulus, person: Person) -> tuple[float, dict[str, Any]]:
    """Present a trial, and what came of it: its score and its record."""
    begun = time.perf_counter()
    if trial.task == "setting":
        setting, rendered, durations = _setting(trial, plan, stimulus, person)
        score = level_of(trial.reference, setting)
        answer: dict[str, Any] = {"setting": setting}
    else:
        # An observer who is simulated needs no time.
        least = plan.session.least_interval if person.observer is None else 0.0
        intervals = _felt(trial, 1, stimulus, person, least), _felt(trial, 2, stimulus, person, least)
        rendered, durations = (intervals[0][0], intervals[1][0]), (intervals[0][1], intervals[1][1])
        choice = person.choose(trial, rendered)
        if choice not in (1, 2):
            raise ValueError(f"the answer is {choice!r}: expected 1 or 2")
        score = float(choice == trial.stronger)
        answer = {"answer": choice, "right": bool(score)}
    record = {
        "record": "trial",
        **asdict(trial),
        **answer,
        "felt": [_known(one.felt) for one in rendered],
        "torque": [_known(one.torque) for one in rendered],
        "saturated": any(one.saturated for one in rendered),
        "durations": [round(one, 3) for one in durations],
        "seconds": round(time.perf_counter() - begun, 3),
        "at": _now(),
    }
    return score, record


def _felt(
    trial: Trial, interval: int, stimulus: Stimulus, person: Person, least: float = 0.0
) -> tuple[Rendered, float]:
    """What came of one interval, and how long it was felt [s]: ``least`` at least, or it does not count."""
    begun = time.perf_counter()
    stimulus.begin(trial.first if interval == 1 else trial.second)
    with _let_go_of(stimulus):
        person.feel(trial, interval)
    rendered, lasted = stimulus.end(), time.perf_counter() - begun
    if lasted < least:
        raise NotFeltError(f"it was felt for {lasted:.2f} s: take {least:g} s at least")
    return rendered, lasted


@contextlib.contextmanager
def _let_go_of(stimulus: Stimulus) -> Iterator[None]:
    """End a stimulus where its trial is left by an exception, which is raised even if the stimulus was lost."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(StimulusLostError):
            stimulus.end()
        raise


def _setting(
    trial: Trial, plan: Plan, stimulus: Stimulus, person: Person
) -> tuple[float, tuple[Rendered, Rendered], tuple[float, float]]:
    """What a person adjusts; how reference and final setting were rendered, and how long all of each took [s]."""
    settings = plan.procedure
    assert isinstance(settings, Matching)
    reference, first = _felt(trial, 1, stimulus, person)
    level, begun = trial.level, time.perf_counter()
    stimulus.begin(trial.second)
    shows, setting = "comparison", None
    with _let_go_of(stimulus):
        while (move := person.adjust(trial, intensity(trial.reference, level))) != "done":
            if move in ("up", "down"):
                level = max(level + (settings.step if move == "up" else -settings.step), -1.0)
            ended = stimulus.end()
            setting = ended if shows == "comparison" else setting
            shows = "reference" if move == "reference" else "comparison"
            stimulus.begin(trial.reference if shows == "reference" else intensity(trial.reference, level))
    ended = stimulus.end()
    # Who says "done" at the reference means what was last felt beside it.
    setting = ended if shows == "comparison" or setting is None else setting
    return intensity(trial.reference, level), (reference, setting), (first, time.perf_counter() - begun)


def _begun(plan: Plan, subject: str, observer: dict[str, float] | None) -> dict[str, Any]:
    version = importlib.metadata.version("jaxgrasp")
    head = {"record": "begun", "format": FORMAT, "subject": subject, "observer": observer, "software": version}
    head |= {"at": _now()}
    return {**head, "plan": plan.table()}


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
