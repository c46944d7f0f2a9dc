"""Analyses of variance: against SciPy, a textbook's example, paired t tests, and what rounding allows."""

import numpy as np
import pytest
from scipy.stats import f_oneway, ttest_ind, ttest_rel

from jaxgrasp.psychophysics.analysis.anova import (
    compare_conditions,
    compare_groups,
    holm,
    one_way,
    one_way_of_summaries,
    repeated_measures,
    rounding_interval,
)

TRAINING = np.array([[45, 50, 55], [42, 42, 45], [36, 41, 43], [39, 35, 40], [51, 55, 59], [44, 49, 56]], float)
"""A textbook's repeated measures: six persons' fitness before, and after three and six months of exercise. F(2, 10) =
12.53, p = 0.002, sums of squares 143.44 of time, 658.28 of persons, 57.22 left."""


def groups(seed: int, sizes=(5, 8, 6)) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.normal(k, 1 + k, size) for k, size in enumerate(sizes)]


@pytest.mark.parametrize("seed", range(5))
def test_one_way_is_scipys(seed):
    values = groups(seed)
    ours, theirs = one_way(values), f_oneway(*values)
    assert ours.f == pytest.approx(theirs.statistic) and ours.p_value == pytest.approx(theirs.pvalue)
    sizes = [len(group) for group in values]
    again = one_way_of_summaries([g.mean() for g in values], [g.std(ddof=1) for g in values], sizes)
    assert again.f == pytest.approx(ours.f) and again.within == sum(sizes) - 3 and again.between == 2
    grand = np.concatenate(values)
    explained = sum(len(g) * (g.mean() - grand.mean()) ** 2 for g in values)
    assert ours.eta_squared == pytest.approx(explained / np.sum((grand - grand.mean()) ** 2))
    assert ours.omega_squared < ours.eta_squared


def test_two_groups_are_a_t_test():
    a, b, _ = groups(1)
    assert one_way([a, b]).f == pytest.approx(ttest_ind(a, b).statistic ** 2)
    (pair,) = compare_groups([a, b])
    assert pair.p_value == pytest.approx(ttest_ind(a, b).pvalue, rel=1e-4)
    assert pair.difference == pytest.approx(a.mean() - b.mean())


def test_a_textbook_of_repeated_measures():
    anova = repeated_measures(TRAINING)
    assert (anova.between, anova.within) == (2, 10)
    assert anova.f == pytest.approx(12.53, abs=0.005) and anova.p_value == pytest.approx(0.002, abs=0.0005)
    assert anova.eta_squared == pytest.approx(143.44 / (143.44 + 57.22), abs=1e-4)
    assert anova.generalized_eta_squared == pytest.approx(143.44 / (143.44 + 57.22 + 658.28), abs=1e-4)


def test_repeated_measures_of_two_are_a_paired_t_test():
    pair = TRAINING[:, :2]
    anova = repeated_measures(pair)
    assert anova.f == pytest.approx(ttest_rel(*pair.T).statistic ** 2)
    assert anova.sphericity == pytest.approx(1) and anova.corrected_p_value == pytest.approx(anova.p_value)
    (compared,) = compare_conditions(pair)
    assert compared.p_value == pytest.approx(ttest_rel(*pair.T).pvalue)


def test_sphericity_is_that_of_the_eigenvalues():
    rng = np.random.default_rng(0)
    table = rng.normal(size=(12, 4)) @ rng.normal(size=(4, 4))
    basis = np.linalg.qr(np.column_stack([np.ones(4), np.eye(4)[:, :3]]))[0][:, 1:]
    values = np.linalg.eigvalsh(basis.T @ np.cov(table, rowvar=False) @ basis)
    anova = repeated_measures(table)
    assert anova.sphericity == pytest.approx(values.sum() ** 2 / (3 * np.sum(values**2)))
    assert 1 / 3 <= anova.sphericity <= 1
    assert repeated_measures(TRAINING).corrected_p_value > repeated_measures(TRAINING).p_value


def test_what_does_not_matter():
    """Units, an offset, a person's own level, and the order of persons and conditions."""
    anova = repeated_measures(TRAINING)
    rng = np.random.default_rng(0)
    others = (7 * TRAINING, TRAINING + 3, TRAINING + rng.normal(size=(6, 1)), TRAINING[::-1], TRAINING[:, ::-1])
    for other_table in others:
        again = repeated_measures(other_table)
        assert again.f == pytest.approx(anova.f) and again.sphericity == pytest.approx(anova.sphericity)


def test_holm():
    """Holm's own steps: the smallest times m, the next times m - 1 but not less, none above one."""
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.6, 0.7])), [1, 1])


@pytest.mark.parametrize("means, deviations", [((0.244, 0.135), (0.052, 0.036)), ((1.0, 1.2, 0.9), (0.3, 0.2, 0.4))])
def test_rounding_interval_holds_all_that_rounds_so(means, deviations):
    sizes = [5] * len(means)
    low, high = rounding_interval(means, deviations, sizes, 0.1 if len(means) == 3 else 0.001)
    step = 0.1 if len(means) == 3 else 0.001
    rng = np.random.default_rng(0)
    values = [
        one_way_of_summaries(
            np.array(means) + rng.uniform(-step / 2, step / 2, len(means)),
            np.array(deviations) + rng.uniform(-step / 2, step / 2, len(means)),
            sizes,
        ).f
        for _ in range(500)
    ]
    assert low <= min(values) and max(values) <= high
    assert min(values) < low + 0.2 * (high - low) + 1e-9 and max(values) > high - 0.6 * (high - low)


def test_no_spread_at_all_rounds_to_any_f():
    low, high = rounding_interval([0.1, 0.2], [0.004, 0.003], [5, 5], 0.01)
    assert 0 < low < high == np.inf


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: one_way([np.ones(3)]), "means, deviations, counts have shapes"),
        (lambda: one_way([np.ones(3), np.ones(1)]), r"groups\[1\] has shape \(1,\): expected at least two values"),
        (lambda: one_way([np.ones(3), np.array([1, np.nan])]), r"groups\[1\]\[1\] is nan"),
        (lambda: one_way([np.ones(3), np.ones(3)]), "deviations are all 0"),
        (lambda: one_way_of_summaries([1, 2], [-1, 1], [5, 5]), r"deviations\[0\] is -1"),
        (lambda: repeated_measures(np.ones((3, 1))), r"shape \(3, 1\): expected \(subjects, conditions\)"),
        (lambda: repeated_measures(np.array([[1, 2], [np.nan, 3]])), r"values\[1, 0\] is nan.*leave this subject"),
        (lambda: repeated_measures(np.array([[1.0, 2], [2, 3]])), "no residual variance"),
    ],
)
def test_bad_tables(unchecked, call, message):
    with pytest.raises(ValueError, match=message):
        call()
