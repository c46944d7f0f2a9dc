"""Thresholds: against independent maximisation, SciPy's lines and psignifit; and nothing made up."""

import math
from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import binomtest, chi2, norm

from jaxgrasp.paper.tables import DIFFERENCES, HIT_RATIOS
from jaxgrasp.psychophysics.analysis.counts import Counts, count, pooled, ratio_intervals
from jaxgrasp.psychophysics.analysis.finding import Finding
from jaxgrasp.psychophysics.analysis.likelihood import Likelihood, Model, log_likelihood
from jaxgrasp.psychophysics.analysis.threshold import goodness, threshold
from jaxgrasp.psychophysics.psychometric import PsychometricShape, hit_probability
from tests.turns import in_turns, later

LEVELS = np.array(DIFFERENCES)
TABLE = [Counts(LEVELS, np.round(100 * np.array(row)).astype(int), np.full(4, 100)) for row in HIT_RATIOS]
METHODS = pytest.mark.parametrize("method", ["likelihood", "posterior", "interpolation", "line", "paper"])
GAUSSIAN = Model(PsychometricShape.GAUSSIAN, lapse=(0.0, 0.0))


def gaussian_loss(location: float, scale: float, counts: Counts) -> float:
    chances = 0.5 + 0.5 * norm.cdf((counts.levels - location) / scale)
    return -log_likelihood(counts, chances)


@pytest.mark.parametrize("counts", TABLE)
def test_likelihood_is_at_its_maximum(counts):
    """Another parametrisation and another optimiser find the same maximum."""
    estimate = threshold(counts, model=GAUSSIAN)
    best = min(
        (
            minimize(lambda p: gaussian_loss(p[0], math.exp(p[1]), counts), start, tol=1e-10)
            for start in ([0.1, -2], [0.2, -1])
        ),
        key=lambda optimum: optimum.fun,
    )
    assert estimate.estimate == pytest.approx(best.x[0], rel=1e-3)
    function = estimate.function
    assert function is not None
    log_likelihoods = log_likelihood(counts, GAUSSIAN.hit_probability(counts.levels, function))
    assert log_likelihoods == pytest.approx(-best.fun, abs=1e-6)


@pytest.mark.parametrize("counts", TABLE[:2])
def test_profile_interval_ends_where_the_test_rejects(counts):
    estimate = threshold(counts, model=GAUSSIAN)
    least = -log_likelihood(counts, GAUSSIAN.hit_probability(counts.levels, estimate.function))
    for end in (estimate.low, estimate.high):
        loss = partial(lambda end, log_scale: gaussian_loss(end, math.exp(log_scale), counts), end)
        best = minimize_scalar(loss, bounds=(-4, 1.5), method="bounded")
        assert 2 * (best.fun - least) == pytest.approx(chi2.isf(0.05, 1), abs=0.1)


@pytest.mark.repeats
@pytest.mark.parametrize("shape", in_turns(PsychometricShape, quick=[PsychometricShape.LOGISTIC]))
@pytest.mark.parametrize("lapse", [(0.0, 0.0), pytest.param((0.0, 0.05), marks=pytest.mark.slow)])
def test_grid_finds_what_the_search_finds(shape, lapse):
    """Estimates of many sets of answers come from the grid alone."""
    model, trials = Model(shape, lapse=lapse), np.full(4, 100)
    chances = hit_probability(shape, LEVELS, 0.17, 1.0 if shape is PsychometricShape.WEIBULL else 0.15)
    hits = np.random.default_rng(0).binomial(100, chances, (30, 4))
    grid = Likelihood(LEVELS, model)
    by_grid = grid.estimates(hits, trials)
    by_search = [grid.best(Counts(LEVELS, row, trials)).threshold for row in hits]
    nearest = np.searchsorted(grid.thresholds, by_search)
    assert np.all(np.abs(by_grid - by_search) < np.gradient(grid.thresholds)[nearest])


def test_lines_are_those_of_numpy():
    for counts in TABLE:
        slope, begin = np.polyfit(counts.levels, counts.ratios, 1)
        assert threshold(counts, "line", interval="none").estimate == pytest.approx((0.75 - begin) / slope)
        slope, begin = np.polyfit([0, *counts.levels], [0.5, *counts.ratios], 1)
        assert threshold(counts, "paper", interval="none").estimate == pytest.approx((0.75 - begin) / slope)
        along = np.interp(0.75, counts.ratios, counts.levels)
        assert threshold(counts, "interpolation", interval="none").estimate == pytest.approx(along)


@METHODS
def test_scale_and_order(method):
    counts = TABLE[1]
    estimate = threshold(counts, method)
    scaled = threshold(Counts(7 * counts.levels, counts.hits, counts.trials), method)
    for name in ("estimate", "low", "high"):
        assert getattr(scaled, name) == pytest.approx(7 * getattr(estimate, name), rel=1e-5)
    turned = threshold(Counts(counts.levels[::-1], counts.hits[::-1], counts.trials[::-1]), method)
    assert turned.estimate == estimate.estimate and turned.low == estimate.low
    assert estimate.low < estimate.estimate < estimate.high


@pytest.mark.parametrize("interval", ["profile", "credible", "bootstrap", "bca"])
def test_intervals_agree_where_there_is_much_to_go_by(interval):
    trials = np.full(4, 4000)
    chances = hit_probability(PsychometricShape.WEIBULL, LEVELS, 0.15, 0.8)
    counts = Counts(LEVELS, np.round(trials * chances).astype(int), trials)
    model = Model(lapse=(0.0, 0.0))
    estimate, by_profile = threshold(counts, model=model, interval=interval), threshold(counts, model=model)
    assert estimate.estimate == pytest.approx(0.15, rel=2e-3)
    width = by_profile.high - by_profile.low
    assert abs(estimate.low - by_profile.low) < 0.12 * width and abs(estimate.high - by_profile.high) < 0.12 * width


@pytest.mark.parametrize("counts", TABLE)
def test_psignifit(counts):
    """Another program's fit of the same function lies within our interval, and ours within its."""
    psignifit = pytest.importorskip("psignifit")
    data = np.column_stack([counts.levels, counts.hits, counts.trials])
    theirs = psignifit.psignifit(data, experiment_type="2AFC", sigmoid="norm", fixed_parameters={"eta": 1e-4})
    place, ends = theirs.threshold(0.75)
    ours = threshold(counts, model=Model(PsychometricShape.GAUSSIAN))
    assert ours.low <= place <= ours.high
    low, high = ends["0.95"] if isinstance(ends, dict) else ends[0]
    assert low <= ours.estimate <= high


def of(*hits: int, trials: int = 20, levels=DIFFERENCES) -> Counts:
    return Counts(np.array(levels[: len(hits)]), np.array(hits), np.full(len(hits), trials))


@METHODS
@pytest.mark.parametrize(
    "counts, finding",
    [
        (of(20, 20, 20, 20), Finding.ALL_RIGHT),
        (of(10, 9, 11, 10), Finding.AT_CHANCE),
        (of(8, 6, 3, 1), Finding.BELOW_CHANCE),
        (of(15), Finding.ONE_LEVEL),
        (of(20, 19, 17, 13), Finding.NOT_RISING),
        (of(50, 55, 62, 70, trials=100), Finding.ABOVE_LEVELS),
        (of(18, 19, 19, 20), Finding.BELOW_LEVELS),
        (Counts(np.zeros(0), np.zeros(0, int), np.zeros(0, int)), Finding.NO_TRIALS),
        (Counts(LEVELS, np.zeros(4, int), np.zeros(4, int)), Finding.NO_TRIALS),
    ],
)
def test_nothing_is_made_up(method, counts, finding):
    estimate = threshold(counts, method)
    assert estimate.finding is finding and math.isnan(estimate.value) and estimate.finding.advice.endswith(".")
    assert estimate.low >= 0 and estimate.high > estimate.low


def test_what_settles_nothing_still_bounds():
    """All right: the threshold is not known, but it is not large."""
    estimate = threshold(of(20, 20, 20, 20))
    assert estimate.low == 0 and estimate.high < 0.2
    assert threshold(of(10, 9, 11, 10)).low > 0.1


def test_one_level_is_enough_for_one_parameter():
    estimate = threshold(of(15), model=Model(PsychometricShape.DIFFERENCE, lapse=(0.0, 0.0)))
    assert estimate.finding is Finding.FOUND and estimate.value == pytest.approx(0.05, rel=1e-3)
    assert threshold(of(14), model=Model(PsychometricShape.DIFFERENCE, lapse=(0.0, 0.0))).finding is not Finding.FOUND


@pytest.mark.parametrize("counts", [of(99, trials=100, levels=(0.1,)), of(97, 97, trials=100, levels=(0.1, 0.2))])
def test_lapses_may_explain_all(counts):
    """Nearly all right at large levels: any small threshold will do, with lapses, and none is named."""
    estimate = threshold(counts, model=Model(PsychometricShape.DIFFERENCE))
    assert estimate.finding is Finding.BELOW_LEVELS and estimate.low == 0 and math.isnan(estimate.value)


def test_guesses_do_not_bound_from_above():
    """The upper quantile of a posterior that has not fallen off is the prior's, so it is not reported."""
    estimate = threshold(of(10, 9, 11, 10), "posterior")
    assert estimate.low > 0.05 and estimate.high == np.inf


@pytest.mark.parametrize("trials", [*later(10_000), 1_000_000])
def test_with_very_many_answers(trials):
    rng = np.random.default_rng(0)
    chances = hit_probability(PsychometricShape.WEIBULL, LEVELS, 0.15, 0.8, 0.02)
    for _ in range(6):
        counts = Counts(LEVELS, rng.binomial(trials, chances), np.full(4, trials))
        estimate = threshold(counts)
        assert estimate.low < estimate.estimate < estimate.high and estimate.estimate == pytest.approx(
            0.15, rel=5 / trials**0.5
        )
        away = estimate.high - estimate.estimate, estimate.estimate - estimate.low
        assert 0.5 < away[0] / away[1] < 2


def test_missing_levels_are_left_out():
    expected = threshold(TABLE[1])
    more = Counts(np.append(LEVELS, 0.5), np.append(TABLE[1].hits, 0), np.append(TABLE[1].trials, 0))
    assert threshold(more).estimate == expected.estimate


def test_goodness():
    fits = goodness(TABLE[1])
    assert fits.p_value > 0.5 and fits.deviance == pytest.approx(np.sum(np.square(fits.residuals)))
    wild = Counts(np.linspace(0.05, 0.4, 8), np.array([50, 95, 52, 96, 55, 97, 60, 98]), np.full(8, 100))
    assert goodness(wild).p_value < 0.01


@pytest.mark.slow
def test_goodness_of_what_is_right_is_even():
    """Over answers drawn from a function, p values are as often below any share as that share."""
    rng = np.random.default_rng(1)
    model = Model(PsychometricShape.DIFFERENCE, lapse=(0.0, 0.0))
    chances = hit_probability(model.shape, LEVELS, 0.15)
    p_values = [
        goodness(Counts(LEVELS, rng.binomial(60, chances), np.full(4, 60)), model, resamples=199, seed=k).p_value
        for k in range(60)
    ]
    assert 0.3 < np.mean(p_values) < 0.7 and np.mean(np.array(p_values) < 0.1) < 0.3


def test_counts():
    counts = count(np.array([0.2, 0.1, 0.2, 0.1]), np.array([True, False, True, True]))
    assert counts.levels.tolist() == [0.1, 0.2] and counts.hits.tolist() == [1, 2] and counts.trials.tolist() == [2, 2]
    pooled_counts = pooled([counts, count(np.array([0.3]), np.array([False]))])
    assert pooled_counts.levels.tolist() == [0.1, 0.2, 0.3] and pooled_counts.hits.tolist() == [1, 2, 0]
    ends = ratio_intervals(counts)
    assert np.all((ends[:, 0] <= counts.ratios) & (counts.ratios <= ends[:, 1]))


@pytest.mark.parametrize(
    "levels, hits, trials, message",
    [
        ([0.1, 0.1], [1, 1], [2, 2], r"levels\[1\] is 0.1 again"),
        ([0.1, math.nan], [1, 1], [2, 2], r"levels\[1\] is nan"),
        ([0.1], [3], [2], r"hits\[0\] is 3: expected at most its 2 trials"),
        ([0.1], [1.5], [2], r"hits\[0\] is 1.5: expected a whole number"),
        ([0.1], [1, 2], [2], "have shapes"),
    ],
)
def test_bad_counts(unchecked, levels, hits, trials, message):
    with pytest.raises(ValueError, match=message):
        Counts(np.array(levels), np.array(hits), np.array(trials))


def test_bad_requests(unchecked):
    for options, message in (
        ({"method": "guess"}, "method is 'guess'"),
        ({"method": "line", "interval": "profile"}, "interval is 'profile': expected one of bootstrap"),
        ({"coverage": 1.0}, "coverage is 1.0"),
    ):
        with pytest.raises(ValueError, match=message):
            threshold(TABLE[0], **options)


@pytest.mark.parametrize("method", ["wilson", "exact"])
def test_ratio_intervals_are_scipys(method):
    trials = np.full(11, 10)
    counts = Counts(np.linspace(0.1, 1.1, 11), np.arange(11), trials)
    theirs = [binomtest(k, 10).proportion_ci(0.9, method) for k in range(11)]
    np.testing.assert_allclose(
        ratio_intervals(counts, 0.9, method), [[interval.low, interval.high] for interval in theirs], atol=1e-12
    )
