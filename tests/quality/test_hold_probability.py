"""The probability of holding a load: known cases, its interval, what the draws are, and the slope of the mean."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from jaxgrasp import Grasp, Limits
from jaxgrasp.quality import hold_probability

LIMITS = Limits(normal_max=np.full(2, 5.0))
LIFT = np.array([0.0, 0, 1, 0, 0, 0])


def pinch(friction: float = 0.5, torsion: float | None = None) -> Grasp:
    """Return a pinch of at most 5 N each: it lifts the sum of two frictions times 5 N."""
    points, normals = np.array([[-0.03, 0, 0], [0.03, 0, 0]]), np.array([[1.0, 0, 0], [-1, 0, 0]])
    soft = None if torsion is None else np.full(2, torsion)
    return Grasp(points, normals, np.full(2, friction), np.ones(2), torsion=soft)


@pytest.mark.slow
def test_what_is_certain_has_probability_one_or_zero():
    for load, share, margin in ((4 * LIFT, 1, 0.25), (8 * LIFT, 0, -0.375)):
        probability = hold_probability(pinch(), load, limits=LIMITS, samples=64)
        assert float(probability.probability) == share
        np.testing.assert_allclose(probability.margin, margin, rtol=1e-7)
        assert (
            float(probability.low) <= share <= float(probability.high)
            and float(probability.high - probability.low) < 0.06
        )


@pytest.mark.slow
def test_a_normal_load_is_held_as_often_as_the_normal_distribution_says():
    """Lifted by 5 N at most, a load of 4.5 N with a deviation of 0.5 N is held in 84.1 %."""
    spread = np.array([0.0, 0, 0.5, 0, 0, 0])
    probability = hold_probability(pinch(), 4.5 * LIFT, limits=LIMITS, load_spread=spread, samples=1000, seed=3)
    assert float(probability.low) < norm.cdf(1) < float(probability.high)
    assert float(probability.probability) == np.mean(np.asarray(probability.margins) >= 0)


@pytest.mark.slow
def test_the_interval_is_wilsons():
    """Against scipy's."""
    from scipy.stats import binomtest

    probability = hold_probability(pinch(), 4.8 * LIFT, limits=LIMITS, friction_spread=0.1, samples=64, confidence=0.9)
    held = round(64 * float(probability.probability))
    assert 0 < held < 64
    expected = binomtest(held, 64).proportion_ci(0.9, method="wilson")
    np.testing.assert_allclose([probability.low, probability.high], expected, rtol=1e-9)


@pytest.mark.slow
def test_friction_is_log_normal():
    """Both fingers carry half: 10 N times the smaller of two frictions is held."""
    probability = hold_probability(pinch(), 4.5 * LIFT, limits=LIMITS, friction_spread=0.2, samples=1000)
    assert float(probability.low) < norm.cdf(-np.log(4.5 / 5) / 0.2) ** 2 < float(probability.high)


@pytest.mark.slow
def test_places_move_in_their_tangent_planes():
    """Fingers that do not face each other hold less: soft ones a little, hard ones nothing, which would turn."""
    moved = hold_probability(pinch(torsion=0.01), 4 * LIFT, limits=LIMITS, place_spread=1e-3, samples=64)
    margins = np.asarray(moved.margins)
    assert (margins < 0.25).all() and (margins > 0).all() and margins.std() > 1e-4
    hard = hold_probability(pinch(), 4 * LIFT, limits=LIMITS, place_spread=1e-3, samples=64)
    assert float(hard.probability) == 0


@pytest.mark.slow
def test_a_batch_meets_the_same_draws_as_each_alone_and_seeds_differ():
    many = jax.tree.map(lambda x: np.stack([x, x]), pinch())
    many = Grasp(many.points, many.normals, np.array([[0.5, 0.5], [0.6, 0.6]]), many.squeeze)
    options = {"limits": LIMITS, "friction_spread": 0.1, "samples": 64}
    probability = hold_probability(many, 4.8 * LIFT, **options)
    alone = hold_probability(pinch(), 4.8 * LIFT, **options)
    np.testing.assert_allclose(probability.margins[:, 0], alone.margins, rtol=1e-9)
    assert (probability.margins[:, 1] > probability.margins[:, 0]).all()
    other_probability = hold_probability(pinch(), 4.8 * LIFT, **options, seed=1)
    assert np.abs(np.asarray(other_probability.margins - alone.margins)).max() > 0.01
    again = hold_probability(pinch(), 4.8 * LIFT, **options)
    np.testing.assert_array_equal(again.margins, alone.margins)


@pytest.mark.slow
def test_the_slope_of_the_mean_is_that_of_its_differences():
    three = np.array([[0.04, 0, 0], [-0.02, 0.035, 0], [-0.02, -0.035, 0.005]])
    normals = -three / np.linalg.norm(three, axis=1, keepdims=True)
    limits = Limits(normal_max=np.full(3, 4.0))
    load = np.array([0.3, 0.2, 3.0, 0.01, 0, 0.005])

    @jax.jit
    def mean(points, friction, wrench, spread):
        grasp = Grasp(points, jnp.asarray(normals), friction, jnp.ones(3), torsion=0.01 * jnp.ones(3))
        return hold_probability(
            grasp, wrench, limits=limits, friction_spread=spread, place_spread=0.001, samples=64
        ).margin

    arrays = tuple(map(jnp.asarray, (three, np.full(3, 0.6), load, 0.1)))
    slopes = jax.grad(mean, argnums=(0, 1, 2, 3))(*arrays)
    rng = np.random.default_rng(0)
    tangent = [scale * rng.normal(size=np.shape(a)) for a, scale in zip(arrays, (0.01, 0.1, 0.1, 0.1))]
    forward = sum(np.sum(np.asarray(a) * b) for a, b in zip(slopes, tangent))
    step = 1e-5
    ends = [float(mean(*(a + sign * b for a, b in zip(arrays, tangent)))) for sign in (step, -step)]
    assert forward == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-3)


@pytest.mark.usefixtures("unchecked")
def test_bad_options_are_named():
    for arguments, message in (
        ({"samples": 0}, "samples is 0: expected a number of cases, 1 or more"),
        ({"confidence": 1.0}, "confidence is 1.0: expected a number between 0 and 1"),
        ({"friction_spread": -0.1}, "friction_spread is -0.1: expected zero or more"),
        ({"load_spread": np.array([0, 0, -1.0, 0, 0, 0])}, r"load_spread\[2\] is -1.0: expected zero or more"),
        ({"load_spread": np.ones(3)}, r"load_spread has shape \(3,\): expected \(..., 6\)"),
    ):
        with pytest.raises(ValueError, match=message):
            hold_probability(pinch(), LIFT, limits=LIMITS, **arguments)
