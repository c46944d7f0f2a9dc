"""Unrolled factorisations against NumPy's, and the laws that make them worth it."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.numerics import ldl


def symmetric(size: int, count: int = 40, seed: int = 0) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(count, size, size + 2))
    return root @ root.transpose(0, 2, 1)


def lower(matrices: np.ndarray) -> list[list[jnp.ndarray]]:
    return [[jnp.asarray(matrices[:, i, j]) for j in range(i + 1)] for i in range(matrices.shape[1])]


@pytest.mark.parametrize("size", [1, 3, 6, 9])
def test_it_solves_and_multiplies_as_numpy_does(size):
    matrices = symmetric(size)
    right = np.random.default_rng(1).normal(size=(size, len(matrices)))
    x = np.stack(ldl.solve(ldl.factor(lower(matrices)), [*map(jnp.asarray, right)]))
    expected = np.linalg.solve(matrices, right.T[..., None])[..., 0].T
    np.testing.assert_allclose(x, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())
    back = np.stack(ldl.multiply(lower(matrices), [*map(jnp.asarray, x)]))
    np.testing.assert_allclose(back, np.einsum("bij,jb->ib", matrices, x), rtol=1e-12, atol=1e-12)


def test_pivots_have_the_signs_of_the_matrix():
    matrices = symmetric(4) - 4 * np.eye(4)
    _, diagonal = ldl.factor(lower(matrices))
    signs = np.sort(np.sign(np.stack(diagonal)), 0)
    np.testing.assert_array_equal(signs, np.sort(np.sign(np.linalg.eigvalsh(matrices)), 1).T)


def test_scales_by_powers_of_two_change_no_digit():
    matrices, powers = symmetric(4), 2.0 ** np.array([-30, 0, 17, 40])
    _, plain = ldl.factor(lower(matrices))
    _, scaled = ldl.factor(lower(matrices * powers * powers[:, None]))
    np.testing.assert_array_equal(np.stack(scaled), np.stack(plain) * powers[:, None] ** 2)


def test_principal_axes_diagonalise():
    matrices = np.concatenate([symmetric(3), np.tile(np.eye(3), (1, 1, 1)), np.diag([3.0, 1, 2])[None]])
    axes = np.stack([np.stack(axis) for axis in ldl.principal_axes(lower(matrices))])  # (axis, component, B)
    frame = axes.transpose(2, 0, 1)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1), np.tile(np.eye(3), (42, 1, 1)), atol=1e-14)
    turned = frame @ matrices @ frame.transpose(0, 2, 1)
    values = np.sort(np.einsum("bii->bi", turned), 1)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrices), rtol=1e-12, atol=1e-13)
    off = turned - np.einsum("bi,ij->bij", np.einsum("bii->bi", turned), np.eye(3))
    assert np.abs(off).max() < 1e-12 * np.abs(matrices).max()
