"""A whole experiment analysed: each person, all together, and what differs between references."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.special import ndtri

from jaxgrasp.psychophysics.analysis.anova import Anova, Pair, compare_conditions, one_way, repeated_measures
from jaxgrasp.psychophysics.analysis.counts import Counts, count
from jaxgrasp.psychophysics.analysis.detection import Sensitivity, sensitivity
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.analysis.goodness import Goodness, goodness
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.matching import Matched, matched
from jaxgrasp.psychophysics.analysis.notes import notes_on
from jaxgrasp.psychophysics.analysis.psychometric import Shape
from jaxgrasp.psychophysics.analysis.threshold import Interval, Method, Threshold, threshold
from jaxgrasp.psychophysics.analysis.weber import Weber, WeberLine, weber, weber_line
from jaxgrasp.psychophysics.plan import Plan
from jaxgrasp.psychophysics.procedures.staircase import Staircase, staircase_threshold
from jaxgrasp.psychophysics.running.history import TrialRecord, read_experiment
from jaxgrasp.psychophysics.running.records import RecordError, subjects
from jaxgrasp.psychophysics.running.session import EVERYONE

FEWEST = 3
"""Persons in an analysis of variance."""


@dataclass(frozen=True)
class AnalysisSettings:
    """How answers are analysed."""

    method: Method = "likelihood"
    model: Model | None = None
    """Where None, a Weibull function; for staircases and adaptive procedures that of an unbiased comparison, since a
    steepness of its own is biased where levels follow the answers."""
    interval: Interval | None = None
    """As the method has it, where None."""
    coverage: float = 0.95
    saturated: Literal["include", "exclude"] = "exclude"
    """Trials in which a torque was cut."""


@dataclass(frozen=True)
class Answers:
    """Of an experiment."""

    plan: Plan
    trials: dict[str, list[TrialRecord]]
    """Of each person, as they are on record, practice too."""
    simulated: tuple[str, ...] = ()
    """Persons who are none."""


@dataclass(frozen=True)
class Cell:
    """Answers of a person, or of all, at one reference."""

    subject: str
    reference: float
    counts: Counts
    threshold: Threshold
    weber: Weber | None
    """None in detection, and where there is no threshold."""
    fit: Goodness | None
    """None where no psychometric function was fitted."""
    sensitivities: tuple[tuple[float, Sensitivity], ...]
    """By level."""
    saturated: int
    """Trials in which a torque was cut."""
    with_others: Threshold | None
    """The threshold with saturated trials where these are left out, and without them where they are not; None where
    there are none."""


@dataclass(frozen=True)
class Group:
    """Thresholds of all persons at one reference, each found from that person's own answers."""

    reference: float
    persons: int
    """Who have one."""
    of: int
    """Who were asked."""
    mean: float
    deviation: float
    """Standard, over persons."""
    error: float
    """Standard, of the mean."""


@dataclass(frozen=True)
class Trace:
    """One staircase."""

    subject: str
    reference: float
    levels: tuple[float, ...]
    right: tuple[bool, ...]
    turning_points: float
    """Geometric mean of the later ones; NaN where there are too few."""
    target: float
    """Hit ratio of the level that it goes to."""


@dataclass(frozen=True)
class Comparison:
    """Of Weber fractions, or of thresholds, between references."""

    references: tuple[float, ...]
    subjects: tuple[str, ...]
    within: Anova
    """Of the same persons at every reference."""
    between: Anova
    """As if they were different ones, which is what the paper did."""
    pairs: tuple[Pair, ...]


@dataclass(frozen=True)
class Analysis:
    """Of an experiment."""

    plan: Plan
    settings: AnalysisSettings
    """With the model that was taken."""
    subjects: tuple[str, ...]
    cells: tuple[Cell, ...]
    """Of each person at each reference."""
    pooled: tuple[Cell, ...]
    """Of all persons' answers at each reference, as if they were one person's: its interval leaves out how persons
    differ."""
    groups: tuple[Group, ...]
    """What persons' own thresholds have in common: what papers print, and power is reckoned for."""
    matched: tuple[Matched, ...]
    traces: tuple[Trace, ...]
    comparison: Comparison | None
    line: WeberLine | None
    notes: tuple[str, ...]
    """What cannot be said, and why; and what the reader must know."""


def load_experiment(folder: Path) -> Answers:
    """The records in a folder, each person's led through the plan again.

    Raises:
        ValueError: for a folder without records.
        RecordError: for records that cannot be read, or were made with several plans.
    """
    plan, trials, simulated = None, {}, []
    for path in subjects(folder):
        own, observer, trials[path.stem] = read_experiment(path)
        if plan is not None and own != plan:
            raise RecordError(f"{path} was made with another plan than the others in {folder}")
        plan = own
        if observer is not None:
            simulated.append(path.stem)
    if plan is None:
        raise ValueError(f"{folder} has no records: expected files that `jaxgrasp experiment run` wrote")
    return Answers(plan, trials, tuple(simulated))


def analyse(answers: Answers, settings: AnalysisSettings | None = None) -> Analysis:
    """All that an experiment's answers say.

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
    cells = tuple(_cell(plan, who, reference, own, settings) for who, own in real.items() for reference in references)
    everyone = [one for own in real.values() for one in own]
    pooled = tuple(_cell(plan, EVERYONE, reference, everyone, settings) for reference in references)
    groups = tuple(_group(cells, reference) for reference in references)
    notes = notes_on(plan, real, answers.simulated)
    comparison = _comparison(plan, people, cells, notes)
    traces = tuple(_traces(plan, real))
    line = _line(pooled)
    return Analysis(plan, settings, people, cells, pooled, groups, (), traces, comparison, line, tuple(notes))


def _settled(settings: AnalysisSettings, plan: Plan) -> AnalysisSettings:
    """What suits the procedure, where nothing was asked for."""
    follows_answers = plan.method in ("staircase", "adaptive")
    if follows_answers and settings.method not in ("likelihood", "posterior"):
        raise ValueError(
            f"method is {settings.method!r}, and levels of the procedure {plan.method!r} follow the answers: expected "
            "likelihood or posterior, which allow for that"
        )
    if settings.model is not None:
        return settings
    # Few levels far from the threshold leave the steepness open, and a free one is found too shallow.
    return replace(settings, model=Model(Shape.DIFFERENCE if follows_answers else Shape.WEIBULL))


def _matched(who: str, reference: float, trials: Iterable[TrialRecord], settings: AnalysisSettings) -> Matched:
    own = [one for one in trials if one["reference"] == reference]
    clean = [one for one in own if not one["saturated"]]
    used = clean if settings.saturated == "exclude" else own
    return matched(who, reference, [one["setting"] for one in used], settings.coverage, len(own) - len(clean))


def _group(cells: tuple[Cell, ...], reference: float) -> Group:
    values = np.array([cell.threshold.value for cell in cells if cell.reference == reference])
    known = values[np.isfinite(values)]
    mean = float(known.mean()) if len(known) else np.nan
    deviation = float(known.std(ddof=1)) if len(known) > 1 else np.nan
    error = deviation / float(np.sqrt(max(len(known), 1)))
    return Group(reference, len(known), len(values), mean, deviation, error)


def _cell(plan: Plan, who: str, reference: float, trials: Iterable[TrialRecord], settings: AnalysisSettings) -> Cell:
    own = [one for one in trials if one["reference"] == reference]
    clean = [one for one in own if not one["saturated"]]
    used, others = (clean, own) if settings.saturated == "exclude" else (own, clean)
    counts = counted(used)
    found = _threshold(counts, settings)
    with_others = _threshold(counted(others), settings) if len(clean) < len(own) else None
    fraction = weber(found, reference) if reference > 0 and found.finding is Finding.FOUND else None
    fit: Goodness | None = None
    views: tuple[tuple[float, Sensitivity], ...] = ()
    # Where levels follow the answers, these are no independent draws at each level, and a few of them say nothing.
    if plan.method == "constant-stimuli":
        views = tuple((float(level), _view(used, level)) for level in counts.levels)
        if found.function is not None and found.finding is Finding.FOUND:
            fit = goodness(counts, settings.model)
    return Cell(who, reference, counts, found, fraction, fit, views, len(own) - len(clean), with_others)


def counted(trials: Iterable[TrialRecord]) -> Counts:
    """Answers of choices by level."""
    own = list(trials)
    return count(np.array([one["level"] for one in own]), np.array([one["right"] for one in own], bool))


def _threshold(counts: Counts, settings: AnalysisSettings) -> Threshold:
    return threshold(
        counts, settings.method, model=settings.model, interval=settings.interval, coverage=settings.coverage
    )


def _view(trials: list[TrialRecord], level: float) -> Sensitivity:
    there = [one for one in trials if one["level"] == level]
    first = [one["right"] for one in there if one["first"] > one["second"]]
    second = [one["right"] for one in there if one["first"] < one["second"]]
    return sensitivity(sum(first), len(first), sum(second), len(second))


def _comparison(plan: Plan, people: tuple[str, ...], cells: tuple[Cell, ...], notes: list[str]) -> Comparison | None:
    """Of the references at which enough persons have a threshold, among the persons who have one at each of these."""
    if len(plan.session.references) < 2 or len(people) < FEWEST:
        return None
    every = np.array([[_of(cells, who, r).threshold.value for r in plan.session.references] for who in people])
    found = np.isfinite(every).sum(0)
    usable = found >= FEWEST
    for reference, known in zip(plan.session.references, found, strict=True):
        if known < FEWEST:
            notes.append(f"{reference:g} {plan.stimulus.unit} is not in the analysis of variance: {known} thresholds")
    references = tuple(r for r, is_usable in zip(plan.session.references, usable, strict=True) if is_usable)
    values = every[:, usable]
    whole = np.all(np.isfinite(values), axis=1)
    left_out = [who for who, is_whole in zip(people, whole, strict=True) if not is_whole]
    kept = tuple(who for who in people if who not in left_out)
    if len(references) < 2 or len(kept) < FEWEST:
        notes.append(f"no analysis of variance: it takes two references and {FEWEST} persons with a threshold at each")
        return None
    if left_out:
        notes.append(
            f"{', '.join(left_out)}: not in the analysis of variance for want of a threshold; who feels least is the "
            "likelier to be left out, which makes means too small"
        )
    table = values[whole]
    try:
        return Comparison(
            references, kept, repeated_measures(table), one_way(list(table.T)), tuple(compare_conditions(table))
        )
    except ValueError as error:
        notes.append(f"no analysis of variance: {error}")
        return None


def _of(cells: tuple[Cell, ...], who: str, reference: float) -> Cell:
    return next(cell for cell in cells if cell.subject == who and cell.reference == reference)


def _line(pooled: tuple[Cell, ...]) -> WeberLine | None:
    """Through JNDs of all persons together, each by its own interval, where there are two at least."""
    known = [
        cell.weber
        for cell in pooled
        if cell.weber is not None and np.isfinite(cell.weber.jnd_high - cell.weber.jnd_low)
    ]
    if len(known) < 2:
        return None
    z = float(ndtri((1 + pooled[0].threshold.coverage) / 2))
    spreads = np.array([(one.jnd_high - one.jnd_low) / (2 * z) for one in known])
    return weber_line(np.array([one.reference for one in known]), np.array([one.jnd for one in known]), spreads)


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
