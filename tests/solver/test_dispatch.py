"""A question asked of any number of problems: few programs, and the same answers as one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.solver.dispatch import dispatch
from jaxgrasp.solver.programs import LEAST_WHOLE, SIZES, chunks
from jaxgrasp.testing import problems as P
from tests.turns import later

N = 3
MANY = P.problems("ordinary", N, 1000, seed=5)
THIRTY = (*range(1, 12), 20, 33, 50, 64, 99, 100, 101, 128, 150, 200, 256, 333, 400, 512, 600, 700, 800, 999, 1000)


def lifts(count: int, first: int = 0) -> tuple[Grasp, np.ndarray]:
    some = slice(first, first + count)
    return Grasp(MANY.points[some], MANY.normals[some], MANY.friction[some], MANY.squeeze[some]), MANY.wrench[some]


@pytest.fixture
def compilations():
    """Yield a list of the programs that are compiled, or loaded from the cache, during the test."""
    names: list[str] = []

    def listen(name: str, duration: float, **details) -> None:
        if name.endswith("backend_compile_duration"):
            names.append(str(details.get("fun_name")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield names
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.mark.slow
def test_thirty_sizes_need_few_programs(compilations):
    assert len(THIRTY) == 30
    for count in THIRTY:
        jaxgrasp.closed_form(*lifts(count))
    within = [size for size in SIZES if size <= max(THIRTY)]
    # One for each size that is padded to, and one more for those that need no padding. What puts answers together is a
    # copy, and is compiled only for sizes that the process has met before.
    assert len([name for name in compilations if "assemble" not in name]) <= 2 * len(within)


@pytest.mark.parametrize("count", [7, 10])
def test_every_sharing_is_one_program(compilations, count):
    grasp, wrench = lifts(count)
    named = [jaxgrasp.closed_form(grasp, wrench, sharing).forces for sharing in ("squeeze", "uniform")]
    first = len([name for name in compilations if "assemble" not in name])
    forces_of_both = [
        jaxgrasp.closed_form(grasp, wrench, np.array(k)).forces for k in (grasp.squeeze, np.ones((count, N)))
    ]
    assert len([name for name in compilations if "assemble" not in name]) == first <= 1
    np.testing.assert_array_equal(forces_of_both, named)


def test_a_size_that_comes_again_needs_one_program_more(compilations):
    for _ in range(3):
        jaxgrasp.closed_form(*lifts(701))
    first = len(compilations)
    for count in (702, 703):
        jaxgrasp.closed_form(*lifts(count))
    assert len(compilations) == first
    jaxgrasp.closed_form(*lifts(703))
    assert len(compilations) <= first + 1


@pytest.mark.parametrize("size", [2, 11, 101, 999, 1001, 1500, 4000, 12345, 35000, 1_000_001])
def test_pieces_cover_a_batch_once_and_only_the_last_is_padded(size):
    cut = chunks(size)
    ends = [first + room for first, room in cut]
    assert [first for first, _ in cut] == [0, *ends[:-1]]
    assert {room for _, room in cut} <= set(SIZES)
    assert all(end <= size and room >= LEAST_WHOLE for end, (_, room) in zip(ends[:-1], cut, strict=False))
    assert cut[-1][0] < size <= ends[-1]


def repeated(count: int) -> tuple[Grasp, np.ndarray]:
    """Repeat the problems again and again, up to ``count``."""
    order = np.arange(count) % 1000
    grasp, wrench = lifts(1000)
    return jax.tree.map(lambda x: x[order], grasp), wrench[order]


def one_of_each(problem, **fields):
    return problem.wrench[:, 0]


@pytest.mark.parametrize("size, expected_progress", [(1000, [1000]), (2500, [1000, 1000, 500])])
def test_progress_is_told_piece_by_piece_and_can_end_the_call(size, expected_progress):
    grasp, wrench = repeated(size)
    heard: list[int] = []
    solution = dispatch(one_of_each, grasp, wrench, "squeeze", progress=heard.append)
    assert heard == expected_progress
    np.testing.assert_array_equal(solution, wrench[:, 0])

    def interrupt(count: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dispatch(one_of_each, grasp, wrench, "squeeze", progress=interrupt)


def test_progress_is_refused_inside_another_program():
    grasp, wrench = lifts(3)
    with pytest.raises(ValueError, match="progress is given inside jit, vmap or grad"):
        jax.jit(lambda w: dispatch(one_of_each, grasp, w, "squeeze", progress=print))(wrench)


@pytest.mark.parametrize("size", [1234, pytest.param(4001, marks=pytest.mark.slow)])
def test_pieces_change_nothing(size):
    grasp, wrench = repeated(size)
    expected = jax.device_get(jaxgrasp.closed_form(*lifts(1000)))
    # The second time they are put together by another program.
    for _ in range(2):
        solution = jaxgrasp.closed_form(grasp, wrench)
        assert all(isinstance(leaf, jax.Array) and len(leaf) == size for leaf in jax.tree.leaves(solution))
        for leaf, expected_leaf in zip(jax.tree.leaves(solution), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(leaf, expected_leaf[np.arange(size) % 1000], rtol=1e-12, atol=1e-12)
    # So they are where NumPy has to bring the arrays into one shape.
    weights = np.linspace(1, 2, N)
    at_once = jax.jit(lambda g, w: jaxgrasp.closed_form(g, w, weights))(grasp, wrench)
    solution = jaxgrasp.closed_form(grasp, wrench, weights)
    np.testing.assert_allclose(solution.forces, at_once.forces, rtol=1e-11, atol=1e-11)


def test_a_weak_type_decides_no_precision_in_pieces():
    grasp, wrench = lifts(7)
    single = jax.tree.map(lambda x: np.asarray(x, np.float32), grasp)
    weak = jnp.broadcast_to(1.0, (7, 6)) * 0.1
    assert weak.weak_type
    assert jaxgrasp.closed_form(single, weak).forces.dtype == np.float32


@pytest.mark.slow
def test_padding_changes_nothing():
    solution = jax.device_get(jaxgrasp.constrained_optimum(*lifts(100)))
    for count, first in ((7, 0), (9, 31), (60, 40)):
        part = jax.device_get(jaxgrasp.constrained_optimum(*lifts(count, first)))
        mine = jax.tree.map(lambda x, first=first, count=count: x[first : first + count], solution)
        np.testing.assert_array_equal(part.verdict, mine.verdict)
        assert (part.verdict <= Verdict.OPTIMAL).all()
        np.testing.assert_allclose(part.forces, mine.forces, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(part.objective, mine.objective, rtol=1e-10)


def test_leading_axes_come_back_whatever_the_size():
    grasp, wrench = lifts(6)
    folded = jax.tree.map(lambda x: x.reshape(2, 3, *x.shape[1:]), grasp)
    flat = jaxgrasp.closed_form(grasp, wrench)
    solution = jaxgrasp.closed_form(folded, wrench.reshape(2, 3, 6))
    assert isinstance(solution.forces, jax.Array) and solution.forces.shape == (2, 3, N, 3)
    np.testing.assert_array_equal(solution.forces.reshape(6, N, 3), flat.forces)


def test_a_grasp_that_many_wrenches_share_stays_one():
    grasp, wrench = jax.tree.map(lambda x: x[0], lifts(7)[0]), lifts(7)[1]
    together = jaxgrasp.closed_form(grasp, wrench)
    apart = [jaxgrasp.closed_form(grasp, one_wrench).forces for one_wrench in wrench]
    np.testing.assert_allclose(together.forces, apart, rtol=1e-12, atol=1e-12)


def test_constants_may_be_asked_inside_another_program():
    grasp, wrench = lifts(7)
    inside = jax.jit(lambda: jaxgrasp.closed_form(grasp, wrench).forces)()
    np.testing.assert_allclose(inside, jaxgrasp.closed_form(grasp, wrench).forces, rtol=1e-12, atol=1e-12)
    by_scale = jax.grad(lambda scale: scale * jnp.sum(jaxgrasp.closed_form(grasp, wrench).objective))(1.0)
    np.testing.assert_allclose(by_scale, jaxgrasp.closed_form(grasp, wrench).objective.sum(), rtol=1e-12)


@pytest.mark.parametrize("solve", [jaxgrasp.closed_form, *later(jaxgrasp.constrained_optimum)])
def test_no_problem_at_all_has_no_answers(solve):
    assert solve(*lifts(0)).forces.shape == (0, N, 3)


def test_precision_is_that_of_the_data():
    grasp, wrench = jax.tree.map(lambda x: x.astype(np.float32), lifts(7))
    assert jaxgrasp.closed_form(grasp, wrench).forces.dtype == np.float32


def test_a_program_that_takes_derivatives_traces_no_answer_besides():
    traced = []

    @jax.custom_jvp
    def solve(problem):
        traced.append("answer")
        return jnp.sum(problem.squeeze, 1)

    @solve.defjvp
    def tangent(primals, tangents):
        traced.append("derivative")
        return jnp.sum(primals[0].squeeze, 1), jnp.sum(tangents[0].squeeze, 1)

    grasp, wrench = lifts(5)

    def total(squeeze):
        squeezed = Grasp(grasp.points, grasp.normals, grasp.friction, squeeze)
        return jnp.sum(dispatch(solve, squeezed, wrench, "squeeze"))

    for gradient in (jax.grad, jax.jacfwd):
        np.testing.assert_array_equal(jax.jit(gradient(total))(grasp.squeeze), 1)
        assert set(traced) == {"derivative"}
    jax.jit(total)(grasp.squeeze)
    assert traced[-1] == "answer"
