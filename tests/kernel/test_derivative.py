"""Derivatives by the C++ kernel are those of the rule in JAX, in reverse, forward and of second order."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Verdict
from jaxgrasp import kernel as package
from jaxgrasp.solver import derivative, in_kernel
from jaxgrasp.solver.in_kernel import MOVED, Wanted
from jaxgrasp.solver.transforms import as_solution
from jaxgrasp.testing.problems import problems
from tests.solver.derivatives import CASES, N, assert_derivatives_agree, drawn_problem, pulled_back

pytest.importorskip("warp")


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
    expected, expected_mask = jax.jit(partial(pulled_back, constrained=constrained))(
        problem, solution, [x for x in cotangents if x is not None]
    )
    assert np.array_equal(has_derivatives, expected_mask)
    assert np.any(expected_mask) == (kind != "infeasible")
    assert np.all(np.isin(solution.verdict, (Verdict.INFEASIBLE, Verdict.NOT_CONVERGED)) != expected_mask)
    assert_derivatives_agree(by_field, expected, dtype)


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
