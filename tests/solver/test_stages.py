"""Plain calls compile stage by stage: what is left out changes no bit of an answer."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Route, Verdict
from jaxgrasp.numerics.compiled_code import jit_here
from jaxgrasp.problem.flatten import flatten
from jaxgrasp.solver import phases, programs
from jaxgrasp.testing import problems as P

N = 4
at_once = jit_here(phases.solve_optimum)
begin = jit_here(phases.OPTIMUM_STAGES.begin)
newton = jit_here(phases.OPTIMUM_STAGES.newton)
finish = jit_here(phases.OPTIMUM_STAGES.finish)


def drawn(kind: str, size: int, seed: int = 0) -> tuple[Grasp, np.ndarray]:
    problem = P.problems(kind, N, size, seed=seed)
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze), problem.wrench


def assert_same_bits(one, other, rows=slice(None)) -> None:
    for name in one._fields:
        expected, actual = getattr(one, name), getattr(other, name)
        if expected is not None:
            np.testing.assert_array_equal(np.asarray(expected)[rows], np.asarray(actual)[rows], err_msg=name)


@pytest.mark.parametrize(
    "size", [10, pytest.param(1, marks=pytest.mark.slow), pytest.param(100, marks=pytest.mark.slow)]
)
def test_stages_answer_as_one_program_to_the_last_bit(size):
    routes, by_newton_alone = set(), 0
    for kind in P.KINDS:
        for seed in range(2 if size > 1 else 8):
            grasp, wrench = drawn(kind, size, seed)
            problem = flatten(grasp, wrench, grasp.squeeze, "given", numpy=np).problem
            expected = at_once(problem)
            _, start = begin(problem)
            state = newton(problem, start)
            is_final = ~np.asarray(state.undecided)
            assert_same_bits(expected, state, is_final)
            assert_same_bits(expected, finish(problem, start))
            assert_same_bits(expected, finish(problem, state))
            by_newton_alone += np.count_nonzero(is_final & np.asarray(start.undecided))
            routes |= set(np.asarray(expected.route).tolist())
    assert routes == {Route.CLOSED_FORM, Route.NEWTON, Route.ROBUST}
    assert by_newton_alone > 20


@pytest.fixture
def compiled() -> Iterator[list[str]]:
    """Yield a list of the names of the programs that are compiled, or loaded from the cache, during the test."""
    names: list[str] = []

    def listen(event: str, duration: float, **details) -> None:
        if event.endswith("backend_compile_duration"):
            names.append(str(details.get("fun_name")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    programs._program.cache_clear()
    yield names
    jax.monitoring.unregister_event_duration_listener(listen)


def test_a_batch_compiles_the_stages_that_its_problems_need(compiled):
    def stages() -> set[str]:
        known = ("_begin_optimum", "run_newton_phases", "run_phases")
        return {stage for name in compiled for stage in known if stage in name}

    grasp, wrench = drawn("ordinary", 10)
    is_inside = np.asarray(jaxgrasp.closed_form(grasp, wrench).verdict) == Verdict.CLOSED_FORM_OPTIMAL
    assert 0 < np.count_nonzero(is_inside) < 10
    first = int(np.argmax(is_inside))
    inside = jaxgrasp.constrained_optimum(*repeated(grasp, wrench, first))
    assert np.all(np.asarray(inside.verdict) == Verdict.CLOSED_FORM_OPTIMAL)
    assert stages() == {"_begin_optimum"}
    ordinary = jaxgrasp.constrained_optimum(grasp, wrench)
    assert np.any(np.asarray(ordinary.route) == Route.NEWTON)
    assert stages() == {"_begin_optimum", "run_newton_phases"}
    hard = jaxgrasp.constrained_optimum(*drawn("near_collinear", 10))
    assert np.any(np.asarray(hard.route) == Route.ROBUST)
    assert stages() == {"_begin_optimum", "run_newton_phases", "run_phases"}
    again = jaxgrasp.constrained_optimum(grasp, wrench)
    jax.tree.map(np.testing.assert_array_equal, ordinary, again)


def repeated(grasp: Grasp, wrench: np.ndarray, index: int) -> tuple[Grasp, np.ndarray]:
    rows = np.full(len(wrench), index)
    arrays = (grasp.points, grasp.normals, grasp.friction, grasp.squeeze)
    return Grasp(*(np.asarray(array)[rows] for array in arrays)), wrench[rows]


@pytest.mark.slow
def test_an_eager_derivative_compiles_no_stage_again(compiled):
    grasp, wrench = drawn("ordinary", 10)
    jaxgrasp.constrained_optimum(grasp, wrench)

    def total(squeeze):
        return jnp.sum(
            jaxgrasp.constrained_optimum(Grasp(grasp.points, grasp.normals, grasp.friction, squeeze), wrench).forces
            ** 2
        )

    compiled.clear()
    slopes = jax.grad(total)(jnp.asarray(grasp.squeeze))
    assert not any(stage in name for name in compiled for stage in ("begin", "phases", "_traced"))
    expected = jax.jit(jax.grad(total))(jnp.asarray(grasp.squeeze))
    np.testing.assert_allclose(slopes, expected, rtol=1e-10, atol=1e-12)
    _, along = jax.jvp(total, (jnp.asarray(grasp.squeeze),), (jnp.ones_like(grasp.squeeze),))
    np.testing.assert_allclose(along, jnp.sum(expected), rtol=1e-10)
