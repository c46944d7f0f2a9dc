"""Simulated observers: their JND is what it says, and lapses, bias and learning do what they are named for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxgrasp.psychophysics.psychometric import Observer


@given(st.floats(0.01, 1), st.floats(0, 1), st.floats(0, 5))
def test_jnd_is_the_difference_noticed_in_three_of_four(weber, absolute, reference):
    observer = Observer(weber, absolute)
    jnd = observer.jnd(reference)
    if jnd > 1e-6:
        assert observer.hit_probability(reference, reference + jnd) == pytest.approx(0.75)


def test_what_changes_it():
    plain = Observer()
    assert plain.hit_probability(1.0, 1.0) == pytest.approx(0.5)
    assert Observer(lapse=0.04).hit_probability(1.0, 100.0) == pytest.approx(0.96)
    assert Observer(lapse=0.04).hit_probability(1.0, 1.0) == pytest.approx(0.5)
    biased = Observer(bias=0.5)
    assert biased.second_probability(1.0, 1.0) > 0.6 and biased.hit_probability(1.0, 1.15) < 0.75
    slow = Observer(learning=1.0, learning_trials=20.0)
    assert slow.jnd(1.0, 0) == pytest.approx(2 * plain.jnd(1.0)) and slow.jnd(1.0, 10**4) == pytest.approx(0.15)
    assert slow.hit_probability(1.0, 1.15, 0) < slow.hit_probability(1.0, 1.15, 40) < 0.75


def test_answers_are_as_often_as_they_should_be():
    observer, rng = Observer(bias=0.2, lapse=0.02), np.random.default_rng(0)
    answers = [observer.choose(1.0, 1.1, 5, rng) for _ in range(20_000)]
    assert np.mean(np.array(answers) == 2) == pytest.approx(float(observer.second_probability(1.0, 1.1)), abs=0.015)
    settings = [observer.match(2.0, 5, rng) for _ in range(20_000)]
    assert np.std(settings) * 0.6745 == pytest.approx(observer.jnd(2.0), rel=0.02)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"weber": -1.0}, "weber is -1.0: expected a finite number, 0 or more"),
        ({"lapse": 0.5}, "lapse is 0.5: expected less than 0.5"),
        ({"weber": 0.0}, "weber and absolute are both 0"),
        ({"bias": np.inf}, "bias is inf"),
        ({"learning_trials": 0.0}, "learning_trials is 0.0"),
    ],
)
def test_bad_observers(options, message):
    with pytest.raises(ValueError, match=message):
        Observer(**options)
