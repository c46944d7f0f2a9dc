"""Singular values of the scaled grasp matrix: known ones, those of NumPy, laws, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.quality import grasp_isotropy, grasp_volume, least_singular_value, singular_values
from tests.quality import known

METRICS = (
    singular_values,
    least_singular_value,
    grasp_volume,
    grasp_isotropy,
)


def test_known_values():
    """On a unit circle three contacts have sqrt(3) four times and sqrt(1.5) twice; six on a unit ball sqrt(6), 2."""
    triangle = singular_values(known.star([0, 120, 240], 0.5, radius=1.0))
    np.testing.assert_allclose(triangle, np.sqrt([3, 3, 3, 3, 1.5, 1.5]), rtol=1e-12)
    six = known.on_axes(0.5)
    np.testing.assert_allclose(singular_values(six), [6**0.5] * 3 + [2.0] * 3, rtol=1e-12)
    np.testing.assert_allclose(grasp_volume(six), 6**1.5 * 8, rtol=1e-12)
    np.testing.assert_allclose(grasp_isotropy(six), 2 / 6**0.5, rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_they_are_those_of_the_matrix(n):
    grasp = known.ordinary(n, 20)
    computed = singular_values(grasp, length=0.04, about=np.array([0.1, 0.0, 0.0]))
    matrix = np.array(jaxgrasp.grasp_matrix(grasp.points - [0.1, 0.0, 0.0]))
    matrix[:, 3:] /= 0.04
    expected = np.zeros((20, 6))
    values = np.linalg.svd(matrix)[1]
    expected[:, : values.shape[1]] = values
    np.testing.assert_allclose(computed, expected, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(
        grasp_volume(grasp, length=0.04),
        np.prod(singular_values(grasp, length=0.04), -1),
        rtol=1e-12,
    )


def test_wrenches_out_of_reach_have_zero_and_finite_derivatives():
    line = known.grasp_of(np.outer([-1, 0.3, 1], [0.02, 0.03, 0.06]), np.eye(3), 0.8)
    one_place = known.grasp_of(np.full((4, 3), 0.3), np.eye(3)[[0, 1, 2, 0]], 0.9)
    nobody = known.changed(known.triangle(), present=np.zeros(3))
    for grasp in (known.two_fingers(None), known.star([0], 0.5), line, one_place, nobody):
        for metric in METRICS[1:]:
            assert abs(metric(grasp)) < 1e-14
        slopes = jax.jit(jax.grad(lambda g: sum(jnp.sum(metric(g)) for metric in METRICS)))(known.of_jax(grasp))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


@pytest.mark.parametrize("metric", METRICS)
def test_laws_and_derivatives(metric):
    grasp = known.ordinary(4, 10)
    plain = metric(grasp)
    for other_grasp in (
        known.turned(grasp)[0],
        known.changed(grasp, points=grasp.points + [1.0, 2.0, 3.0]),
        known.changed(grasp, points=grasp.points[:, ::-1]),
        known.changed(grasp, points=100 * grasp.points),
        known.padded(grasp),
    ):
        np.testing.assert_allclose(metric(other_grasp), plain, rtol=1e-9)
    points = jnp.asarray(grasp.points)
    tangent = jnp.asarray(0.03 * np.random.default_rng(0).normal(size=points.shape))

    @jax.jit
    def of(points):
        return metric(known.changed(known.of_jax(grasp), points=points))

    value, forward = jax.jvp(of, (points,), (tangent,))
    reverse, back = jax.vjp(of, points)
    np.testing.assert_allclose(value, plain)
    weights = np.random.default_rng(1).normal(size=np.shape(plain))
    (slope,) = back(jnp.asarray(weights))
    np.testing.assert_allclose(np.sum(slope * tangent), np.sum(weights * forward), rtol=1e-10)
    numeric = (of(points + 1e-6 * tangent) - of(points - 1e-6 * tangent)) / 2e-6
    np.testing.assert_allclose(forward, numeric, rtol=1e-6, atol=1e-7 * np.abs(plain).max())


def test_a_longer_unit_lessens_them_and_second_derivatives_are_refused():
    grasp = known.ordinary(5, 10)
    short, long = (singular_values(grasp, length=length) for length in (0.03, 0.06))
    assert (long <= short * (1 + 1e-12)).all() and (2 * long >= short * (1 - 1e-12)).all()
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        jax.hessian(lambda p: grasp_volume(known.changed(known.triangle(), points=p)))(jnp.eye(3))
