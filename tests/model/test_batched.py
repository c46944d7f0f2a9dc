"""Batches are counted, indexed and printed: what is taken is what the arrays say, whatever the index."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.testing import problems as P


def batch(count: int = 6) -> tuple[Grasp, np.ndarray]:
    made = P.problems("ordinary", 4, count, seed=3)
    return Grasp(made.points, made.normals, made.friction, made.squeeze), made.wrench


@pytest.mark.parametrize(
    "index", [2, -1, slice(1, 4), slice(None, None, 2), np.array([4, 0, 0]), np.arange(6) % 2 == 0]
)
def test_an_index_takes_the_same_of_every_field(index):
    grasps, wrench = batch()
    taken = grasps[index]
    for name in ("points", "normals", "friction", "squeeze"):
        np.testing.assert_array_equal(getattr(taken, name), getattr(grasps, name)[index])
    assert taken.present is None
    solutions = jaxgrasp.closed_form(grasps, wrench)
    some = jaxgrasp.closed_form(taken, wrench[index])
    np.testing.assert_allclose(some.forces, solutions[index].forces, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(some.verdict, solutions[index].verdict)


def test_a_batch_has_a_length_and_ends():
    grasps, wrench = batch()
    assert len(grasps) == len(jaxgrasp.closed_form(grasps, wrench)) == len([*grasps]) == 6
    jaxed = jax.tree.map(jnp.asarray, grasps)
    assert [*jaxed][5].points.shape == (4, 3)
    for wrong in (6, -7):
        with pytest.raises(IndexError, match=f"index is {wrong}: expected an index into a batch"):
            _ = jaxed[wrong]


@pytest.mark.parametrize("as_array", [np.asarray, jnp.asarray])
@pytest.mark.parametrize(
    "index",
    [
        99,
        (slice(None), 0),
        (Ellipsis, 0, 0),
        None,
        np.array([0, 6]),
        jnp.array(99),
        jnp.array([-7]),
        [0, 99],
        np.zeros(5, bool),
        np.zeros((6, 4), bool),
        1.5,
        "a",
    ],
)
def test_an_index_beyond_the_batch_is_refused(index, as_array):
    grasps = jax.tree.map(as_array, batch()[0])
    with pytest.raises(IndexError, match="^index"):
        _ = grasps[index]


@pytest.mark.parametrize("as_array", [np.asarray, jnp.asarray])
def test_lists_and_ellipses_count_along_the_batch(as_array):
    grasps = jax.tree.map(as_array, batch()[0])
    np.testing.assert_array_equal(grasps[[1, 2]].points, grasps.points[np.array([1, 2])])
    np.testing.assert_array_equal(grasps[[True, False] * 3].points, grasps.points[::2])
    assert grasps[[]].points.shape == (0, 4, 3) and len(grasps[0:0]) == 0
    grid = jax.tree.map(lambda x: x.reshape(2, 3, *x.shape[1:]), grasps)
    np.testing.assert_array_equal(grid[..., 0].points, grasps.points[np.array([0, 3])])
    np.testing.assert_array_equal(grid[..., 1, :].friction, grid.friction[1])


def test_a_traced_index_takes_one():
    grasps = jax.tree.map(jnp.asarray, batch()[0])
    points = jax.jit(lambda i: grasps[i].points)(4)
    np.testing.assert_array_equal(points, grasps.points[4])


def test_a_single_one_has_no_length():
    single = batch()[0][0]
    assert single and single.batch_shape == ()
    with pytest.raises(TypeError, match="no leading axes"):
        len(single)
    with pytest.raises(TypeError, match="no leading axes"):
        _ = single[0]


@pytest.mark.usefixtures("unchecked")
def test_fields_that_are_shared_are_taken_for_each():
    grasps, _ = batch()
    shared = Grasp(grasps.points, grasps.normals, grasps.friction[0], grasps.squeeze[0])
    assert len(shared) == 6
    np.testing.assert_array_equal(shared[4].friction, grasps.friction[0])
    assert shared[:3].squeeze.shape == (3, 4)


def test_several_leading_axes():
    grasps, _ = batch()
    grid = jax.tree.map(lambda x: x.reshape(2, 3, *x.shape[1:]), grasps)
    assert grid.batch_shape == (2, 3) and len(grid[1]) == 3
    np.testing.assert_array_equal(grid[1, 2].points, grasps.points[5])
    np.testing.assert_array_equal(grid[:, 0].points, grasps.points[[0, 3]])


def test_contact_sets_are_taken_by_number_and_by_mask():
    grasps, wrench = batch()
    sets = jaxgrasp.ContactSets.from_grasp(grasps, wrench)
    np.testing.assert_array_equal(sets[-1].points, grasps.points[5])
    assert len(sets[np.arange(6) > 1]) == 4 and len(sets[1:3]) == 2
    with pytest.raises(IndexError, match="index is 6"):
        _ = sets[6]


@pytest.mark.slow
def test_a_solution_prints_what_was_found():
    grasps, wrench = batch()
    answers = jaxgrasp.constrained_optimum(grasps, wrench)
    text = str(answers)
    assert "6 problems of 4 contacts" in text
    for code in np.unique(answers.verdict):
        assert f"{int(np.sum(answers.verdict == code))} {Verdict(int(code)).name}" in text
    largest = np.linalg.norm(np.asarray(answers.forces), axis=-1).max()
    assert f"largest force {largest:.4g} N" in text
    single = answers[0]
    assert Verdict(int(single.verdict)).name in str(single) and Verdict(int(single.verdict)).advice in str(single)
    bare = jaxgrasp.constrained_optimum(grasps[0], np.full(6, np.nan))
    assert "INVALID_DATA" in str(bare) and "no forces" in str(bare)


def test_a_solution_that_is_traced_prints_its_shapes():
    grasps, wrench = batch()
    texts = []
    jax.eval_shape(lambda g, w: texts.append(str(jaxgrasp.closed_form(g, w))), grasps, wrench)
    assert "forces=" in texts[0] and "[6,4,3]" in texts[0]


def test_a_solution_without_numbers_prints_its_fields():
    grasps, wrench = batch()
    answers = jaxgrasp.closed_form(grasps, wrench)
    for solution in (
        jax.eval_shape(jaxgrasp.closed_form, grasps, wrench),
        jax.tree.map(lambda _: None, answers),
        jax.tree.map(lambda _: 0, answers),
    ):
        assert str(solution).startswith("Solution(")


def test_qualities_print_a_line():
    grasps, _ = batch()
    closure = jaxgrasp.quality.force_closure(grasps)
    closed = int(np.sum(closure.closed))
    assert str(closure).startswith("ForceClosure: ") and (f"{closed} closed" in str(closure)) == (closed > 0)
    ball = jaxgrasp.quality.ferrari_canny(grasps)
    assert f"{np.max(ball.upper):.4g}" in str(ball)
    assert f"{np.min(ball.lower):.4g} to" in str(ball)
    assert f"{np.max(jaxgrasp.quality.min_weight(grasps).value):.4g}" in str(jaxgrasp.quality.min_weight(grasps))
