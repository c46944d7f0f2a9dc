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
    others: dict[str, list[TrialRecord]] = field(default_factory=dict)
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
    plan, trials, simulated, others = None, {}, [], {}
    for path in subjects(Path(folder)):
        records = read_records(path)[0]
        own, observer, trials[path.stem] = experiment_of(records, path)
        others[path.stem] = [one for one in records if one["record"] != "trial"]
        if plan is not None and own != plan:
            raise RecordError(f"{path} was made with another plan than the others in {folder}")
        plan = own
        if observer is not None:
            simulated.append(path.stem)
    if plan is None:
        raise ValueError(f"{folder} has no records: expected files that `jaxgrasp experiment run` wrote")
    return Answers(plan, trials, tuple(simulated), others)


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
    real = {who: [one for one in own if not one["is_practice"]] for who, own in answers.trials.items()}
    people = tuple(real)
    if plan.method == "matching":
        found = tuple(_matched(who, reference, own, settings) for who, own in real.items() for reference in references)
        notes = notes_on(plan, real, answers.simulated)
        return Analysis(plan, settings, people, (), (), (), found, (), None, None, tuple(notes))
    cells = tuple(cell_of(plan, who, reference, own, settings) for who, own in real.items() for reference in references)
    everyone = [one for own in real.values() for one in own]
    pooled = tuple(cell_of(plan, EVERYONE, reference, everyone, settings) for reference in references)
    groups = tuple(group_of(cells, reference) for reference in references)
    notes = notes_on(plan, real, answers.simulated)
    comparison = comparison_of(plan, people, cells, notes)
    traces = tuple(_traces(plan, real))
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


def _matched(who: str, reference: float, trials: Iterable[TrialRecord], settings: AnalysisSettings) -> Matched:
    own = [one for one in trials if one["reference"] == reference]
    clean = [one for one in own if not one["saturated"]]
    used = clean if settings.saturated == "exclude" else own
    return matched(who, reference, [one["setting"] for one in used], settings.coverage, len(own) - len(clean))


def _traces(plan: Plan, trials: dict[str, list[TrialRecord]]) -> Iterable[Trace]:
    settings = plan.procedure
    if not isinstance(settings, Staircase):
        return
    for who, own in trials.items():
        for session, series in sorted({(one["session"], one["series"]) for one in own}):
            part = [one for one in own if (one["session"], one["series"]) == (session, series)]
            levels, right = [one["level"] for one in part], [one["right"] for one in part]
            mean = staircase_threshold(settings, levels, right)
            yield Trace(who, part[0]["reference"], tuple(levels), tuple(right), mean, settings.target)
