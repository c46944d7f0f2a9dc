"""Analysis of an experiment: each person, all persons together, and differences between references.

Constant and variable errors of a person's settings in the matching of two stimuli.

Notes on answers for the reader of an analysis: missing, simulated, saturated and brief trials.

Means over persons at each reference, and comparison between references.
"""

import os
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.special import chdtri, ndtri, stdtrit

from jaxgrasp.psychophysics.analysis.anova import Anova, Pair, compare_conditions, one_way, repeated_measures
from jaxgrasp.psychophysics.analysis.cell import (
    AnalysisSettings,
    Cell,
    WeberLine,
    cell_of,
    suited_criterion,
    suited_lapse,
    suited_shape,
    weber_line,
)
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.procedures import Staircase, staircase_threshold
from jaxgrasp.psychophysics.psychometric import QUARTILE
from jaxgrasp.psychophysics.records import RecordError, TrialRecord, experiment_of, felt_levels, read_records, subjects
from jaxgrasp.psychophysics.session import EVERYONE
from jaxgrasp.validation.checked import checked


@dataclass(frozen=True)
class Matched:
    """Constant and variable error of one person at one reference. NaN where there are too few settings."""

    subject: str
    reference: float
    settings: int
    error: float
    """Mean setting less the reference: the constant error, in the stimulus' unit."""
    error_low: float
    error_high: float
    deviation: float
    """Standard deviation of the settings: the variable error."""
    deviation_low: float
    deviation_high: float
    saturated: int = 0
    """Settings in which a torque was cut."""

    @property
    def jnd(self) -> float:
        """Difference that would be told apart in three of four choices, if the noise of both tasks is the same."""
        return QUARTILE * self.deviation


def matched(
    subject: str, reference: float, settings: list[float], coverage: float = 0.95, saturated: int = 0
) -> Matched:
    """Compute the mean and the deviation with their intervals, for settings that are normally distributed."""
    values, count = np.asarray(settings, float), len(settings)
    if count < 2:
        error = float(values[0] - reference) if count else np.nan
        return Matched(subject, reference, count, error, -np.inf, np.inf, np.nan, 0.0, np.inf, saturated)
    error, deviation = float(values.mean() - reference), float(values.std(ddof=1))
    tail = (1 - coverage) / 2
    half_width = float(-stdtrit(count - 1, tail)) * deviation / np.sqrt(count)
    low, high = (deviation * float(np.sqrt((count - 1) / chdtri(count - 1, share))) for share in (tail, 1 - tail))
    return Matched(
        subject, reference, count, error, error - half_width, error + half_width, deviation, low, high, saturated
    )


BRIEF = 0.3
"""Time in which nobody feels a weight [s]."""


def notes_on(plan: Plan, trials: dict[str, list[TrialRecord]], simulated: tuple[str, ...]) -> list[str]:
    """Return notes on the answers, as sentences without a full stop.

    Args:
        plan: of the experiment.
        trials: of each person, without practice.
        simulated: codes of simulated observers among the persons.
    """
    notes = [f"{', '.join(simulated)}: answers of a simulated observer"] if simulated else []
    for subject, subject_trials in trials.items():
        for reference in plan.session.references:
            at_reference = [trial for trial in subject_trials if trial["reference"] == reference]
            label = f"{subject} at {reference:g} {plan.stimulus.unit}"
            notes += _missing(plan, label, len(at_reference))
            notes += _saturated(label, [trial for trial in at_reference if trial["saturated"]])
        if subject not in simulated:
            brief = sum(
                any(duration is not None and duration < BRIEF for duration in trial["durations"])
                for trial in subject_trials
            )
            if brief:
                notes.append(
                    f"{subject}: {brief} trials had an interval of less than {BRIEF:g} s, too brief to be felt"
                )
    return notes


def _missing(plan: Plan, label: str, n_trials: int) -> list[str]:
    n_planned = plan.session.sessions * plan.procedure.most_trials() * plan.within.n_conditions
    if n_trials == 0:
        return [f"{label}: no trial"]
    if n_trials < n_planned and plan.method != "staircase":
        return [f"{label}: {n_trials} of {n_planned} trials"]
    return []


def _saturated(label: str, cut: list[TrialRecord]) -> list[str]:
    """Return a note on the trials in which a torque was cut, with the differences asked for and felt, if any."""
    if not cut:
        return []
    note = f"{label}: a torque was cut in {len(cut)} trials"
    felt_differences = felt_levels(cut)
    if felt_differences and "right" in cut[0]:
        mean_level = np.mean([trial["level"] for trial in cut])
        note += f", where differences of {mean_level:.3f} on average were felt as {np.mean(felt_differences):.3f}"
    return [note]


FEWEST = 3
"""Persons in an analysis of variance."""


@dataclass(frozen=True)
class Group:
    """Thresholds of all persons at one reference, each found from that person's own answers."""

    reference: float
    persons: int
    """Persons who have a threshold."""
    n_persons: int
    """Persons who were asked."""
    mean: float
    deviation: float
    """Standard deviation over persons."""
    error: float
    """Standard error of the mean."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of Weber fractions, or of thresholds, between references."""

    references: tuple[float, ...]
    subjects: tuple[str, ...]
    within: Anova
    """Analysis of variance of the same persons at every reference."""
    between: Anova
    """Analysis of variance as if they were different persons, which is what the paper did."""
    pairs: tuple[Pair, ...]


def group_of(cells: tuple[Cell, ...], reference: float) -> Group:
    values = np.array([cell.threshold.value for cell in cells if cell.reference == reference])
    finite = values[np.isfinite(values)]
    mean = float(finite.mean()) if len(finite) else np.nan
    deviation = float(finite.std(ddof=1)) if len(finite) > 1 else np.nan
    error = deviation / float(np.sqrt(max(len(finite), 1)))
    return Group(reference, len(finite), len(values), mean, deviation, error)


def comparison_of(plan: Plan, people: tuple[str, ...], cells: tuple[Cell, ...], notes: list[str]) -> Comparison | None:
    """Compare the references at which enough persons have a threshold, among the persons with one at each of these.

    The reasons for references, persons or a whole comparison left out are appended to ``notes``.
    """
    if len(plan.session.references) < 2 or len(people) < FEWEST:
        return None
    thresholds = np.array(
        [[_find_cell(cells, subject, r).threshold.value for r in plan.session.references] for subject in people]
    )
    n_found = np.isfinite(thresholds).sum(0)
    usable = n_found >= FEWEST
    for reference, n_thresholds in zip(plan.session.references, n_found, strict=True):
        if n_thresholds < FEWEST:
            notes.append(
                f"{reference:g} {plan.stimulus.unit} is not in the analysis of variance: {n_thresholds} thresholds"
            )
    references = tuple(r for r, is_usable in zip(plan.session.references, usable, strict=True) if is_usable)
    values = thresholds[:, usable]
    is_complete = np.all(np.isfinite(values), axis=1)
    left_out = [subject for subject, is_whole in zip(people, is_complete, strict=True) if not is_whole]
    included = tuple(subject for subject in people if subject not in left_out)
    if len(references) < 2 or len(included) < FEWEST:
        notes.append(f"no analysis of variance: it takes two references and {FEWEST} persons with a threshold at each")
        return None
    if left_out:
        notes.append(
            f"{', '.join(left_out)}: not in the analysis of variance for want of a threshold; who feels least is the "
            "likelier to be left out, which makes means too small"
        )
    table = values[is_complete]
    try:
        return Comparison(
            references, included, repeated_measures(table), one_way(list(table.T)), tuple(compare_conditions(table))
        )
    except ValueError as error:
        notes.append(f"no analysis of variance: {error}")
        return None


@dataclass(frozen=True)
class WithinComparison:
    """Comparison of the conditions of a factor within persons, by each person's share of right answers."""

    factor: str
    conditions: tuple[str, ...]
    subjects: tuple[str, ...]
    shares: tuple[tuple[float, ...], ...]
    """Share of right answers of each person (rows) in each condition (columns), over all levels and references."""
    means: tuple[float, ...]
    deviations: tuple[float, ...]
    """Standard deviations over persons."""
    anova: Anova
    """Analysis of variance by repeated measures, with Greenhouse and Geisser's correction."""
    pairs: tuple[Pair, ...]


def within_comparison(
    plan: Plan, trials: dict[str, list[TrialRecord]], settings: AnalysisSettings, notes: list[str]
) -> WithinComparison | None:
    """Compare the conditions of the plan's factor; reasons for what is left out are appended to ``notes``.

    Every level and order is presented equally often in each condition, so that shares of right answers compare alike.
    """
    conditions = plan.within.conditions
    if not conditions:
        return None
    shares, included = [], []
    for subject, subject_trials in trials.items():
        counted_trials = [t for t in subject_trials if settings.saturated == "include" or not t["saturated"]]
        right = [[t["right"] for t in counted_trials if t.get("condition") == c] for c in conditions]
        planned = plan.session.sessions * len(plan.session.references) * plan.procedure.most_trials()
        if min(map(len, right)) < planned:
            few = min(zip(map(len, right), conditions, strict=True))
            notes.append(
                f"{subject}: not in the analysis of {plan.within.factor}: {few[0]} of {planned} trials count with "
                f"{few[1]}"
            )
            continue
        shares.append([float(np.mean(answers)) for answers in right])
        included.append(subject)
    if len(included) < FEWEST:
        notes.append(f"no analysis of {plan.within.factor}: it takes {FEWEST} persons with all trials")
        return None
    table = np.array(shares)
    try:
        anova, pairs = repeated_measures(table), tuple(compare_conditions(table))
    except ValueError as error:
        notes.append(f"no analysis of {plan.within.factor}: {error}")
        return None
    rows = tuple(tuple(row) for row in shares)
    means, deviations = (tuple(map(float, x)) for x in (table.mean(0), table.std(0, ddof=1)))
    return WithinComparison(plan.within.factor, conditions, tuple(included), rows, means, deviations, anova, pairs)


def _find_cell(cells: tuple[Cell, ...], subject: str, reference: float) -> Cell:
    return next(cell for cell in cells if cell.subject == subject and cell.reference == reference)


def line_of(pooled: tuple[Cell, ...]) -> WeberLine | None:
    """Fit the Weber line through all persons' JNDs, weighted by their intervals; None for fewer than two JNDs."""
    webers = [
        cell.weber
        for cell in pooled
        if cell.weber is not None and np.isfinite(cell.weber.jnd_high - cell.weber.jnd_low)
    ]
    if len(webers) < 2:
        return None
    z = float(ndtri((1 + pooled[0].threshold.coverage) / 2))
    spreads = np.array([(weber.jnd_high - weber.jnd_low) / (2 * z) for weber in webers])
    return weber_line(
        np.array([weber.reference for weber in webers]), np.array([weber.jnd for weber in webers]), spreads
    )


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
    within: WithinComparison | None = None
    """Comparison of the conditions of the plan's factor within persons; None where there is none."""


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
    within = within_comparison(plan, test_trials, settings, notes)
    if plan.within.factor:
        notes.append(f"thresholds are of all conditions of {plan.within.factor} together")
    traces = tuple(_traces(plan, test_trials))
    line = line_of(pooled)
    return Analysis(plan, settings, people, cells, pooled, groups, (), traces, comparison, line, tuple(notes), within)


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
