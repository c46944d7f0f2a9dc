"""The generalised inverse of semidefinite matrices of every rank, and of one whose first pivot would mislead."""

import jax
import numpy as np
import pytest

from jaxgrasp.numerics import pivoted_ldl

SIZE, COUNT = 6, 40
LEAST = 1e-11


def of_rank(rank: int, seed: int = 1) -> np.ndarray:
    """Return matrices ``(COUNT, SIZE, SIZE)`` with eigenvalues between 0.01 and 1, and zeros."""
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(COUNT, SIZE, SIZE)))
    values = np.exp(rng.uniform(np.log(0.01), 0, (COUNT, SIZE))) * (np.arange(SIZE) < rank)
    return axes * values[:, None] @ axes.transpose(0, 2, 1)


@jax.jit
def solve(matrices, right):
    factors = pivoted_ldl.factor(matrices.transpose(1, 2, 0), LEAST)
    return pivoted_ldl.solve(factors, right.T).T


def times(matrices, x):
    return np.einsum("bij,bj->bi", matrices, x)


@pytest.mark.parametrize("rank", range(SIZE + 1))
def test_what_lies_in_the_range_is_solved(rank):
    matrices = of_rank(rank)
    right = times(matrices, np.random.default_rng(2).normal(size=(COUNT, SIZE)))
    x = np.asarray(solve(matrices, right))
    np.testing.assert_allclose(times(matrices, x), right, atol=1e-12)
    assert (np.sum(x != 0, -1) <= rank).all()


@pytest.mark.parametrize("rank", range(SIZE + 1))
def test_what_lies_beyond_it_is_not_blown_up(rank):
    right = np.random.default_rng(3).normal(size=(COUNT, SIZE))
    assert np.abs(solve(of_rank(rank), right)).max() < 1e4


def test_a_small_first_pivot_does_not_hide_the_rank():
    """A matrix of rank two keeps it though its first row is almost zero."""
    rng = np.random.default_rng(4)
    factor = rng.normal(size=(COUNT, SIZE, 2))
    factor[:, 0] *= 1e-5
    matrices = factor @ factor.transpose(0, 2, 1)
    x = rng.normal(size=(COUNT, SIZE))
    solved = np.asarray(solve(matrices, times(matrices, x)))
    np.testing.assert_allclose(times(matrices, solved), times(matrices, x), atol=1e-11)
    assert np.abs(solve(matrices, x)).max() < 1e4


def test_it_is_its_own_transpose():
    rng = np.random.default_rng(5)
    u, v = rng.normal(size=(2, COUNT, SIZE))
    matrices = of_rank(4)
    np.testing.assert_allclose(np.sum(u * solve(matrices, v), -1), np.sum(v * solve(matrices, u), -1), rtol=1e-9)


def test_derivative_by_the_matrix_is_the_inverse_s():
    matrices, moved = of_rank(SIZE), of_rank(SIZE, seed=6)
    right = np.random.default_rng(7).normal(size=(COUNT, SIZE))
    x, tangent = jax.jvp(lambda m: solve(m, right), (matrices,), (moved,))
    np.testing.assert_allclose(tangent, -solve(matrices, times(moved, np.asarray(x))), rtol=1e-6, atol=1e-6)
