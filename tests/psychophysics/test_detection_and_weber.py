"""d' and Weber fractions: their definitions, symmetries, and what goes in them."""

import math

import numpy as np
import pytest
from scipy.stats import linregress, norm

from jaxgrasp.paper.tables import JND, REFERENCE_WEIGHTS
from jaxgrasp.psychophysics.analysis.cell import weber, weber_line
from jaxgrasp.psychophysics.analysis.counts import Counts, detection_sensitivity
from jaxgrasp.psychophysics.analysis.threshold import threshold
from jaxgrasp.psychophysics.psychometric import Observer


@pytest.mark.parametrize("share", [0.55, 0.75, 0.9])
def test_d_prime_without_bias_is_that_of_the_share(share):
    trials = 1000
    sensitivity = detection_sensitivity(round(share * trials), trials, round(share * trials), trials)
    assert sensitivity.d_prime == pytest.approx(math.sqrt(2) * norm.ppf(share)) and sensitivity.lean == pytest.approx(0)
    assert sensitivity.low < sensitivity.d_prime < sensitivity.high and not sensitivity.corrected


def test_a_lean_is_no_sensitivity():
    """Observers of the same sensitivity and different bias have one d', and the sign of their lean."""
    trials = 10**6
    sure = [Observer(bias=bias) for bias in (-0.5, 0.0, 0.5)]
    sensitivities = []
    for observer in sure:
        after, before = observer.second_probability(1.0, 1.2), 1 - observer.second_probability(1.2, 1.0)
        sensitivities.append(detection_sensitivity(round(before * trials), trials, round(after * trials), trials))
    d_primes = [sensitivity.d_prime for sensitivity in sensitivities]
    np.testing.assert_allclose(d_primes, d_primes[1], rtol=1e-4)
    assert sensitivities[0].lean < -0.1 and abs(sensitivities[1].lean) < 1e-4 and sensitivities[2].lean > 0.1


def test_swapped_orders_and_extremes():
    sensitivity, swapped = detection_sensitivity(8, 10, 6, 10), detection_sensitivity(6, 10, 8, 10)
    assert sensitivity.d_prime == pytest.approx(swapped.d_prime) and sensitivity.lean == pytest.approx(-swapped.lean)
    perfect = detection_sensitivity(10, 10, 10, 10)
    assert perfect.corrected and perfect.low < perfect.d_prime < perfect.high < np.inf
    assert math.isnan(detection_sensitivity(8, 10, 0, 0).lean)
    for arguments, message in (((3, 2, 1, 2), "first_hits is 3"), ((0, 0, 0, 0), "are 0: expected at least one trial")):
        with pytest.raises(ValueError, match=message):
            detection_sensitivity(*arguments)


@pytest.mark.parametrize("shares", [(0.7, 0.7), (0.95, 0.5), (0.6, 0.9)])
def test_intervals_of_d_prime_cover(shares):
    """Whatever the lean: as often as they say, over simulated answers."""
    rng, trials = np.random.default_rng(0), 80
    truth = sum(norm.ppf(shares)) / math.sqrt(2)
    hits = rng.binomial(trials, shares, (1500, 2))
    sensitivities = [detection_sensitivity(int(first), trials, int(second), trials) for first, second in hits]
    assert all(sensitivity.low < sensitivity.d_prime < sensitivity.high for sensitivity in sensitivities)
    assert 0.93 < np.mean([sensitivity.low <= truth <= sensitivity.high for sensitivity in sensitivities]) < 0.975


def test_weber():
    counts = Counts(np.array([0.05, 0.1, 0.2, 0.3]), np.array([59, 67, 82, 93]), np.full(4, 100))
    estimate = threshold(counts)
    estimate_of_weber = weber(estimate, 2.0)
    assert estimate_of_weber.fraction == estimate.value and estimate_of_weber.jnd == pytest.approx(2 * estimate.value)
    assert (estimate_of_weber.fraction_low, estimate_of_weber.fraction_high) == (
        estimate.low,
        estimate.high,
    ) and estimate_of_weber.jnd_high == 2 * estimate.high
    wider = weber(estimate, 2.0, spread=0.2)
    assert wider.fraction_low < estimate_of_weber.fraction_low and wider.fraction_high > estimate_of_weber.fraction_high
    assert wider.fraction_high - estimate.value == pytest.approx(
        math.hypot(estimate.high - estimate.value, 1.96 * 0.2 * estimate.value)
    )
    for options, message in (((0.0,), "reference is 0.0"), ((1.0, -1.0), "spread is -1.0")):
        with pytest.raises(ValueError, match=message):
            weber(estimate, *options)


def test_weber_line_is_scipys():
    line, theirs = weber_line(np.array(REFERENCE_WEIGHTS), np.array(JND)), linregress(REFERENCE_WEIGHTS, JND)
    assert line.limit == pytest.approx(theirs.slope) and line.floor == pytest.approx(theirs.intercept)
    assert line.limit_deviation == pytest.approx(theirs.stderr)
    assert line.floor_deviation == pytest.approx(theirs.intercept_stderr)
    two = weber_line(np.array([1.0, 2.0]), np.array([0.2, 0.3]))
    assert two.limit == pytest.approx(0.1) and math.isnan(two.limit_deviation)
    with pytest.raises(ValueError, match=r"deviations\[1\] is 0.0"):
        weber_line(np.array([1.0, 2.0]), np.array([0.2, 0.3]), np.array([1.0, 0.0]))
    with pytest.raises(ValueError, match="at least two different references"):
        weber_line(np.array([1.0, 1.0]), np.array([0.2, 0.3]))
    with pytest.raises(ValueError, match=r"jnds\[1\] is nan"):
        weber_line(np.array([1.0, 2.0]), np.array([0.2, math.nan]))


def test_weighted_line_follows_what_is_sure():
    references, jnds = np.array([1.0, 2.0, 3.0]), np.array([0.2, 0.3, 0.8])
    line = weber_line(references, jnds, np.array([1e-3, 1e-3, 10.0]))
    assert line.limit == pytest.approx(0.1, rel=1e-3) and line.floor == pytest.approx(0.1, rel=1e-2)
