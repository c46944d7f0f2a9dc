"""d' and Weber fractions: their definitions, symmetries, and what goes in them."""

import math

import numpy as np
import pytest
from scipy.stats import linregress, norm

from jaxgrasp.paper.tables import REFERENCE_WEIGHTS
from jaxgrasp.paper.weight_perception import JND
from jaxgrasp.psychophysics.analysis.cell import weber, weber_line
from jaxgrasp.psychophysics.analysis.counts import Counts, detection_sensitivity
from jaxgrasp.psychophysics.analysis.threshold import threshold
from jaxgrasp.psychophysics.psychometric import Observer


@pytest.mark.parametrize("share", [0.55, 0.75, 0.9])
def test_d_prime_without_bias_is_that_of_the_share(share):
    trials = 1000
    found = detection_sensitivity(round(share * trials), trials, round(share * trials), trials)
    assert found.d_prime == pytest.approx(math.sqrt(2) * norm.ppf(share)) and found.lean == pytest.approx(0)
    assert found.low < found.d_prime < found.high and not found.corrected


def test_a_lean_is_no_sensitivity():
    """Observers of the same sensitivity and different bias have one d', and the sign of their lean."""
    trials = 10**6
    sure = [Observer(bias=bias) for bias in (-0.5, 0.0, 0.5)]
    found = []
    for one in sure:
        after, before = one.second_probability(1.0, 1.2), 1 - one.second_probability(1.2, 1.0)
        found.append(detection_sensitivity(round(before * trials), trials, round(after * trials), trials))
    d_primes = [one.d_prime for one in found]
    np.testing.assert_allclose(d_primes, d_primes[1], rtol=1e-4)
    assert found[0].lean < -0.1 and abs(found[1].lean) < 1e-4 and found[2].lean > 0.1


def test_swapped_orders_and_extremes():
    one, other = detection_sensitivity(8, 10, 6, 10), detection_sensitivity(6, 10, 8, 10)
    assert one.d_prime == pytest.approx(other.d_prime) and one.lean == pytest.approx(-other.lean)
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
    found = [detection_sensitivity(int(first), trials, int(second), trials) for first, second in hits]
    assert all(one.low < one.d_prime < one.high for one in found)
    assert 0.93 < np.mean([one.low <= truth <= one.high for one in found]) < 0.975


def test_weber():
    counts = Counts(np.array([0.05, 0.1, 0.2, 0.3]), np.array([59, 67, 82, 93]), np.full(4, 100))
    found = threshold(counts)
    one = weber(found, 2.0)
    assert one.fraction == found.value and one.jnd == pytest.approx(2 * found.value)
    assert (one.fraction_low, one.fraction_high) == (found.low, found.high) and one.jnd_high == 2 * found.high
    wider = weber(found, 2.0, spread=0.2)
    assert wider.fraction_low < one.fraction_low and wider.fraction_high > one.fraction_high
    assert wider.fraction_high - found.value == pytest.approx(
        math.hypot(found.high - found.value, 1.96 * 0.2 * found.value)
    )
    for options, message in (((0.0,), "reference is 0.0"), ((1.0, -1.0), "spread is -1.0")):
        with pytest.raises(ValueError, match=message):
            weber(found, *options)


def test_weber_line_is_scipys():
    found, theirs = weber_line(np.array(REFERENCE_WEIGHTS), np.array(JND)), linregress(REFERENCE_WEIGHTS, JND)
    assert found.limit == pytest.approx(theirs.slope) and found.floor == pytest.approx(theirs.intercept)
    assert found.limit_deviation == pytest.approx(theirs.stderr)
    assert found.floor_deviation == pytest.approx(theirs.intercept_stderr)
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
    found = weber_line(references, jnds, np.array([1e-3, 1e-3, 10.0]))
    assert found.limit == pytest.approx(0.1, rel=1e-3) and found.floor == pytest.approx(0.1, rel=1e-2)
