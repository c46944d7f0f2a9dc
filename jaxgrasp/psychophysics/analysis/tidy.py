"""Tidy tables of an experiment: a row for each answer, threshold or person, and a dictionary of the columns."""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from jaxgrasp.psychophysics.analysis.experiment import Analysis, Answers
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.records import TrialRecord
from jaxgrasp.validation.checked import checked

Row = list[str]
INTENSITY = "INTENSITY"
"""Placeholder for the unit of the stimulus."""


class Column(NamedTuple):
    """Column of a table: name, unit, meaning, and the function that reads its value from a row's object."""

    name: str
    unit: str
    meaning: str
    value: Callable[[Any], Any]


def _field(name: str) -> Callable[[TrialRecord], Any]:
    return lambda record: record.get(name)


def _study_answer(question: str) -> Callable[[dict[str, Any]], Any]:
    return lambda person: person["about"].get(question)


def _interval_value(name: str, position: int) -> Callable[[TrialRecord], Any]:
    """Return a function that reads an interval's entry of a field; None for records without the field."""
    return lambda record: (record.get(name) or (None, None))[position]


def _pair(name: str, unit: str, meaning: str, key: str = "") -> list[Column]:
    return [
        Column(f"{name}_{which}", unit, f"{meaning}, of the {which} interval", _interval_value(key or name, position))
        for position, which in enumerate(("first", "second"))
    ]


TRIALS = [
    Column("subject", "", "code of the person", _field("subject")),
    Column("trial", "", "number of the trial, from 1, practice included", _field("number")),
    Column("session", "", "number of the session, from 1", _field("session")),
    Column("series", "", "series or staircase within its session, from 1", _field("series")),
    Column("practice", "", "1 for practice, which no analysis counts", _field("is_practice")),
    Column("task", "", "choice of the stronger of two, or setting of one to match the other", _field("task")),
    Column("condition", "", "condition of the factor within persons; empty where there is none", _field("condition")),
    Column("reference", INTENSITY, "intensity of the reference; 0 in detection", _field("reference")),
    Column("level", "", "comparison less reference by reference; in detection its intensity", _field("level")),
    Column("first", INTENSITY, "intensity asked for in the first interval", _field("first")),
    Column(
        "second", INTENSITY, "intensity asked for in the second interval; of a setting, at its start", _field("second")
    ),
    Column("answer", "", "1 or 2: which interval was said to be stronger", _field("answer")),
    Column("right", "", "1 where that is so", _field("right")),
    Column("setting", INTENSITY, "intensity that was set to match the reference", _field("setting")),
    *_pair("felt", INTENSITY, "the most that was felt"),
    *_pair("whole", "s", "time in which nine tenths of the intensity at least were felt"),
    *_pair("moved", "degrees", "angle by which a joint that feels it moved at most"),
    *_pair("torque", "N.m", "largest joint torque that it asked for"),
    *_pair("duration", "s", "how long it was rendered", "durations"),
    Column("saturated", "", "1 where the device cut a torque", _field("saturated")),
    Column("seconds", "s", "how long the whole trial took, answer included", _field("seconds")),
    Column("at", "", "when it was over, ISO 8601 in UTC", _field("at")),
]
THRESHOLDS = [
    Column("subject", "", "code of the person; all: everybody's answers as if one person's", lambda c: c.subject),
    Column("reference", INTENSITY, "intensity of the reference; 0 in detection", lambda c: c.reference),
    Column("finding", "", "found, or why there is no threshold", lambda c: str(c.threshold.finding)),
    Column("threshold", "", "level at the criterion; in detection an intensity", lambda c: c.threshold.value),
    Column("threshold_low", "", "lower end of its interval", lambda c: c.threshold.low),
    Column(
        "threshold_high",
        "",
        "upper end of its interval; empty where answers do not bound it",
        lambda c: c.threshold.high,
    ),
    Column("coverage", "", "of the interval", lambda c: c.threshold.coverage),
    Column("criterion", "", "hit ratio at the threshold", lambda c: c.threshold.criterion),
    Column("method", "", "how it was found", lambda c: c.threshold.method),
    Column("interval", "", "kind of the interval", lambda c: c.threshold.interval),
    Column("jnd", INTENSITY, "just noticeable difference", lambda c: c.weber and c.weber.jnd),
    Column("jnd_low", INTENSITY, "lower end of its interval", lambda c: c.weber and c.weber.jnd_low),
    Column("jnd_high", INTENSITY, "upper end of its interval", lambda c: c.weber and c.weber.jnd_high),
    Column("trials", "", "answers that count", lambda c: int(c.counts.trials.sum())),
    Column("right", "", "right ones among them", lambda c: int(c.counts.hits.sum())),
    Column("saturated", "", "trials in which the device cut a torque", lambda c: c.saturated),
]
SETTINGS = [
    Column("subject", "", "code of the person", lambda m: m.subject),
    Column("reference", INTENSITY, "intensity of the reference", lambda m: m.reference),
    Column("settings", "", "how many count", lambda m: m.settings),
    Column("error", INTENSITY, "mean setting less the reference: the constant error", lambda m: m.error),
    Column("error_low", INTENSITY, "lower end of its interval", lambda m: m.error_low),
    Column("error_high", INTENSITY, "upper end of its interval", lambda m: m.error_high),
    Column("deviation", INTENSITY, "standard deviation of the settings: the variable error", lambda m: m.deviation),
    Column("deviation_low", INTENSITY, "lower end of its interval", lambda m: m.deviation_low),
    Column("deviation_high", INTENSITY, "upper end of its interval", lambda m: m.deviation_high),
    Column("jnd", INTENSITY, "difference that three of four choices would tell", lambda m: m.jnd),
    Column("saturated", "", "settings in which the device cut a torque", lambda m: m.saturated),
]
PERSONS = [
    Column("subject", "", "code of the person", _field("subject")),
    Column("simulated", "", "1 for an observer who was simulated", _field("simulated")),
    Column("trials", "", "trials on record, practice included", _field("trials")),
    Column("discarded", "", "trials that did not count and were asked again", _field("discarded")),
    Column("resumed", "", "how often the experiment was gone on with after a stop", _field("resumed")),
    Column(
        "consent_at", "", "when the person agreed, ISO 8601 in UTC; empty where nothing was asked", _field("consent_at")
    ),
    Column("begun_at", "", "when it began, ISO 8601 in UTC", _field("begun_at")),
]


@checked
def tidy_tables(answers: Answers, analysis: Analysis) -> dict[str, list[Row]]:
    """Return tables by the names of their files, each with a head: units in brackets, ratios without.

    Args:
        answers: of the experiment.
        analysis: of these answers.
    """
    plan = answers.plan
    question_columns = [
        Column(question, "", "what the person told", _study_answer(question)) for question in plan.study.questions
    ]
    tables: dict[str, tuple[list[Column], Iterable[Any]]] = {
        "trials.csv": (
            TRIALS,
            ({"subject": subject} | record for subject, trials in answers.trials.items() for record in trials),
        ),
        "thresholds.csv": (SETTINGS, analysis.matched)
        if analysis.matched
        else (THRESHOLDS, (*analysis.cells, *analysis.pooled)),
        "persons.csv": ([*PERSONS, *question_columns], (_person(answers, subject) for subject in answers.trials)),
    }
    written = {name: [_head(columns, plan), *_rows(columns, objects)] for name, (columns, objects) in tables.items()}
    dictionary = [["file", "column", "unit", "meaning"]]
    for name, (columns, _) in tables.items():
        dictionary += [[name, _title(column, plan), _unit(column, plan), column.meaning] for column in columns]
    return written | {"dictionary.csv": dictionary}


def _person(answers: Answers, subject: str) -> dict[str, Any]:
    """Return the values of a person's row, from all records of that person."""
    records = answers.other_records.get(subject, [])
    by_type = {
        record_type: [record for record in records if record["record"] == record_type]
        for record_type in {record["record"] for record in records}
    }
    agreed = [record for record in by_type.get("consent", ()) if record.get("agreed")]
    study_answers = by_type.get("about", [{}])[-1].get("answers")
    return {
        "subject": subject,
        "simulated": subject in answers.simulated,
        "trials": len(answers.trials[subject]),
        "discarded": len(by_type.get("discarded", ())),
        "resumed": len(by_type.get("resumed", ())),
        "consent_at": agreed[-1].get("at") if agreed else None,
        "begun_at": by_type.get("begun", [{}])[0].get("at"),
        "about": study_answers if isinstance(study_answers, dict) else {},
    }


def _unit(column: Column, plan: Plan) -> str:
    return plan.stimulus.unit if column.unit == INTENSITY else column.unit


def _title(column: Column, plan: Plan) -> str:
    unit = _unit(column, plan)
    return f"{column.name} [{unit}]" if unit else column.name


def _head(columns: list[Column], plan: Plan) -> Row:
    return [_title(column, plan) for column in columns]


def _rows(columns: list[Column], row_objects: Iterable[Any]) -> Iterable[Row]:
    for row_object in row_objects:
        yield [_cell(column.value(row_object)) for column in columns]


def _cell(value: Any) -> str:
    """Format a value so that every program reads it: an empty cell for no value, 1 and 0 for yes and no."""
    if isinstance(value, bool):
        return str(int(value))
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return repr(float(value)) if isinstance(value, float) else str(value)
