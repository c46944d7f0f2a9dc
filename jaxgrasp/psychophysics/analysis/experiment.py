"""Analysis of an experiment: each person, all persons together, and differences between references."""

import os
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from jaxgrasp.psychophysics.analysis.cell import (
    AnalysisSettings,
    Cell,
    cell_of,
    suited_criterion,
    suited_lapse,
    suited_shape,
)
from jaxgrasp.psychophysics.analysis.comparison import Comparison, Group, comparison_of, group_of, line_of
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.matched_settings import Matched, matched
from jaxgrasp.psychophysics.analysis.notes import notes_on
from jaxgrasp.psychophysics.analysis.weber import WeberLine
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.procedures.staircase import Staircase, staircase_threshold
from jaxgrasp.psychophysics.running.recorded_trials import TrialRecord, experiment_of
from jaxgrasp.psychophysics.running.records import RecordError, read_records, subjects
from jaxgrasp.psychophysics.running.session import EVERYONE
from jaxgrasp.validation.checked import checked


@dataclass(frozen=True)
class Answers:
    """The plan and all trials of an experiment."""

    plan: Plan
    trials: dict[str, list[TrialRecord]]
    """Trials of each person, as they are on record, practice too."""
    simulated: tuple[str, ...] = ()
    """Codes of simulated observers among the persons."""
    other_records: dict[str, list[TrialRecord]] = field(default_factory=dict)
    """Each person's records that are no trials: how it began, what was agreed to, told and discarded."""


@dataclass(frozen=True)
class Trace:
    """Levels and answers of a staircase in their order, with its threshold estimate."""

    subject: str
    reference: float
    levels: tuple[float, ...]
    right: tuple[bool, ...]
    turning_points: float
    """Geometric mean of the later ones; NaN where there are too few."""
    target: float
    """Hit ratio of the level that it goes to."""


@dataclass(frozen=True)
class Analysis:
    """Results of an experiment: of each person, of all persons together, and of differences between references."""

    plan: Plan
    settings: AnalysisSettings
    """Settings of the analysis, with the model that was taken."""
    subjects: tuple[str, ...]
    cells: tuple[Cell, ...]
    """Results of each person at each reference."""
    pooled: tuple[Cell, ...]
    """Results of all persons' answers at each reference, as if they were one person's: their interval leaves out how
    persons differ."""
    groups: tuple[Group, ...]
    """Means of persons' own thresholds at each reference, as papers print them and ``precision`` predicts them."""
    matched: tuple[Matched, ...]
    traces: tuple[Trace, ...]
    comparison: Comparison | None
    line: WeberLine | None
    notes: tuple[str, ...]
    """Notes for the reader: results that are missing, with the reason, and limits of the data."""


@checked
def load_experiment(folder: str | os.PathLike) -> Answers:
    """Read the records in a folder, and check each person's by a replay of the plan.

    Raises:
        ValueError: for a folder without records.
        RecordError: for records that cannot be read, or were made with several plans.
    """
    plan, trials, simulated, other_records = None, {}, [], {}
    for path in subjects(Path(folder)):
        records = read_records(path)[0]
        own_plan, observer, trials[path.stem] = experiment_of(records, path)
        other_records[path.stem] = [record for record in records if record["record"] != "trial"]
        if plan is not None and own_plan != plan:
            raise RecordError(f"{path} was made with another plan than the others in {folder}")
        plan = own_plan
        if observer is not None:
            simulated.append(path.stem)
    if plan is None:
        raise ValueError(f"{folder} has no records: expected files that `jaxgrasp experiment run` wrote")
    return Answers(plan, trials, tuple(simulated), other_records)


@checked
def analyse(answers: Answers, settings: AnalysisSettings | None = None) -> Analysis:
    """Compute the results of an experiment's answers.

    Args:
        answers: of all persons.
        settings: of the analysis.

    Raises:
        ValueError: for straight lines through answers at levels that followed from the answers.
    """
    plan, references = answers.plan, answers.plan.session.references
    settings = _settled(AnalysisSettings() if settings is None else settings, plan)
    test_trials = {
        subject: [trial for trial in trials if not trial["is_practice"]] for subject, trials in answers.trials.items()
    }
    people = tuple(test_trials)
    if plan.method == "matching":
        matches = tuple(
            _matched(subject, reference, trials, settings)
            for subject, trials in test_trials.items()
            for reference in references
        )
        notes = notes_on(plan, test_trials, answers.simulated)
        return Analysis(plan, settings, people, (), (), (), matches, (), None, None, tuple(notes))
    cells = tuple(
        cell_of(plan, subject, reference, trials, settings)
        for subject, trials in test_trials.items()
        for reference in references
    )
    everyone = [trial for trials in test_trials.values() for trial in trials]
    pooled = tuple(cell_of(plan, EVERYONE, reference, everyone, settings) for reference in references)
    groups = tuple(group_of(cells, reference) for reference in references)
    notes = notes_on(plan, test_trials, answers.simulated)
    comparison = comparison_of(plan, people, cells, notes)
    traces = tuple(_traces(plan, test_trials))
    line = line_of(pooled)
    return Analysis(plan, settings, people, cells, pooled, groups, (), traces, comparison, line, tuple(notes))


def _settled(settings: AnalysisSettings, plan: Plan) -> AnalysisSettings:
    """Return the settings with the default model of the procedure where none is set.

    Raises:
        ValueError: for straight lines where levels follow the answers.
    """
    if plan.procedure.follows_answers and settings.method not in ("likelihood", "posterior"):
        raise ValueError(
            f"method is {settings.method!r}, and levels of the procedure {plan.method!r} follow the answers: expected "
            "likelihood or posterior, which allow for that"
        )
    if settings.model is not None:
        return settings
    return replace(settings, model=Model(suited_shape(plan), suited_criterion(plan), lapse=(0.0, suited_lapse(plan))))


def _matched(subject: str, reference: float, trials: Iterable[TrialRecord], settings: AnalysisSettings) -> Matched:
    selected = [trial for trial in trials if trial["reference"] == reference]
    unsaturated = [trial for trial in selected if not trial["saturated"]]
    included = unsaturated if settings.saturated == "exclude" else selected
    return matched(
        subject,
        reference,
        [trial["setting"] for trial in included],
        settings.coverage,
        len(selected) - len(unsaturated),
    )


def _traces(plan: Plan, trials: dict[str, list[TrialRecord]]) -> Iterable[Trace]:
    settings = plan.procedure
    if not isinstance(settings, Staircase):
        return
    for subject, subject_trials in trials.items():
        for session, series in sorted({(trial["session"], trial["series"]) for trial in subject_trials}):
            track_trials = [
                trial for trial in subject_trials if (trial["session"], trial["series"]) == (session, series)
            ]
            levels, right = [trial["level"] for trial in track_trials], [trial["right"] for trial in track_trials]
            mean = staircase_threshold(settings, levels, right)
            yield Trace(subject, track_trials[0]["reference"], tuple(levels), tuple(right), mean, settings.target)
