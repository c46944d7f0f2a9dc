"""Phases: an interrupted search answers as if it were not, and the verdict follows from what was found."""

import itertools
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp import Route, Verdict
from jaxgrasp.model.solution import is_optimum
from jaxgrasp.problem.batch_last import ProblemBatch
from jaxgrasp.solver import phases
from jaxgrasp.solver.proximal import UNLIMITED_CHECKS
from jaxgrasp.solver.result import Findings, decide_verdict

N, COUNT = 5, 600


def lifts() -> ProblemBatch:
    """Return random contacts on the upper half of a ball, which is lifted: most cannot, and many hardly can."""
    rng = np.random.default_rng(5)
    points = rng.normal(size=(COUNT, N, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    points[..., 2] = np.abs(points[..., 2])
    friction, squeeze = rng.uniform(0.2, 0.6, (COUNT, N)), rng.uniform(0.5, 5, (COUNT, N))
    wrench = np.tile([0, 0, 3.0, 0, 0, 0], (COUNT, 1))
    arrays = (jnp.asarray(array) for array in (points, -points, friction, squeeze, squeeze, wrench))
    points, normals, friction, squeeze, weights, wrench = arrays
    return ProblemBatch(points, normals, friction, squeeze, None, weights, wrench)


def test_the_verdict_follows_from_what_was_found_in_every_case():
    masks = np.array(list(itertools.product([False, True], repeat=8)))
    infeasible, optimal, closed, feasible_only, resumable, balanced, contacts, valid = jnp.asarray(masks.T)
    findings = Findings(infeasible, optimal, closed, feasible_only, resumable)
    decided = np.asarray(decide_verdict(findings, balanced, contacts, valid))
    for row, verdict in zip(masks, decided, strict=True):
        infeasible, optimal, closed, feasible_only, resumable, balanced, contacts, valid = row
        if not valid:
            expected = Verdict.INVALID_DATA
        elif not contacts:
            expected = Verdict.NO_CONTACTS
        elif infeasible:
            expected = Verdict.INFEASIBLE
        elif (optimal or closed) and not balanced:
            expected = Verdict.NOT_CONVERGED
        elif closed:
            expected = Verdict.CLOSED_FORM_OPTIMAL if optimal else Verdict.OUTSIDE_CONES
        elif optimal:
            expected = Verdict.FEASIBLE if feasible_only else Verdict.OPTIMAL
        else:
            expected = Verdict.OUTSIDE_CONES if resumable else Verdict.NOT_CONVERGED
        assert verdict == expected, row
    assert set(decided.tolist()) == set(Verdict)


@pytest.mark.slow
@pytest.mark.parametrize("checks", [(1, 1, UNLIMITED_CHECKS), (8, 13, UNLIMITED_CHECKS)])
def test_an_interrupted_search_goes_on_where_it_stopped(monkeypatch, checks):
    batch = lifts()
    uninterrupted = solved_by(monkeypatch, batch, iter((UNLIMITED_CHECKS,) * 3))
    parts = solved_by(monkeypatch, batch, iter(checks))
    robust = uninterrupted.steps[uninterrupted.route == Route.ROBUST]
    assert len(robust) > 50 and np.median(robust) > 3 * checks[0]
    assert np.sum(uninterrupted.verdict == Verdict.INFEASIBLE) > COUNT / 4
    np.testing.assert_array_equal(uninterrupted.verdict, parts.verdict)
    solved = np.asarray(is_optimum(uninterrupted.verdict))
    assert solved.sum() > COUNT / 8
    expected = uninterrupted.forces[solved]
    size = np.abs(expected).max((1, 2), keepdims=True)
    np.testing.assert_allclose(parts.forces[solved] / size, expected / size, atol=1e-8)


def solved_by(monkeypatch, batch: ProblemBatch, checks: Iterator[int]):
    robust = [
        phase._replace(checks=next(checks)) if phase.name.startswith("robust") else phase for phase in phases.PHASES
    ]
    monkeypatch.setattr(phases, "PHASES", tuple(robust))
    return jax.device_get(jax.jit(lambda problem: phases.solve_optimum(problem))(batch))
