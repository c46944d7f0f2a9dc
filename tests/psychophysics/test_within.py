"""Conditions within persons: their order, their records, the analysis against hand computation, and its power."""

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ttest_rel

from jaxgrasp.psychophysics import (
    AnalysisSettings,
    ConstantStimuli,
    IdealStimulus,
    Observer,
    Plan,
    SessionPlan,
    SimulatedPerson,
    Staircase,
    Stimulus,
    analyse,
    load_experiment,
    persons_for_power,
    repeated_measures,
    run_experiment,
    within_power,
)
from jaxgrasp.psychophysics.plan import WithinPlan, load_plan, parse_within, plan_toml
from jaxgrasp.psychophysics.schedule import Schedule

FOUR = parse_within("feedback")
SHORT = ConstantStimuli(levels=(0.1, 0.3), series=1, repeats=10)


def plan_with(within: WithinPlan = FOUR, order: str = "balanced", seed: int = 5) -> Plan:
    session = SessionPlan(references=(1.0, 2.0), order=order, practice=2)
    return replace(Plan(), session=session, procedure=SHORT, within=within, seed=seed)


def conditions_of(plan: Plan, subject: str) -> list[str]:
    return list(dict.fromkeys(Schedule(plan, subject).conditions))


def test_the_paper_has_no_factor_and_its_schedule_stays():
    assert Plan().within == WithinPlan() and set(Schedule(Plan(), "S1").conditions) == {""}
    assert Schedule(Plan(), "S1").next().condition == ""


def test_a_factor_goes_through_its_file(tmp_path):
    plan = plan_with(parse_within("feedback=force, both"))
    (tmp_path / "plan.toml").write_text(plan_toml(plan))
    assert load_plan(tmp_path / "plan.toml") == plan and plan.within.conditions == ("force", "both")
    assert FOUR.conditions == ("none", "force", "vibration", "both")


@pytest.mark.parametrize(
    "text, message",
    [
        ("feedbak", "factor is 'feedbak'.*feedback"),
        ("feedback=force", "conditions has 1 entries: expected at least 2"),
        ("feedback=force,sound", r"conditions\[1\] is 'sound'"),
        ("feedback=force,both,force", r"conditions\[2\] is 'force' again"),
    ],
)
def test_other_factors_are_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_within(text)


def test_answers_that_move_the_levels_cannot_be_compared():
    with pytest.raises(ValueError, match="procedure.method is 'staircase', and within.factor is 'feedback'"):
        replace(Plan(), method="staircase", procedure=Staircase(), within=FOUR)


def test_orders_of_conditions_are_counterbalanced():
    orders = [conditions_of(plan_with(), f"S{k:02d}") for k in range(1, 5)]
    for place in range(4):
        assert {order[place] for order in orders} == set(FOUR.conditions)
    followed = Counter(pair for order in orders for pair in itertools.pairwise(order))
    assert len(followed) == 12 and set(followed.values()) == {1}
    assert conditions_of(plan_with(order="given"), "S09") == list(FOUR.conditions)
    drawn = {tuple(conditions_of(plan_with(order="random"), f"S{k}")) for k in range(200)}
    assert len(drawn) == 24


def test_each_condition_has_all_trials_of_each_reference():
    plan = plan_with()
    schedule, counted = Schedule(plan, "S01"), Counter()
    while (trial := schedule.next()) is not None:
        counted[trial.condition, trial.reference, trial.is_practice] += 1
        schedule.score(1.0)
    test_trials = {key: count for key, count in counted.items() if not key[2]}
    assert len(test_trials) == 8 and set(test_trials.values()) == {SHORT.most_trials()}
    assert sum(counted.values()) == plan.most_trials() == 2 + 8 * SHORT.most_trials()


def run_study(plan: Plan, folder, persons: int, noise: dict[str, float]):
    for k in range(1, persons + 1):
        subject = f"S{k:02d}"
        person = SimulatedPerson(Observer(weber=0.2), plan.seed, subject, noise)
        run_experiment(plan, subject, folder, IdealStimulus(), person)
    return analyse(load_experiment(folder), AnalysisSettings("line"))


def test_a_study_finds_that_a_condition_is_worse(tmp_path):
    noise = {"none": 1000.0, "force": 1.0, "vibration": 2.0, "both": 0.9}
    analysis = run_study(plan_with(), tmp_path, 6, noise)
    within = analysis.within
    assert within.factor == "feedback" and len(within.subjects) == 6
    means = dict(zip(within.conditions, within.means, strict=True))
    assert abs(means["none"] - 0.5) < 0.08 < means["vibration"] - means["none"] < means["force"] - means["none"]
    assert (within.anova.between, within.anova.within) == (3, 15)
    assert within.anova.corrected_p_value < 0.01 and 1 / 3 <= within.anova.sphericity <= 1
    table = np.array(within.shares)
    for pair in within.pairs:
        i, j = pair.groups
        assert pair.difference == pytest.approx(np.mean(table[:, i] - table[:, j]))
    page = pytest.importorskip("jaxgrasp.report.experiment_page").experiment_html(analysis)
    assert 'id="conditions"' in page and all(f"none less {name}" in page for name in ("force", "vibration", "both"))


def test_persons_without_all_trials_are_left_out_by_name(tmp_path):
    plan = plan_with(parse_within("feedback=force,both"))
    run_study(plan, tmp_path, 4, {})
    records = (tmp_path / "S02.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "S02.jsonl").write_text("".join(records[:-3]))
    analysis = analyse(load_experiment(tmp_path), AnalysisSettings("line"))
    assert analysis.within.subjects == ("S01", "S03", "S04")
    assert any(note.startswith("S02: not in the analysis of feedback: 37 of 40 trials") for note in analysis.notes)


def test_a_stimulus_without_the_condition_is_refused_before_any_question(tmp_path):
    class OnlyForce(IdealStimulus):
        set_condition = Stimulus.set_condition

    person = SimulatedPerson(Observer(weber=0.2), 1, "S01")
    with pytest.raises(ValueError, match="condition is 'none': expected 'force', which alone OnlyForce renders"):
        run_experiment(plan_with(), "S01", tmp_path, OnlyForce(), person)
    assert not list(tmp_path.iterdir())


def test_noise_of_a_condition_must_be_positive():
    with pytest.raises(ValueError, match="noise of force is 0.0: expected a positive number"):
        SimulatedPerson(Observer(weber=0.2), 1, "S01", {"force": 0.0})


def test_two_conditions_are_a_paired_t_test():
    table = np.random.default_rng(3).normal(size=(9, 2)) + [0.0, 0.6]
    anova, t = repeated_measures(table), ttest_rel(table[:, 0], table[:, 1])
    assert anova.f == pytest.approx(t.statistic**2) and anova.p_value == pytest.approx(t.pvalue)
    assert anova.sphericity == pytest.approx(1) and anova.corrected_p_value == pytest.approx(t.pvalue)


def test_the_analysis_is_that_of_sums_by_hand():
    """Rows are persons: SS_total = 73, SS_conditions = 32, SS_persons = 107/3, so that SS_error = 16/3."""
    table = np.array([[1, 3, 5], [3, 5, 7], [5, 5, 9], [5, 9, 9]], float)
    # Columns have means 3.5, 5.5, 7.5 about 5.5: 4 (4 + 0 + 4) = 32. Rows have means 3, 5, 19/3, 23/3:
    # 3 (25/4 + 1/4 + 25/36 + 169/36) = 107/3. The squares sum to 436, less 12 x 5.5^2 = 363.
    total = float(np.sum(table**2) - 12 * 5.5**2)
    residual = total - 32 - 107 / 3
    anova = repeated_measures(table)
    assert total == 73 and residual == pytest.approx(16 / 3)
    assert (anova.between, anova.within) == (2, 6)
    assert anova.f == pytest.approx((32 / 2) / ((16 / 3) / 6)) == pytest.approx(18.0)
    assert anova.eta_squared == pytest.approx(32 / (32 + 16 / 3))


@pytest.mark.parametrize("persons, conditions, effect, correlation", [(12, 4, 0.25, 0.5), (8, 3, 0.4, 0.2)])
def test_predicted_power_is_the_share_of_simulated_studies_that_find_it(persons, conditions, effect, correlation):
    rng, found, studies = np.random.default_rng(8), 0, 3000
    pattern = np.linspace(-1, 1, conditions)
    means = effect * pattern / pattern.std()
    for _ in range(studies):
        own = np.sqrt(correlation) * rng.normal(size=(persons, 1))
        table = means + own + np.sqrt(1 - correlation) * rng.normal(size=(persons, conditions))
        found += repeated_measures(table).p_value < 0.05
    power = within_power(effect, persons, conditions, correlation=correlation)
    assert abs(found / studies - power) < 4 * np.sqrt(power * (1 - power) / studies)


def test_power_of_two_conditions_is_that_of_a_paired_t_test():
    """Against the noncentral t: d_z = 2 f / sqrt(2 (1 - rho))."""
    from scipy.stats import nct, t

    for persons in (5, 20, 40):
        distance = 2 * 0.3 / np.sqrt(2 * (1 - 0.4)) * np.sqrt(persons)
        critical = t.ppf(0.975, persons - 1)
        power = nct.sf(critical, persons - 1, distance) + nct.cdf(-critical, persons - 1, distance)
        assert within_power(0.3, persons, 2, correlation=0.4) == pytest.approx(power, rel=1e-6)


def test_power_rises_with_persons_and_effect_and_falls_without_sphericity():
    powers = [within_power(0.25, persons, 4) for persons in range(2, 60)]
    assert np.all(np.diff(powers) > 0) and within_power(0.0, 9, 4) == 0.05
    assert within_power(0.25, 20, 4, sphericity=1 / 3) < within_power(0.25, 20, 4)
    persons = persons_for_power(0.25, 4, 0.8)
    assert within_power(0.25, persons, 4) >= 0.8 > within_power(0.25, persons - 1, 4)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"subjects": 1}, "subjects is 1: expected at least 2"),
        ({"effect": -0.1}, "effect is -0.1: expected a finite number, 0 or more"),
        ({"correlation": 1.0}, "correlation is 1.0: expected 0 to below 1"),
        ({"alpha": 0.0}, "alpha is 0.0: expected more than 0 to below 1"),
        ({"sphericity": 0.2}, "sphericity is 0.2: expected 0.333 to 1"),
    ],
)
def test_numbers_of_no_study_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        within_power(**{"effect": 0.25, "subjects": 12, "conditions": 4, **options})
    with pytest.raises(ValueError, match="effect is 0.0: 20 persons do not reach"):
        persons_for_power(0.0, 4, most=20)
