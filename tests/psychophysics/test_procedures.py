"""Procedures: balanced, random, decided by seed and answers alone; adaptive ones go where they should."""

import math
import random
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from jaxgrasp.psychophysics.plan import METHODS, Plan, SessionPlan
from jaxgrasp.psychophysics.procedures import Adaptive, Coin, ConstantStimuli, Matching, Staircase, staircase_threshold
from jaxgrasp.psychophysics.psychometric import Observer
from jaxgrasp.psychophysics.schedule import Schedule
from jaxgrasp.psychophysics.trial import Trial


def answered(
    plan: Plan, subject: str = "S1", seed: int = 0, observer: Observer | None = None
) -> list[tuple[Trial, float]]:
    observer = Observer() if observer is None else observer
    schedule, rng, answers = Schedule(plan, subject), np.random.default_rng(seed), []
    while (trial := schedule.next()) is not None:
        assert schedule.next() == trial, "the same until it is scored"
        if trial.task == "choice":
            score = float(observer.choose(trial.first, trial.second, trial.number, rng) == trial.stronger)
        else:
            score = observer.match(trial.reference, trial.number, rng) / trial.reference - 1
        schedule.score(score)
        answers.append((trial, score))
    return answers


def plan_of(method: str, **settings) -> Plan:
    return Plan(method=method, procedure=METHODS[method](**settings))


@pytest.mark.parametrize("method", list(METHODS))
def test_seed_and_answers_decide(method):
    plan = plan_of(method)
    assert answered(plan) == answered(plan)
    assert [t for t, _ in answered(plan)] != [t for t, _ in answered(plan, "S2")]
    assert [t for t, _ in answered(plan)] != [t for t, _ in answered(replace(plan, seed=1))]
    trials = [trial for trial, _ in answered(plan)]
    assert [trial.number for trial in trials] == list(range(1, len(trials) + 1)) and len(trials) <= plan.most_trials()
    assert all(trial.is_practice == (trial.number <= plan.session.practice) for trial in trials)
    assert sorted({trial.reference for trial in trials}) == [1.0, 2.0, 3.0]


def test_the_papers_design():
    """Five series of eight trials; each comparison once first and once second in each; ten of each in a session."""
    trials = [trial for trial, _ in answered(Plan()) if not trial.is_practice]
    assert len(trials) == 120 == 3 * 40
    for session in (1, 2, 3):
        of_session = [trial for trial in trials if trial.session == session]
        assert len({trial.reference for trial in of_session}) == 1 and Counter(
            t.level for t in of_session
        ) == dict.fromkeys((0.05, 0.1, 0.2, 0.3), 10)
        for series in range(1, 6):
            part = [(t.level, t.first > t.second) for t in of_session if t.series == series]
            assert Counter(part) == {(level, first): 1 for level in (0.05, 0.1, 0.2, 0.3) for first in (True, False)}
    orders = {tuple(t.level for t in trials if (t.session, t.series) == place) for place in ((1, 1), (1, 2), (2, 1))}
    assert len(orders) == 3
    for trial in trials:
        assert max(trial.first, trial.second) == pytest.approx(trial.reference * (1 + trial.level))


def test_orders_are_even():
    """Over many persons, each order of the first series' levels comes as often as any other."""
    first = Counter(Schedule(Plan(session=SessionPlan(practice=0)), f"S{k}").next().level for k in range(2000))
    assert all(abs(count - 500) < 100 for count in first.values())


def test_sessions_and_given_order():
    plan = Plan(session=SessionPlan(sessions=2, order="given"))
    assert Schedule(plan, "S1").references == [1.0, 2.0, 3.0] * 2
    drawn = {tuple(Schedule(Plan(), f"S{k}").references) for k in range(60)}
    assert len(drawn) == 6


def test_detection_has_nothing_beside():
    plan = Plan(session=SessionPlan(references=(0.0,)), procedure=ConstantStimuli(levels=(0.1, 0.2)))
    assert plan.is_detection and plan.intensities() == [0.1, 0.2]
    for trial, _ in answered(plan, observer=Observer(absolute=0.15)):
        assert {trial.first, trial.second} == {0.0, trial.level}


def test_a_coin_is_balanced():
    coin = Coin(random.Random(0))
    tosses = [coin.toss() for _ in range(400)]
    assert sum(tosses) == 200 and all(sum(tosses[4 * k : 4 * k + 4]) == 2 for k in range(100))


@pytest.mark.parametrize("down", [2, 3, 4])
def test_staircases_go_to_their_target(down):
    """Turning points lie where the observer is right as often as a half to the power of 1 / down."""
    settings = Staircase(down=down, reversals=16, trials=400, factors=(1.5, 1.05), interleaved=1)
    observer, thresholds = Observer(0.15), []
    for k in range(40):
        plan = Plan(seed=k, session=SessionPlan(references=(2.0,), practice=0), method="staircase", procedure=settings)
        trials = answered(plan, seed=k, observer=observer)
        thresholds.append(staircase_threshold(settings, [t.level for t, _ in trials], [bool(s) for _, s in trials]))
    level = float(np.exp(np.nanmean(np.log(thresholds))))
    assert observer.hit_probability(2.0, 2 * (1 + level)) == pytest.approx(settings.target, abs=0.05)


def test_staircase_records_are_checked():
    settings = Staircase()
    with pytest.raises(ValueError, match=r"levels\[1\] is 0.3: expected 0.4"):
        staircase_threshold(settings, [0.4, 0.3], [True, True])
    assert math.isnan(staircase_threshold(settings, [0.4], [True]))


def test_adaptive_asks_where_it_learns():
    """More trials near the threshold than constant stimuli have, and a sharper estimate from as many."""
    observer = Observer(0.15)
    plan = Plan(session=SessionPlan(references=(2.0,), practice=0), method="adaptive", procedure=Adaptive(trials=60))
    levels = np.array([trial.level for trial, _ in answered(plan, observer=observer)])
    assert np.median(np.abs(np.log(levels[10:] / 0.2))) < np.log(2)
    assert len(set(levels[:15].tolist())) > 3


def test_levels_of_a_staircase_come_back():
    """Up and down again is the same level, to the last bit: answers there are counted together."""
    levels = [trial.level for trial, _ in answered(plan_of("staircase", trials=300, reversals=100), seed=1)]
    rounded = [float(f"{level:.7g}") for level in levels]
    assert len(set(levels)) == len(set(rounded)) < 60


def test_matching_starts_on_both_sides():
    plan = plan_of("matching", trials=40)
    assert all(trial.first == trial.reference for trial, _ in answered(plan)), "practice too"
    starts = [t.level for t, _ in answered(plan) if not t.is_practice and t.session == 1]
    assert sum(start > 0 for start in starts) == 20 and all(0.2 <= abs(start) <= 0.4 for start in starts)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: ConstantStimuli(levels=()), "levels is empty"),
        (lambda: ConstantStimuli(levels=(0.1, 0.1)), r"levels\[1\] is 0.1 again"),
        (lambda: ConstantStimuli(levels=(-0.1,)), r"levels\[0\] is -0.1: expected a positive"),
        (lambda: ConstantStimuli(repeats=3), "repeats is 3: expected an even number"),
        (lambda: ConstantStimuli(series=0), "series is 0: expected 1 or more"),
        (lambda: Matching(start=1.2), "start is 1.2"),
        (lambda: Staircase(start=0.9), "start is 0.9: expected from low"),
        (lambda: Staircase(down=1), "down is 1: expected 2 or more"),
        (lambda: Staircase(factors=(1.0,)), r"factors\[0\] is 1: expected more than 1"),
        (lambda: Adaptive(low=0.9), "low is 0.9: expected less than high"),
        (lambda: SessionPlan(references=(1.0, 1.0)), r"references\[1\] is 1 again"),
        (lambda: SessionPlan(references=(-1.0,)), r"references\[0\] is -1"),
        (lambda: SessionPlan(references=(1e200,)), r"references\[0\] is 1e\+200: expected a positive number, 1e-06 to"),
        (lambda: ConstantStimuli(levels=(1e-20,)), r"levels\[0\] is 1e-20"),
        (lambda: ConstantStimuli(series=10**9), "series is 1000000000: expected 1 or more, and at most 10000"),
        (lambda: Adaptive(levels=2000), "levels is 2000: expected at most 500"),
        (
            lambda: Plan(procedure=ConstantStimuli(series=10_000)),
            "240,004 trials of a person: expected at most 100,000",
        ),
        (lambda: Plan(session=SessionPlan(references=(0.0, 1.0))), "a plan of its own"),
        (
            lambda: Plan(session=SessionPlan(references=(0.0,)), method="matching", procedure=Matching()),
            "contains 0, which nothing can match",
        ),
    ],
)
def test_bad_settings(make, message):
    with pytest.raises(ValueError, match=message):
        make()
