"""Nonlinear least squares: where it ends nothing goes further down."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares as by_scipy

from jaxgrasp.numerics.small_minimisers import least_squares


def bent(x: jax.Array) -> jax.Array:
    """Return the residuals of Rosenbrock's valley, and a term that keeps the least value from zero."""
    return jnp.stack([10 * (x[1] - x[0] ** 2), 1 - x[0], 0.3 * jnp.sin(x[0]) + 0.2])


def test_it_finds_the_minimum_that_scipy_finds_from_many_starts():
    starts = np.random.default_rng(0).uniform(-2, 2, (20, 2))
    minima = jax.jit(jax.vmap(lambda start: least_squares(bent, start, 100)))(starts)
    for start, point, cost in zip(starts, minima.point, minima.cost, strict=True):
        expected = by_scipy(lambda x: np.asarray(bent(x)), start)
        np.testing.assert_allclose(point, expected.x, atol=1e-5)
        np.testing.assert_allclose(cost, 2 * expected.cost, rtol=1e-9)


def test_of_linear_residuals_it_finds_the_solution_of_the_normal_equations():
    rng = np.random.default_rng(1)
    matrix, right = rng.normal(size=(8, 3)), rng.normal(size=8)
    minimum = least_squares(lambda x: matrix @ x - right, jnp.zeros(3), 30)
    np.testing.assert_allclose(minimum.point, np.linalg.lstsq(matrix, right)[0], atol=1e-9)
    np.testing.assert_allclose(minimum.residuals, matrix @ np.asarray(minimum.point) - right, atol=1e-14)


def test_it_never_goes_up_and_steps_back_from_what_is_not_a_number():
    costs = [float(least_squares(lambda x: jnp.log(x) + 2, jnp.array([9.0]), steps).cost) for steps in range(1, 25)]
    assert np.isfinite(costs).all() and (np.diff(costs) <= 0).all() and costs[-1] < 1e-12
