"""Psychometric functions pass their criterion, rise from chance to what lapses leave, and keep their scale."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxgrasp.psychophysics.analysis.likelihood import Model
from jaxgrasp.psychophysics.psychometric import PsychometricShape, hit_probability, quantile, standard

SHAPES = pytest.mark.parametrize("shape", list(PsychometricShape))


@SHAPES
def test_quantile_is_the_inverse(shape):
    shares = np.linspace(0.01, 0.99, 50)
    np.testing.assert_allclose(standard(shape, quantile(shape, shares)), shares, rtol=1e-12)


@SHAPES
@given(st.floats(0.01, 5), st.floats(0.05, 3), st.floats(0, 0.1), st.floats(0.6, 0.85), st.sampled_from([0.25, 0.5]))
def test_it_passes_the_criterion_and_rises(shape, threshold, width, lapse, criterion, chance):
    options = {"criterion": criterion, "chance": chance}
    assert hit_probability(shape, threshold, threshold, width, lapse, **options) == pytest.approx(criterion)
    levels = np.linspace(0, 100 * threshold + 100 * width, 200)
    chances = hit_probability(shape, levels, threshold, width, lapse, **options)
    assert np.all(np.diff(chances) >= -1e-12) and np.all((chances >= chance) & (chances <= 1 - lapse + 1e-12))
    if shape in (PsychometricShape.WEIBULL, PsychometricShape.DIFFERENCE):
        assert chances[0] == chance


@SHAPES
def test_scale(shape):
    levels = np.linspace(0.01, 1, 30)
    once = hit_probability(shape, levels, 0.2, 0.1, 0.02)
    width = 0.1 if shape is PsychometricShape.WEIBULL else 0.7
    np.testing.assert_allclose(hit_probability(shape, 7 * levels, 1.4, width, 0.02), once, rtol=1e-12)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"criterion": 0.5}, "criterion is 0.5: expected more than chance, 0.5, and less than 0.95"),
        ({"criterion": 0.96}, "criterion is 0.96"),
        ({"chance": 1.0}, "chance is 1.0: expected 0 or more, and less than 1"),
        ({"lapse": (0.1, 0.05)}, r"lapse is \(0.1, 0.05\): expected its smallest and largest"),
        ({"lapse": (0.0, 0.6)}, "lapse is 0.6"),
        ({"shape": "cubic"}, "cubic"),
    ],
)
def test_bad_models(unchecked, options, message):
    with pytest.raises(ValueError, match=message):
        Model(**options)
