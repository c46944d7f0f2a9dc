"""Derivatives in tiles are those of the rule in JAX: tangents, their transposes, and where there are any."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.solver import derivative_primitives, phases
from jaxgrasp.solver.in_kernel import MOVED
from jaxgrasp.solver.transforms import as_solution
from jaxgrasp.testing.problems import problems
from tests.solver.derivatives import CASES, N, assert_derivatives_agree, drawn_problem, pulled_back


@pytest.fixture(autouse=True)
def in_tiles(monkeypatch):
    """Have batches of any size computed in tiles, without the C++ kernel."""
    monkeypatch.setattr(derivative_primitives, "LEAST_TILED", 1)
    monkeypatch.setenv("JAXGRASP_KERNEL", "0")
    jax.clear_caches()
    yield
    jax.clear_caches()


SLOW = {("ordinary", 9), ("some_zero_squeeze", N), ("coincident_all", N), ("zero_friction", N)}
MARKED = [pytest.param(*case, marks=pytest.mark.slow) if case[:2] in SLOW else case for case in CASES]


@pytest.mark.parametrize(("kind", "n", "is_soft", "is_bounded", "constrained"), MARKED)
@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)])
def test_transpose_in_tiles_is_that_of_the_rule(kind, n, is_soft, is_bounded, constrained, dtype):
    problem = drawn_problem(kind, n, is_soft, is_bounded, dtype)
    solve = phases.solve_optimum if constrained else phases.solve_closed
    solution = as_solution(jax.jit(solve)(problem))
    rng = np.random.default_rng(8)
    given = [getattr(solution, name) for name in MOVED]
    cotangents = [jnp.asarray(rng.normal(size=x.shape), dtype) for x in given if x is not None]
    arguments = problem, solution, cotangents
    by_field, has_derivatives = jax.jit(
        partial(pulled_back, constrained=constrained, tangent_of=derivative_primitives.tangent)
    )(*arguments)
    expected, expected_mask = jax.jit(partial(pulled_back, constrained=constrained))(*arguments)
    assert np.array_equal(has_derivatives, expected_mask)
    assert np.any(expected_mask) == (kind != "infeasible")
    assert_derivatives_agree(by_field, expected, dtype)


def forces(points, normals, friction, squeeze, wrench):
    return jaxgrasp.constrained_optimum(jaxgrasp.Grasp(points, normals, friction, squeeze), wrench).forces


def squares(*arrays):
    return jnp.sum(forces(*arrays) ** 2)


def test_forward_equals_reverse_and_finite_differences():
    """A batch of more than a tile, whose last tile overlaps the one before it."""
    arrays = problems("ordinary", N, 70, seed=43)[1:6]
    rng = np.random.default_rng(3)
    directions = tuple(rng.normal(size=array.shape) for array in arrays)
    pulls = rng.normal(size=70)

    def squares_of_each(*arrays):
        return jnp.sum(forces(*arrays) ** 2, (1, 2))

    text = str(jax.make_jaxpr(jax.grad(squares, range(5)))(*arrays))
    assert "grasp_pullback" in text
    value, derivative = jax.linearize(squares_of_each, *arrays)
    np.testing.assert_allclose(np.sum(value), squares(*arrays), rtol=1e-12)
    forward = np.asarray(derivative(*directions))
    reverse = jax.linear_transpose(derivative, *arrays)(pulls)
    by_reverse = sum(np.sum(np.asarray(g) * d, tuple(range(1, d.ndim))) for g, d in zip(reverse, directions))
    np.testing.assert_allclose(by_reverse, pulls * forward, rtol=1e-9, atol=1e-12 * np.abs(pulls * forward).max())
    step = 1e-6
    ends = [
        squares_of_each(*(a + sign * step * d for a, d in zip(arrays, directions, strict=True))) for sign in (1, -1)
    ]
    error = np.abs((ends[0] - ends[1]) / (2 * step) - forward) / (np.abs(forward) + np.abs(value))
    # Some have a kink within the step.
    assert np.quantile(error, 0.9) < 1e-6


@pytest.mark.slow
def test_derivatives_of_second_order_are_those_of_the_rule(monkeypatch):
    arrays = problems("ordinary", N, 40, seed=44)[1:6]

    def derivatives():
        hessian = jax.grad(lambda *x: sum(map(jnp.sum, jax.grad(squares, (3, 4))(*x))), range(5))(*arrays)
        jacobian = jax.vmap(jax.jacrev(forces, (3, 4)))(*arrays)
        return jax.device_get((hessian, jacobian))

    in_tiles = derivatives()
    monkeypatch.setattr(derivative_primitives, "LEAST_TILED", 10**9)
    jax.clear_caches()
    for tiled, plain in zip(jax.tree.leaves(in_tiles), jax.tree.leaves(derivatives()), strict=True):
        np.testing.assert_allclose(tiled, plain, rtol=1e-7, atol=1e-9 * np.abs(plain).max())


@pytest.mark.parametrize("size", [1, 999, 1000])
def test_small_batches_keep_the_rule(monkeypatch, size):
    monkeypatch.setattr(derivative_primitives, "LEAST_TILED", 1000)
    drawn = drawn_problem("ordinary", 2, False, False)
    problem = jax.tree.map(lambda array: jnp.resize(array, (size, *array.shape[1:])), drawn)
    shapes = jax.eval_shape(lambda: as_solution(phases.solve_closed(problem)))
    solution = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    text = str(jax.make_jaxpr(lambda moved: derivative_primitives.tangent(problem, moved, solution, False))(problem))
    assert ("grasp_tangent" in text) == (size >= 1000)
