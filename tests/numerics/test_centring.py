"""Centred points and tangents: laws that hold whatever the array module, and at every degenerate end."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.numerics.geometry import centred, tangents


def points(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(5, 4, 3)), rng.uniform(size=(5, 4)) > 0.3


@pytest.mark.parametrize("numpy", [np, jnp])
def test_arms_sum_to_zero_and_have_their_radius(numpy):
    given_points, is_present = points()
    middle, arms, radius = centred(numpy.asarray(given_points), numpy.asarray(is_present), numpy=numpy)
    np.testing.assert_allclose(np.sum(arms, 1), 0, atol=1e-14)
    count = np.maximum(is_present.sum(1), 1)
    np.testing.assert_allclose(np.sum(np.asarray(arms) ** 2, (1, 2)), count * np.asarray(radius) ** 2, rtol=1e-13)
    moved = centred(numpy.asarray(given_points + [1.0, 2, 3]), numpy.asarray(is_present), numpy=numpy)
    np.testing.assert_allclose(moved.arms, arms, atol=1e-14)
    there_is_some = is_present.any(1)[:, None]
    np.testing.assert_allclose(np.where(there_is_some, moved.middle - middle, [1, 2, 3]), [[1, 2, 3]] * 5, rtol=1e-13)


def test_points_that_coincide_have_no_radius_and_no_wild_derivative():
    coincident = np.full((1, 3, 3), 0.1) + np.array([0.7, 0.3, 1e3])
    is_present = np.ones((1, 3), bool)
    assert centred(coincident, is_present, numpy=np).radius == 0
    assert np.isfinite(jax.grad(lambda p: jnp.sum(centred(p, is_present).radius))(jnp.asarray(coincident))).all()
    near = coincident + 1e-3 * np.eye(3)
    assert np.isclose(centred(near, is_present, numpy=np).radius[0], 1e-3 * np.sqrt(2 / 3), rtol=1e-6)


def test_absent_points_count_nothing_whatever_they_are():
    given_points, is_present = points()
    spoiled = np.where(is_present[..., None], given_points, np.nan)
    for expected, spoiled_value in zip(
        centred(given_points, is_present, numpy=np), centred(spoiled, is_present, numpy=np), strict=True
    ):
        np.testing.assert_array_equal(expected, spoiled_value)


@pytest.mark.parametrize("numpy", [np, jnp])
def test_tangents_and_normal_are_an_orthonormal_frame(numpy):
    normals = np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(1).normal(size=(20, 3))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    first, second = tangents(numpy.asarray(normals), numpy)
    frame = np.stack([normals, first, second], 1)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.tile(np.eye(3), (26, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frame), 1, rtol=1e-13)


def test_a_normal_of_zero_has_tangents_of_zero():
    assert not np.any(tangents(np.zeros((2, 3)), np))
