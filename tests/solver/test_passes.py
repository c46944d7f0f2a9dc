"""Passes that are interrupted, so that the unfinished can be gathered, answer as if they were not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Route, Verdict
from jaxgrasp.model.solution import is_optimum
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import passes
from jaxgrasp.solver.proximal import UNLIMITED_CHECKS

N, COUNT = 5, 600


def lifts() -> ProblemBatch:
    """Contacts at random on the upper half of a ball, which is lifted: most cannot, and many hardly can."""
    rng = np.random.default_rng(5)
    points = rng.normal(size=(COUNT, N, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    points[..., 2] = np.abs(points[..., 2])
    friction, squeeze = rng.uniform(0.2, 0.6, (COUNT, N)), rng.uniform(0.5, 5, (COUNT, N))
    wrench = np.tile([0, 0, 3.0, 0, 0, 0], (COUNT, 1))
    arrays = (jnp.asarray(array) for array in (points, -points, friction, squeeze, squeeze, wrench))
    points, normals, friction, squeeze, weights, wrench = arrays
    return ProblemBatch(points, normals, friction, squeeze, None, weights, wrench)


@pytest.mark.slow
@pytest.mark.parametrize("checks", [(1, 1, UNLIMITED_CHECKS), (8, 13, UNLIMITED_CHECKS)])
def test_an_interrupted_search_goes_on_where_it_stopped(monkeypatch, checks):
    given = lifts()
    whole = solved_by(monkeypatch, given, (UNLIMITED_CHECKS,) * 3)
    parts = solved_by(monkeypatch, given, checks)
    careful = whole.steps[whole.route == Route.CAREFUL]
    assert len(careful) > 50 and np.median(careful) > 3 * checks[0]
    assert np.sum(whole.verdict == Verdict.INFEASIBLE) > COUNT / 4
    np.testing.assert_array_equal(whole.verdict, parts.verdict)
    solved = np.asarray(is_optimum(whole.verdict))
    assert solved.sum() > COUNT / 8
    expected = whole.forces[solved]
    size = np.abs(expected).max((1, 2), keepdims=True)
    np.testing.assert_allclose(parts.forces[solved] / size, expected / size, atol=1e-8)


def solved_by(monkeypatch, given: ProblemBatch, checks: tuple[int, ...]):
    monkeypatch.setattr(passes, "CAREFUL_CHECKS", checks)
    return jax.device_get(jax.jit(lambda problem: passes.solve_optimum(problem))(given))
