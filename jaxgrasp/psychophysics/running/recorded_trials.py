"""Recorded trials of a person, checked by a replay of the plan, so that no other records are taken for them."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from jaxgrasp.files.file_numbers import is_number
from jaxgrasp.files.printable import shortened
from jaxgrasp.psychophysics.plan import Plan, plan_of
from jaxgrasp.psychophysics.running.records import FORMAT, RecordError, read_records
from jaxgrasp.psychophysics.schedule import Schedule
from jaxgrasp.psychophysics.trial import Trial, level_of

TrialRecord = dict[str, Any]


def experiment_of(records: list[dict[str, Any]], path: Path) -> tuple[Plan, dict[str, float] | None, list[TrialRecord]]:
    """Return the plan in a person's records, the parameters of a simulated observer or None, and the checked trials.

    Raises:
        RecordError: for records that the plan does not lead to; the message names the trial and the field.
    """
    if not records:
        raise RecordError(f"{path} has no first record of an experiment")
    plan = _plan(records[0], path)
    return plan, _observer(records[0], path), replay(Schedule(plan, path.stem), path.stem, records, path)


def replay(schedule: Schedule, subject: str, records: list[dict[str, Any]], path: Path) -> list[TrialRecord]:
    """Advance a schedule to the end of the records, and return their trials, which must be those of the schedule."""
    if not records:
        return []
    if records[0].get("subject") != subject:
        raise RecordError(f"{path} is of subject {records[0].get('subject')!r}: expected {subject!r}")
    trials = [record for record in records if record["record"] == "trial"]
    for record in trials:
        trial = schedule.next()
        if trial is None:
            raise RecordError(f"{path} has more trials than the plan")
        for name, value in asdict(trial).items():
            if record.get(name) != value:
                raise RecordError(
                    f"{path}, trial {trial.number}: {name} is {record.get(name)!r}, and the plan leads to {value!r}"
                )
        schedule.score(_score(trial, record, path))
    return trials


def check_plan(records: list[dict[str, Any]], plan: Plan, observer: dict[str, float] | None, path: Path) -> None:
    """Raise RecordError unless a file was begun with this plan, and by a person or this observer alike."""
    if not records:
        return
    _check_same(_plan(records[0], path), plan, path)
    recorded_observer = _observer(records[0], path)
    if recorded_observer != observer:
        names = [
            "a person" if origin is None else f"a simulated observer, {origin}"
            for origin in (recorded_observer, observer)
        ]
        raise RecordError(f"{path} was begun by {names[0]}, and now it is {names[1]}")


def check_other(path: Path, plan: Plan) -> None:
    """Raise RecordError where another person's file was begun with another plan: an experiment has one."""
    records = read_records(path)[0]
    if records:
        _check_same(_plan(records[0], path), plan, path)


def _check_same(recorded_plan: Plan, current_plan: Plan, path: Path) -> None:
    recorded_table = recorded_plan.table()
    for key, value in current_plan.table().items():
        if recorded_table[key] != value:
            raise RecordError(
                f"{path} was begun with another plan: {key} was {recorded_table[key]!r}, and now is {value!r}"
            )


def _plan(first: dict[str, Any], path: Path) -> Plan:
    if first["record"] != "begun":
        raise RecordError(f"{path} has no first record of an experiment")
    if first.get("format") != FORMAT:
        raise RecordError(f"{path} has format {first.get('format')!r}: expected {FORMAT}")
    if not (isinstance(first.get("plan"), dict) and isinstance(first.get("observer", 0), dict | None)):
        raise RecordError(f"{path} has no plan in its first record")
    try:
        return plan_of(first["plan"], "plan")
    except ValueError as error:
        raise RecordError(f"{path}: {error}") from None


def _observer(first: dict[str, Any], path: Path) -> dict[str, float] | None:
    """Return the parameters of the simulated observer, or None, from a first record that ``_plan`` accepted."""
    parameters = first["observer"]
    for name, value in (parameters or {}).items():
        if not is_number(value):
            raise RecordError(f"{path}: observer.{name} is {shortened(value)}: expected a number")
    return None if parameters is None else {name: float(value) for name, value in parameters.items()}


def _score(trial: Trial, record: TrialRecord, path: Path) -> float:
    """Return the score of a recorded answer, after a check of its fields."""
    label = f"{path}, trial {trial.number}"
    if not isinstance(record.get("saturated"), bool):
        raise RecordError(f"{label}: saturated is {record.get('saturated')!r}: expected true or false")
    # Earlier records have neither of the last two.
    for name in ("felt", "torque", "durations", *(name for name in ("whole", "moved") if name in record)):
        if not _is_pair(record.get(name)):
            raise RecordError(f"{label}: {name} is {record.get(name)!r}: expected two numbers")
    if trial.task == "setting":
        setting = record.get("setting")
        if setting is None or not is_number(setting) or setting < 0:
            raise RecordError(f"{label}: setting is {setting!r}: expected a number, 0 or more")
        return level_of(trial.reference, setting)
    answer, right = record.get("answer"), record.get("right")
    if answer not in (1, 2) or isinstance(answer, bool):
        raise RecordError(f"{label}: answer is {answer!r}: expected 1 or 2")
    if right is not (answer == trial.stronger):
        raise RecordError(
            f"{label}: right is {right!r}, and the answer was {answer} of which {trial.stronger} is right"
        )
    return float(right)


def _is_pair(value: Any) -> bool:
    """Tell whether a value is a list of two numbers, of which either may be None."""
    return isinstance(value, list) and len(value) == 2 and all(number is None or is_number(number) for number in value)


def felt_levels(trials: Iterable[TrialRecord]) -> list[float]:
    """Compute the relative differences of the felt intensities of each trial, where both are known."""
    differences = []
    for trial in trials:
        first, second = trial["felt"]
        if first is not None and second is not None and min(first, second) > 0:
            differences.append(max(first, second) / min(first, second) - 1)
    return differences
