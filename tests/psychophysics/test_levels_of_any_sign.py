"""Steep functions, signed and logarithmic levels: against profiles by SciPy, and under changes of the levels' axis."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.special import expit, ndtr, xlogy

from jaxgrasp.psychophysics.analysis.counts import Counts
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.analysis.threshold import goodness, threshold
from jaxgrasp.psychophysics.psychometric import PsychometricShape, hit_probability
from tests.turns import in_turns

WEIGHTS = np.array([94, 96, 98, 99, 100, 101, 102, 104, 106.0])
"""Weights in grams of 'is it heavier than 100 g?'."""
SIXTY = np.full(9, 60)
RISES = {"gaussian": ndtr, "logistic": expit}


def equality(shape: str) -> Model:
    """Return the model of a point of subjective equality: from never to always, at half of the answers."""
    return Model(PsychometricShape(shape), criterion=0.5, chance=0.0, lapse=(0.0, 0.0))


def profile_by_scipy(counts: Counts, shape: str) -> tuple[float, float, float, float]:
    """Compute the point of equality, its 95 % profile interval, and the width, without any of the package's code."""

    def loss(location: float, log_width: float) -> float:
        chances = np.clip(RISES[shape]((counts.levels - location) / math.exp(log_width)), 1e-12, 1 - 1e-12)
        return -float(np.sum(xlogy(counts.hits, chances) + xlogy(counts.trials - counts.hits, 1 - chances)))

    options = {"xatol": 1e-8, "fatol": 1e-10}
    extent, middle = np.ptp(counts.levels), counts.levels.mean()
    best = minimize(
        lambda p: loss(middle + extent * p[0], p[1]), [0, math.log(extent / 5)], method="Nelder-Mead", options=options
    )
    location = middle + extent * best.x[0]

    def rejected(x: float) -> float:
        least = minimize(lambda s: loss(x, s[0]), [best.x[1]], method="Nelder-Mead", options=options).fun
        return 2 * (least - best.fun) - 3.841459

    low, high = (brentq(rejected, location, location + side * extent / 3, xtol=1e-9 * extent) for side in (-1, 1))
    return location, low, high, math.exp(best.x[1])


@pytest.mark.parametrize("shape", ["gaussian", "logistic"])
@pytest.mark.parametrize(
    "levels, location, width",
    [
        (WEIGHTS, 100.5, 1.5),
        (WEIGHTS - 100, 0.5, 1.5),
        (1e-3 * (WEIGHTS - 200), -0.0995, 0.0012),
        (1e6 + WEIGHTS, 1e6 + 99.0, 0.6),
    ],
)
def test_point_of_equality_is_scipys(shape, levels, location, width):
    hits = np.round(60 * ndtr((levels - location) / width)).astype(int)
    counts = Counts(levels, hits, SIXTY)
    result, expected = threshold(counts, model=equality(shape)), profile_by_scipy(counts, shape)
    assert result.finding is Finding.FOUND and result.function is not None
    got = [result.value, result.low, result.high, result.function.width]
    np.testing.assert_allclose(got, expected, rtol=0, atol=2e-3 * (expected[2] - expected[1]))


@pytest.mark.parametrize("method", ["likelihood", "posterior"])
def test_offset_unit_and_side_of_levels(method):
    """Threshold and interval shift, scale and flip with the levels if the function depends on their differences."""
    hits = np.round(60 * ndtr((WEIGHTS - 100.5) / 1.5)).astype(int)
    model = equality("gaussian")
    first = threshold(Counts(WEIGHTS, hits, SIXTY), method, model=model)
    moved = threshold(Counts(0.01 * (WEIGHTS - 120), hits, SIXTY), method, model=model)
    turned = threshold(Counts(-WEIGHTS, 60 - hits, SIXTY), method, model=model)
    atol = 1e-3 * (first.high - first.low)
    ends = np.array([first.estimate, first.low, first.high])
    np.testing.assert_allclose(100 * np.array([moved.estimate, moved.low, moved.high]) + 120, ends, rtol=0, atol=atol)
    np.testing.assert_allclose([-turned.estimate, -turned.high, -turned.low], ends, rtol=0, atol=atol)


@pytest.mark.parametrize("per_octave", [1.0, 20.0])
def test_gumbel_is_weibull_of_logarithms(per_octave):
    levels, hits, trials = np.array([0.1, 0.2, 0.4, 0.8]), np.array([55, 62, 85, 99]), np.full(4, 100)
    lapse = (0.0, 0.0)
    weibull = threshold(Counts(levels, hits, trials), model=Model(lapse=lapse))
    logs = per_octave * np.log10(levels)
    gumbel = threshold(Counts(logs, hits, trials), model=Model(PsychometricShape.GUMBEL, lapse=lapse))
    ends = np.log10([weibull.estimate, weibull.low, weibull.high])
    np.testing.assert_allclose(np.array([gumbel.estimate, gumbel.low, gumbel.high]) / per_octave, ends, atol=2e-3)
    assert gumbel.function is not None and weibull.function is not None
    assert gumbel.function.width == pytest.approx(per_octave / math.log(10) * weibull.function.width, rel=1e-3)


def test_steep_weibull():
    """Levels far from zero lie close in logarithms: the function of them is as steep as theirs."""
    chances = hit_probability(PsychometricShape.WEIBULL, WEIGHTS, 100.5, 0.01, criterion=0.5, chance=0.0)
    counts = Counts(WEIGHTS, np.round(600 * chances).astype(int), 10 * SIXTY)
    model = equality("weibull")
    result = threshold(counts, model=model)
    assert result.finding is Finding.FOUND and result.value == pytest.approx(100.5, abs=0.05)
    assert result.function is not None and result.function.width == pytest.approx(0.01, rel=0.05)
    assert goodness(counts, model, resamples=200).p_value > 0.5


@pytest.mark.parametrize("shape", in_turns(["gaussian", "logistic", "weibull"], quick=["gaussian"]))
@pytest.mark.parametrize("hits, low, high", [([0, 30, 60], 99.8, 100.2), ([0, 0, 60], 100, 101)])
def test_steeper_than_the_levels(shape, hits, low, high):
    """No answer bounds the width from below: a finding of its own, with the threshold that they do bound."""
    result = threshold(Counts(np.array([99, 100, 101.0]), np.array(hits), np.full(3, 60)), model=equality(shape))
    assert result.finding is Finding.STEEPER and result.finding.has_threshold
    assert low < result.low < result.value < result.high < high


@pytest.mark.parametrize("step", [1, 100])
def test_flatter_than_the_levels(step):
    """A width of thousands of the levels' extents is found; a rise that chance explains bounds no threshold."""
    counts = Counts(np.array([-1, 0, 1.0]), 500_000 + step * np.array([-1, 0, 1]), np.full(3, 10**6))
    result = threshold(counts, model=equality("gaussian"))
    assert result.function is not None
    assert result.function.width == pytest.approx(1e6 / math.sqrt(2 * math.pi) / step, rel=0.01)
    assert (result.low, result.high) == (-np.inf, np.inf)


@pytest.mark.parametrize("method", ["likelihood", "posterior", "interpolation", "line"])
@pytest.mark.parametrize(
    "hits, finding", [([0, 0, 0], Finding.AT_CHANCE), ([60, 60, 60], Finding.ALL_RIGHT), ([58, 59, 60], None)]
)
def test_signed_levels_have_no_smallest_one(method, hits, finding):
    """Levels that do not bound a threshold from below have an interval that is open below, not one that ends at 0."""
    counts = Counts(np.array([-2, 1, 3.0]), np.array(hits), np.full(3, 60))
    result = threshold(counts, method, model=equality("gaussian"))
    assert result.finding is (finding or Finding.BELOW_LEVELS) and math.isnan(result.value)
    if finding is Finding.ALL_RIGHT:
        assert result.low == -np.inf
    if finding is None:
        assert result.low < -2


@pytest.mark.parametrize("shape", ["weibull", "difference"])
def test_shapes_that_start_at_zero_refuse_negative_levels(unchecked, shape):
    counts = Counts(np.array([-2.0, 1, 3]), np.array([1, 5, 9]), np.full(3, 10))
    for call in (threshold, goodness):
        with pytest.raises(ValueError, match=rf"counts.levels\[0\] is -2: the shape '{shape}' needs .*'gumbel'"):
            call(counts, model=Model(PsychometricShape(shape)))
    with pytest.raises(ValueError, match=r"levels\[1\] is -0.5: the shape"):
        hit_probability(PsychometricShape(shape), np.array([0.1, -0.5]), 0.2)
    with pytest.raises(ValueError, match=r"counts.levels\[0\] is -2"):
        threshold(counts, "paper")
    assert threshold(counts, "line").finding is Finding.FOUND
