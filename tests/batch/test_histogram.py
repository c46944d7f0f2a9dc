"""Distributions that merge: quantiles near those of the values, whatever the parts they came in."""

import numpy as np
import pytest

from jaxgrasp.batch.chunk_statistics import LogHistogram


@pytest.mark.parametrize("count", [1, 2, 50, 3000])
def test_quantiles_are_those_of_the_values_to_half_a_bin_and_none_beyond_the_largest(count):
    values = np.exp(np.random.default_rng(count).normal(size=count))
    halves = LogHistogram.of(values[::2]).merged(LogHistogram.of(values[1::2]))
    assert halves.to_json() == LogHistogram.of(values).to_json()
    for share in (0.05, 0.5, 0.95, 1.0):
        exact = np.quantile(values, share, method="inverted_cdf")
        assert np.isclose(halves.quantile(share), exact, rtol=0.061), share
        assert halves.quantile(share) <= values.max()
    assert halves.quantile(1.0) == values.max()
