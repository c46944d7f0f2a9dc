"""The least margin over a task's wrenches: each by itself, the weakest of them, laws and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Grasp, Limits, wrench_margin
from jaxgrasp.quality import task_margin
from jaxgrasp.testing.limited_problems import limited_problems

COUNT, N, K = 4, 3, 5


@pytest.fixture(scope="module")
def made():
    return limited_problems("ordinary", N, COUNT, 4, soft=True, bounded=True, joints=4)


@pytest.fixture(scope="module")
def tasks(made):
    force, torque = np.random.default_rng(0).normal(size=(2, COUNT, K, 3))
    middle = made.problem.points.mean(1)[:, None]
    return np.concatenate([force, 0.03 * torque + np.cross(middle, force)], -1)


@pytest.mark.slow
def test_each_margin_is_its_own_and_the_least_is_named(made, tasks):
    wrench = made.problem.wrench
    margin = task_margin(made.grasp, tasks, wrench, "uniform", limits=made.limits)
    for k in range(K):
        single_margin = wrench_margin(made.grasp, wrench, tasks[:, k], "uniform", limits=made.limits)
        np.testing.assert_allclose(margin.margins[:, k], single_margin, rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(margin.margin, margin.margins.min(1))
    np.testing.assert_array_equal(margin.weakest, margin.margins.argmin(1))


@pytest.mark.slow
def test_laws(made, tasks):
    """Order does not matter, more wrenches never help, mixtures are resisted too, and limits never help."""
    wrench = made.problem.wrench
    margin = task_margin(made.grasp, tasks, wrench, "uniform", limits=made.limits)
    order = np.random.default_rng(1).permutation(K)
    mixed = task_margin(made.grasp, tasks[:, order], wrench, "uniform", limits=made.limits)
    np.testing.assert_allclose(mixed.margin, margin.margin, rtol=1e-8)
    np.testing.assert_array_equal(order[mixed.weakest], margin.weakest)
    rng = np.random.default_rng(2)
    shares = rng.dirichlet(np.ones(K), COUNT)
    mixture = np.einsum("bk,bkj->bj", shares, tasks)[:, None].repeat(K, 1)
    inside = task_margin(made.grasp, mixture, wrench, "uniform", limits=made.limits)
    assert (inside.margin >= margin.margin - 1e-7).all()
    free = task_margin(made.grasp, tasks, wrench, "uniform")
    assert (free.margins >= margin.margins - 1e-7).all()


@pytest.mark.slow
def test_the_derivative_is_that_of_the_weakest(made, tasks):
    wrench = made.problem.wrench
    arrays = tuple(map(jnp.asarray, (made.problem.points, tasks)))

    def least(points, tasks):
        grasp = Grasp(points, *map(jnp.asarray, jax.tree.leaves(made.grasp)[1:4]), torsion=made.grasp.torsion)
        return jnp.sum(task_margin(grasp, tasks, wrench, "uniform", limits=made.limits).margin)

    slopes = jax.jit(jax.grad(least, argnums=(0, 1)))(*arrays)
    weakest = np.asarray(task_margin(made.grasp, tasks, wrench, "uniform", limits=made.limits).weakest)
    others = np.arange(K) != weakest[:, None]
    assert (np.asarray(slopes[1])[others] == 0).all() and (np.asarray(slopes[1])[~others] != 0).any()
    rng = np.random.default_rng(3)
    tangent = tuple(scale * rng.normal(size=a.shape) for a, scale in zip(arrays, (0.01, 0.3)))
    step = 1e-5
    ends = [least(*(a + sign * b for a, b in zip(arrays, tangent))) for sign in (step, -step)]
    forward = sum(np.sum(np.asarray(a) * b) for a, b in zip(slopes, tangent))
    assert forward == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-4)


def test_one_grasp_takes_the_tasks_of_many():
    """A pinch of at most 5 N lifts 5 N, and each grasp of a batch is as it is alone."""
    points, normals = np.array([[-0.03, 0, 0], [0.03, 0, 0]]), np.array([[1.0, 0, 0], [-1, 0, 0]])
    pinch = Grasp(points, normals, np.full(2, 0.5), np.ones(2))
    limits = Limits(normal_max=np.full(2, 5.0))
    tasks = np.zeros((2, 3, 6))
    tasks[..., 2], tasks[0, 1, 1], tasks[1, 2, 0] = 1, 1, -2
    margin = task_margin(pinch, tasks, limits=limits)
    np.testing.assert_allclose(margin.margins[0], [5, 5 / np.sqrt(2), 5], rtol=1e-7)
    # Both carry half of the lift theta, so that one presses with theta at least, and the other with 2 theta more.
    np.testing.assert_allclose(margin.margins[1], [5, 5, 5 / 3], rtol=1e-7)
    assert margin.weakest.tolist() == [1, 2]
    alone = task_margin(pinch, tasks[1], limits=limits)
    np.testing.assert_allclose(alone.margins, margin.margins[1], rtol=1e-8)


@pytest.mark.usefixtures("unchecked")
def test_bad_arguments_are_named(made):
    with pytest.raises(ValueError, match=r"tasks has shape \(0, 6\): expected \(..., k, 6\) with at least one"):
        task_margin(made.grasp, np.zeros((0, 6)))
    with pytest.raises(ValueError, match=r"tasks has shape \(6,\): expected \(..., k, 6\)"):
        task_margin(made.grasp, np.zeros(6))
