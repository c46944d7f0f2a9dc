"""An optimum that starts from a multiplier that the user gives: the same answer, sooner where the start is close."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

from jaxgrasp import Grasp, Verdict, constrained_optimum
from jaxgrasp.sensitivity import cylinder_task
from jaxgrasp.testing import problems as P

COUNT = 64


def grasp_of(problem: P.Problems) -> Grasp:
    return Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)


def starts_about(multiplier: np.ndarray) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    noise = rng.normal(size=multiplier.shape)
    size = np.linalg.norm(multiplier, axis=-1, keepdims=True)
    return {
        "its own": multiplier,
        "close": multiplier + 0.01 * size * noise,
        "another's": np.roll(multiplier, 1, 0),
        "far": 1e3 * size * noise,
        "nothing": np.zeros_like(multiplier),
        "no number": np.where(rng.random(multiplier.shape) < 0.3, np.nan, multiplier),
    }


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ordinary", "near_collinear", "infeasible"])
def test_the_answer_does_not_depend_on_the_start(kind):
    problem = P.problems(kind, 5, COUNT, seed=3)
    grasp = grasp_of(problem)
    plain = jax.device_get(constrained_optimum(grasp, problem.wrench))
    size = np.abs(plain.forces).max((1, 2), keepdims=True)
    for name, start in starts_about(plain.multiplier).items():
        solution = jax.device_get(constrained_optimum(grasp, problem.wrench, start=start))
        np.testing.assert_array_equal(solution.verdict, plain.verdict, name)
        solved = solution.verdict <= Verdict.OPTIMAL
        np.testing.assert_allclose(solution.objective[solved], plain.objective[solved], rtol=1e-8, err_msg=name)
        assert np.all(np.abs(solution.forces - plain.forces)[solved] <= 1e-5 * size[solved]), name


@pytest.mark.slow
def test_fewer_steps_lead_from_the_instant_before():
    times = jnp.arange(0.5, 1.0, 1e-3)
    grasp, wrench = jax.vmap(cylinder_task())(times)

    def follow(start, problem):
        solution = constrained_optimum(*problem, start=start)
        return solution.multiplier, solution

    _, followed = jax.jit(lambda problems: jax.lax.scan(follow, jnp.zeros(6), problems))((grasp, wrench))
    plain = constrained_optimum(grasp, wrench)
    np.testing.assert_array_equal(followed.verdict, plain.verdict)
    np.testing.assert_allclose(followed.forces, plain.forces, atol=1e-7 * np.abs(plain.forces).max())
    active = np.asarray(plain.verdict == Verdict.OPTIMAL)
    assert active.mean() > 0.5
    assert followed.steps[active].sum() < 0.7 * plain.steps[active].sum()
    assert (followed.steps[~active] == 0).all()


@pytest.mark.slow
def test_derivatives_and_mapped_axes():
    problem = P.problems("ordinary", 5, 8, seed=4)
    grasp = grasp_of(problem)
    start = np.asarray(constrained_optimum(grasp, problem.wrench).multiplier) * 1.1

    def forces(wrench, start):
        return jax.vmap(lambda g, w, s: constrained_optimum(g, w, start=s).forces)(grasp, wrench, start)

    together = constrained_optimum(grasp, problem.wrench, start=start).forces
    np.testing.assert_allclose(forces(problem.wrench, start), together, rtol=1e-12, atol=1e-12)
    solve_single = jax.vmap(lambda w, s: constrained_optimum(jax.tree.map(lambda x: x[0], grasp), w, start=s).forces)
    np.testing.assert_allclose(solve_single(problem.wrench[:1], start[:1])[0], together[0], rtol=1e-9, atol=1e-9)
    _, by_wrench = jax.jvp(lambda w: forces(w, start), (problem.wrench,), (np.ones_like(problem.wrench),))
    expected = jax.jvp(lambda w: constrained_optimum(grasp, w).forces, (problem.wrench,), (np.ones((8, 6)),))[1]
    np.testing.assert_allclose(by_wrench, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    _, by_start = jax.jvp(lambda s: forces(problem.wrench, s), (start,), (np.ones_like(start),))
    assert (by_start == 0).all()


def test_bad_starts(unchecked):
    problem = P.problems("ordinary", 5, 2, seed=5)
    grasp = grasp_of(problem)
    with pytest.raises(ValueError, match=r"start has shape \(5,\): expected \(..., 6\)"):
        constrained_optimum(grasp, problem.wrench, start=np.zeros(5))
    with pytest.raises(ValueError, match="start and free are both given"):
        constrained_optimum(grasp, problem.wrench, free=np.eye(6), start=np.zeros(6))
    with pytest.raises(ValueError, match="start and solver are both given"):
        constrained_optimum(grasp, problem.wrench, solver=optimistix.Newton(rtol=1e-8, atol=1e-8), start=np.zeros(6))
