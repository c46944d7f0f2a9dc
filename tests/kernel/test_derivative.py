"""Derivatives by the C++ kernel are those of the rule in JAX, in reverse, forward and of second order."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Verdict
from jaxgrasp import kernel as package
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import derivative, in_kernel
from jaxgrasp.solver.in_kernel import MOVED, MOVING, Wanted
from jaxgrasp.solver.transforms import as_solution
from jaxgrasp.testing.problems import problems
from tests.kernel.conftest import problem_of

pytest.importorskip("warp")
N, COUNT = 4, 100


def drawn_problem(kind: str, n: int, is_soft: bool, is_bounded: bool, dtype=np.float64) -> ProblemBatch:
    """Draw problems, some contacts of which are absent where there are soft fingers."""
    rng, problem = np.random.default_rng(7), problems(kind, n, COUNT, seed=41)
    names, shape = ("points", "normals", "friction", "squeeze", "wrench"), problem.friction.shape
    arrays = {name: getattr(problem, name) for name in names}
    if is_soft:
        arrays["torsion"] = rng.uniform(0, 0.02, shape) * (rng.uniform(size=shape) < 0.8)
        arrays["present"] = (rng.uniform(size=shape) < 0.9).astype(float)
    if is_bounded:
        arrays["normal_min"] = rng.uniform(0.01, 0.5, shape) * problem.squeeze
        most = arrays["normal_min"] + rng.uniform(0.5, 6, shape) * problem.squeeze.mean(-1, keepdims=True)
        arrays["normal_max"] = np.where(rng.uniform(size=shape) < 0.3, np.inf, most)
    return jax.tree.map(jnp.asarray, problem_of({name: np.asarray(x, dtype) for name, x in arrays.items()}))


def pulled_back_in_jax(problem: ProblemBatch, solution, cotangents: list, constrained: bool):
    """Return the derivatives by the rule in JAX, and where there are any."""
    zeros = jax.tree.map(jnp.zeros_like, problem)
    fields = {name: getattr(zeros, name) for name in MOVING if getattr(problem, name) is not None}

    def tangent(moved):
        parts = derivative.tangent(problem, replace(zeros, **moved), solution, constrained)
        return [getattr(parts, name) for name in MOVED if getattr(solution, name) is not None], ~parts.undefined

    _, pull, has_derivatives = jax.vjp(tangent, fields, has_aux=True)
    return pull(cotangents)[0], has_derivatives


CASES = [
    ("ordinary", 9, False, False, True),
    ("ordinary", N, True, True, True),
    ("ordinary", N, True, True, False),
    ("ordinary", N, False, True, True),
    ("some_zero_squeeze", N, False, False, True),
    ("coincident_all", N, False, False, True),
    ("zero_friction", N, False, False, True),
    ("infeasible", N, False, False, True),
]


@pytest.mark.parametrize(("kind", "n", "is_soft", "is_bounded", "constrained"), CASES)
@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)])
def test_pullback_is_that_of_the_rule_in_jax(kind, n, is_soft, is_bounded, constrained, dtype):
    problem = drawn_problem(kind, n, is_soft, is_bounded, dtype)
    wanted = Wanted(closed_form=not constrained, optimum=constrained)
    solve = partial(in_kernel.solve_traced, wanted=wanted, phases=lambda problem: None)
    solution = as_solution(jax.jit(solve)(problem))
    rng = np.random.default_rng(8)
    given = [getattr(solution, name) for name in MOVED]
    cotangents = [None if x is None else jnp.asarray(rng.normal(size=x.shape), dtype) for x in given]
    answer = [getattr(solution, name) for name in in_kernel.ANSWER]
    by_field, has_derivatives = jax.jit(partial(in_kernel.pull_back, constrained=constrained))(
        problem, answer, cotangents
    )
    expected, expected_mask = jax.jit(partial(pulled_back_in_jax, constrained=constrained))(
        problem, solution, [x for x in cotangents if x is not None]
    )
    assert np.array_equal(has_derivatives, expected_mask)
    assert np.any(expected_mask) == (kind != "infeasible")
    assert np.all(np.isin(solution.verdict, (Verdict.INFEASIBLE, Verdict.NOT_CONVERGED)) != expected_mask)
    assert by_field.keys() == expected.keys()
    for name, value in by_field.items():
        other = np.asarray(expected[name])
        axes = tuple(range(1, other.ndim))
        largest = np.abs(other).max(axes)
        scale = np.maximum(largest, 1e-9 * largest.max())
        error = np.abs(value - other).max(axes)
        if dtype == np.float64:
            assert np.all(error <= 1e-9 * scale), name
        else:
            assert np.mean(error <= 1e-2 * scale) >= 0.95, name


def forces(points, normals, friction, squeeze, wrench):
    return jaxgrasp.constrained_optimum(jaxgrasp.Grasp(points, normals, friction, squeeze), wrench).forces


def squares(*arrays):
    return jnp.sum(forces(*arrays) ** 2)


def gradient_of_a_gradient(*arrays):
    return jax.grad(lambda *x: sum(map(jnp.sum, jax.grad(squares, (3, 4))(*x))), 4)(*arrays)


def of_all(derivative_of, size: int):
    """Return a derivative by all arrays of some problems."""
    problem = problems("ordinary", N, size, seed=43)
    return derivative_of(*problem[1:6])


TRANSFORMS = {
    "grad": jax.grad(squares, range(5)),
    "jit of vmap of grad": jax.jit(jax.vmap(jax.grad(squares, range(5)))),
    "grad of vmap": jax.grad(lambda *x: jnp.sum(jax.vmap(squares)(*x)), range(5)),
    "vmap of jacrev": jax.vmap(jax.jacrev(forces, range(5))),
    "vmap of jacfwd": jax.vmap(jax.jacfwd(forces, (3, 4))),
    "vmap of hessian": jax.vmap(jax.hessian(squares, (3, 4))),
    "gradient of a gradient": jax.grad(
        lambda *x: jnp.sum(jnp.stack([*map(jnp.sum, jax.grad(squares, (3, 4))(*x))])), 4
    ),
    "grad by the wrenches of one grasp": lambda *x: jax.grad(squares, range(5))(*(array[0] for array in x[:4]), x[4]),
}


SLOW = ("jit of vmap of grad", "vmap of jacrev", "vmap of jacfwd", "vmap of hessian", "gradient of a gradient")
"""Those that the JAX solver, the reference, takes long to compile."""


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in TRANSFORMS])
def test_every_mode_gives_the_derivatives_of_the_jax_solver(used_kernel, monkeypatch, name):
    results = of_all(TRANSFORMS[name], 3)
    jax.clear_caches()
    monkeypatch.setattr(package, "_choice", False)
    expected = of_all(TRANSFORMS[name], 3)
    for value, other in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
        assert np.allclose(value, other, rtol=1e-6, atol=1e-8 * np.abs(other).max())


def test_the_derivative_of_no_answer_is_nan(used_kernel):
    problem = problems("infeasible", N, 2, seed=44)
    by_wrench = jax.grad(lambda *arrays: jnp.sum(forces(*arrays)), 4)(*problem[1:6])
    assert np.all(np.isnan(by_wrench))


def test_reverse_mode_traces_no_rule_in_jax(used_kernel, monkeypatch):
    def refuse(*_):
        raise AssertionError("the rule in JAX is traced")

    monkeypatch.setattr(derivative, "tangent", refuse)
    jax.clear_caches()
    problem = problems("ordinary", N, 5, seed=45)
    assert np.all(np.isfinite(jax.grad(squares, 3)(*problem[1:6])))
