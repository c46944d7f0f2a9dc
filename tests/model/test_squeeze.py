"""Eq. 6 and Table I."""

import jax
import numpy as np
import pytest

from jaxgrasp.grip import CYLINDRICAL_POWER_GRIP as TABLE
from jaxgrasp.grip import squeezing


def test_squeeze_is_contribution_times_stiffness_times_depth():
    np.testing.assert_allclose(squeezing(1.44, 1000.0, 0.002), 2.88, rtol=1e-15)


def test_an_open_contact_does_not_squeeze():
    np.testing.assert_array_equal(squeezing(1.0, 500.0, np.array([-0.001, 0.0, 0.001])), [0, 0, 0.5])


def test_derivative_by_depth():
    slope = jax.vmap(jax.grad(lambda depth: squeezing(2.0, 300.0, depth)))(np.array([-0.001, 0.001]))
    np.testing.assert_array_equal(slope, [0, 600])


def test_table_sums_to_its_own_totals():
    np.testing.assert_allclose(TABLE.finger_totals, [3.60, 3.84, 2.76, 1.80], rtol=1e-14)
    np.testing.assert_allclose(TABLE.values.sum(), 12.00, rtol=1e-14)
    assert TABLE.values.shape == (len(TABLE.phalanges), len(TABLE.fingers))


def test_table_is_whole_percents_of_twelve():
    percents = TABLE.values / 0.12
    np.testing.assert_allclose(percents, np.round(percents), atol=1e-12)


def test_table_by_name():
    assert TABLE.of("middle", "distal") == 2.16
    assert TABLE.of("little", "middle") == 0.12
    with pytest.raises(KeyError, match="thumb.*index, middle, ring, little"):
        TABLE.of("thumb", "distal")
    with pytest.raises(KeyError, match="metacarpal.*proximal, middle, distal"):
        TABLE.of("index", "metacarpal")


def test_table_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        TABLE.values[0, 0] = 0.0
