"""A whole experiment analysed: persons, all of them, and references; what cannot be said is not."""

import dataclasses

import numpy as np
import pytest

from jaxgrasp.psychophysics.analysis.anova import repeated_measures
from jaxgrasp.psychophysics.analysis.cell import AnalysisSettings, suited_criterion, suited_lapse, suited_shape
from jaxgrasp.psychophysics.analysis.experiment import Answers, analyse, load_experiment
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.tidy import tidy_tables
from jaxgrasp.psychophysics.person import SimulatedPerson
from jaxgrasp.psychophysics.plan import Plan, SessionPlan
from jaxgrasp.psychophysics.procedures import Adaptive, ConstantStimuli
from jaxgrasp.psychophysics.psychometric import Observer, PsychometricShape
from jaxgrasp.psychophysics.session import run_experiment
from jaxgrasp.psychophysics.trial import IdealStimulus, PredictedStimulus, Rendered

LONG = ConstantStimuli(series=30)
PLAN = Plan(session=SessionPlan((1.0, 2.0, 4.0), practice=2), procedure=LONG)
SETTINGS = AnalysisSettings(model=Model(PsychometricShape.DIFFERENCE, lapse=(0.0, 0.0)))
OBSERVER = Observer(0.08, 0.08)


def answers_of(folder, people: int, stimulus=None, plan: Plan = PLAN, observers=None) -> Answers:
    for k in range(people):
        observer = observers[k] if observers else OBSERVER
        person = SimulatedPerson(observer, plan.seed, f"S{k}")
        run_experiment(plan, f"S{k}", folder, stimulus or IdealStimulus(), person)
    return load_experiment(folder)


@pytest.fixture(scope="module")
def five(tmp_path_factory) -> Answers:
    """Return the answers of four persons who are alike, and of a fifth who guesses."""
    return answers_of(tmp_path_factory.mktemp("five"), 5, observers=[OBSERVER] * 4 + [Observer(5.0)])


def first(answers: Answers, people: int) -> Answers:
    """Return the answers of the first ``people`` persons."""
    trials, others = (
        {f"S{k}": records_by_person[f"S{k}"] for k in range(people)}
        for records_by_person in (answers.trials, answers.other_records)
    )
    return Answers(answers.plan, trials, answers.simulated[:people], others)


@pytest.mark.slow
def test_what_is_there_is_found(folder):
    """Weber fractions of persons and of all, the line through JNDs, and that references differ."""
    analysis = analyse(answers_of(folder, 6), SETTINGS)
    for cell in analysis.pooled:
        truth = OBSERVER.jnd(cell.reference) / cell.reference
        assert cell.threshold.low < truth < cell.threshold.high and cell.weber.fraction == cell.threshold.value
        assert cell.counts.trials.tolist() == [6 * 60] * 4
    for group in analysis.groups:
        thresholds = [cell.threshold.value for cell in analysis.cells if cell.reference == group.reference]
        assert group.mean == pytest.approx(np.nanmean(thresholds)) and group.persons == 6 == group.n_persons
        assert group.error == pytest.approx(np.nanstd(thresholds, ddof=1) / np.sqrt(6))
    assert abs(analysis.line.limit - 0.08) < 2.5 * analysis.line.limit_deviation < 0.1
    assert abs(analysis.line.floor - 0.08) < 2.5 * analysis.line.floor_deviation < 0.1
    table = np.array([[c.threshold.value for c in analysis.cells if c.subject == who] for who in analysis.subjects])
    within = analysis.comparison.within
    # Equal also where both are NaN.
    np.testing.assert_array_equal(dataclasses.astuple(within), dataclasses.astuple(repeated_measures(table)))
    assert within.p_value < 0.01
    assert len(analysis.comparison.pairs) == 3 and analysis.comparison.references == (1.0, 2.0, 4.0)


@pytest.mark.slow
def test_a_reference_without_thresholds_is_left_out(folder):
    class Weak(PredictedStimulus):
        def predict(self, intensity):
            return Rendered(intensity, min(intensity, 3.9), intensity, intensity > 3.9)

    analysis = analyse(answers_of(folder, 4, Weak()), SETTINGS)
    assert analysis.comparison.references == (1.0, 2.0)
    assert any("4 N is not in the analysis of variance: 0 thresholds" in note for note in analysis.notes)
    assert [cell.saturated for cell in analysis.pooled] == [0, 0, 4 * 240]
    assert analysis.groups[2].persons == 0 and np.isnan(analysis.groups[2].mean)
    (cell,) = [cell for cell in analysis.pooled if cell.saturated]
    assert np.isnan(cell.threshold.value) and cell.alternative is not None
    assert any("differences of 0.163 on average were felt as" in note for note in analysis.notes)


@pytest.mark.slow
def test_who_has_none_is_named(five):
    """A person who guesses is left out by name, and it is said what that does."""
    analysis = analyse(five, SETTINGS)
    assert analysis.comparison.subjects == ("S0", "S1", "S2", "S3")
    assert any(note.startswith("S4: not in the analysis of variance") for note in analysis.notes)


@pytest.mark.slow
def test_too_few_are_not_compared(five):
    assert analyse(first(five, 2), SETTINGS).comparison is None


def test_missing_trials_are_said(five):
    part = {"S0": five.trials["S0"][:300]}
    notes = analyse(Answers(five.plan, part), SETTINGS).notes
    assert any("S0 at" in note and "58 of 240 trials" in note for note in notes)
    assert any("no trial" in note for note in notes)


def test_answers_without_other_records_make_tables(five):
    answers = first(five, 1)
    analysis = analyse(answers, SETTINGS)
    tables, expected = tidy_tables(Answers(answers.plan, answers.trials), analysis), tidy_tables(answers, analysis)
    assert tables["trials.csv"] == expected["trials.csv"] and len(tables["persons.csv"]) == 2


@pytest.mark.parametrize("criterion", [0.75, 0.89, 0.9, 0.95])
def test_an_adaptive_plans_own_criterion_is_analysed(criterion):
    """Whatever a plan allows, the model that suits it allows too."""
    plan = Plan(method="adaptive", procedure=Adaptive(criterion=criterion))
    model = Model(suited_shape(plan), suited_criterion(plan), lapse=(0.0, suited_lapse(plan)))
    assert model.criterion == criterion < 1 - model.lapse[1]
