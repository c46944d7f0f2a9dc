"""Predictions: recovery of what is there, precision, and what a device's errors do; against simulation."""

import numpy as np
import pytest

from jaxgrasp.paper.tables import DIFFERENCES
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.prediction import (
    RenderingError,
    by_bootstrap,
    by_likelihood,
    cheapest,
    hit_chances,
    hit_probability_through,
    jnd_through,
    precision,
    shares_of_device,
    simulated_hits,
)
from jaxgrasp.psychophysics.psychometric import QUARTILE, Observer, PsychometricShape, hit_probability

LEVELS = np.array(DIFFERENCES)


@pytest.mark.parametrize(
    "shape, width",
    [(PsychometricShape.DIFFERENCE, 1.0), (PsychometricShape.WEIBULL, 0.8), (PsychometricShape.GAUSSIAN, 0.15)],
)
def test_recovery(shape, width):
    """At a hundred trials a level, little bias and honest intervals; 400 experiments say no more than this."""
    chances = hit_probability(shape, LEVELS, 0.16, width)
    hits = np.random.default_rng(0).binomial(100, chances, (400, 4))
    for name, estimates in by_likelihood(hits, 100, LEVELS, Model(shape, lapse=(0.0, 0.0)), 0.16).items():
        # A prior that is even in logarithms pulls a Gaussian function's threshold down by a third of its deviation.
        assert abs(estimates.bias) < (0.03 if name == "likelihood" else 0.06), name
        assert 0.92 <= estimates.coverage <= 0.98, name
        assert estimates.outside < 0.01


def test_bootstrap_covers_its_own_truth():
    """A straight line's truth is where it goes with endless answers."""
    ratios = np.array([0.55, 0.62, 0.78, 0.9])
    slope, begin = np.polyfit(LEVELS, ratios, 1)
    rng = np.random.default_rng(0)
    hits = rng.binomial(200, ratios, (200, 4))
    estimates = by_bootstrap(hits, 200, LEVELS, Model(), (0.75 - begin) / slope, "line", 300, rng)
    assert 0.90 <= estimates.coverage <= 0.985 and abs(estimates.bias) < 0.02


def test_simulated_answers():
    observer = Observer(0.15, lapse=0.02, bias=0.3)
    hits = simulated_hits(observer, 2.0, LEVELS, 50, 4000, np.random.default_rng(0))
    np.testing.assert_allclose(hits.mean(0) / 50, observer.hit_probability(2.0, 2.0 * (1 + LEVELS)), atol=0.006)
    learner = Observer(0.15, learning=2.0, learning_trials=30.0)
    hits = simulated_hits(learner, 2.0, LEVELS, 20, 600, np.random.default_rng(0))
    np.testing.assert_allclose(hits.mean(0) / 20, hit_chances(learner, 2.0, 2 * (1 + LEVELS), 20), atol=0.02)


@pytest.mark.slow
def test_precision_grows_with_the_root_of_trials():
    observer = Observer(0.15)
    few, many = (precision(observer, 2.0, LEVELS, trials, 4) for trials in (100, 400))
    assert many.within == pytest.approx(few.within / 2, rel=0.15)
    assert many.standard_error == pytest.approx(many.within / 2)
    designs = cheapest(0.012, observer, 2.0, LEVELS, between=0.03)
    assert designs and all(design.standard_error <= 0.012 for design in designs)
    totals = [design.total(4) for design in designs]
    assert totals == sorted(totals)
    assert not cheapest(1e-5, observer, 2.0, LEVELS, between=0.03)
    with pytest.raises(ValueError, match="target_error is 0"):
        cheapest(0.0, observer, 2.0, LEVELS)


ERROR = RenderingError(quantum=0.05, friction=0.2, pretension=0.5, stiction=0.03, lag=0.1, motions=5.0)


def test_deviation_is_that_of_a_simulation():
    """Tensions through cables that pull by exp(+-friction) as the direction of each motion has it, and the rest."""
    rng, count = np.random.default_rng(0), 200_000
    ways = rng.choice([-1.0, 1.0], (count, 5))
    by_direction = 2.5 * np.mean(np.exp(0.2 * ways), 1) + 2.0 * np.mean(0.1 * rng.choice([-1.0, 1.0], (count, 5)), 1)
    sensed = by_direction + rng.normal(0, 0.03, count) + rng.uniform(-0.025, 0.025, count)
    assert sensed.std() == pytest.approx(ERROR.deviation(2.0), rel=0.01)


def test_hits_through_a_device_are_those_of_a_simulation():
    rng, count, observer = np.random.default_rng(1), 200_000, Observer(0.1)
    first, second = 2.0, 2.3
    noise = observer.jnd(first) / QUARTILE / np.sqrt(2)
    sensed = [x + rng.normal(0, noise, count) + rng.normal(0, ERROR.deviation(x), count) for x in (first, second)]
    assert np.mean(sensed[1] > sensed[0]) == pytest.approx(
        float(hit_probability_through(observer, ERROR, first, second)), abs=0.004
    )


def test_jnd_through_a_device():
    observer = Observer(0.1, 0.02)
    assert jnd_through(observer, RenderingError(), 2.0) == pytest.approx(observer.jnd(2.0))
    jnd = jnd_through(observer, ERROR, 2.0)
    assert hit_probability_through(observer, ERROR, 2.0, 2.0 + jnd) == pytest.approx(0.75)
    shares = shares_of_device(observer, ERROR, 2.0)
    assert shares["none"] == pytest.approx(observer.jnd(2.0)) and shares["all"] == jnd == max(shares.values())
    parts = {"none", "quantum", "friction", "friction and pretension", "stiction", "lag", "all"}
    assert set(shares) == parts
    limited = RenderingError(limit=2.1)
    assert jnd_through(observer, limited, 2.0) == np.inf and jnd_through(observer, limited, 1.0) == pytest.approx(
        observer.jnd(1.0)
    )
    assert jnd_through(Observer(0.1, lapse=0.02), RenderingError(), 2.0) > 0.2


def test_errors_are_monotone():
    observer = Observer(0.1)
    for name in ("quantum", "friction", "stiction", "lag"):
        jnds = [jnd_through(observer, RenderingError(**{name: value}), 2.0) for value in (0.0, 0.1, 0.3)]
        assert jnds == sorted(jnds) and jnds[2] > jnds[0]
    averaged = [jnd_through(observer, RenderingError(friction=0.3, motions=float(n)), 2.0) for n in (1, 4, 100)]
    assert averaged == sorted(averaged, reverse=True)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: RenderingError(friction=-1.0), "friction is -1.0"),
        (lambda: RenderingError(limit=0.0), "limit is 0.0: expected a positive"),
        (lambda: jnd_through(Observer(lapse=0.3), RenderingError(), 1.0), "criterion is 0.75"),
        (lambda: jnd_through(Observer(), RenderingError(), -1.0), "reference is -1.0: expected a finite number"),
        (lambda: jnd_through(Observer(), RenderingError(), 0.0), "where this observer notices any difference"),
        (lambda: cheapest(1e-200, Observer(), 2.0, LEVELS), "target_error is 1e-200"),
        (lambda: cheapest(0.1, Observer(), 2.0, LEVELS, between=1e200), "between is 1e\\+200"),
    ],
)
def test_bad_errors(call, message):
    with pytest.raises(ValueError, match=message):
        call()
