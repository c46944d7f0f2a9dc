"""Grasps of a file in the order of how good they are, and what is seen of each."""

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.reasons import Reason
from jaxgrasp.model.solution import is_held
from jaxgrasp.view.grasp_page import GraspSteps, orders
from tests.batch.conftest import make_sets


def test_orders_hold_first_and_by_margin_and_are_permutations():
    rng = np.random.default_rng(3)
    for _ in range(20):
        holds, margins = rng.random(30) < 0.5, np.round(rng.normal(size=30), 1)
        margins[rng.random(30) < 0.2] = np.nan
        order_by_name = orders(holds, margins)
        for order in order_by_name.values():
            np.testing.assert_array_equal(np.sort(order), np.arange(30))
        known_margins = np.where(np.isnan(margins), -np.inf, margins)
        best, worst = order_by_name["best first"], order_by_name["worst first"]
        assert (np.diff(holds[best].astype(int)) <= 0).all() and (np.diff(holds[worst].astype(int)) >= 0).all()
        for group in (True, False):
            falling, rising = (known_margins[order][holds[order] == group] for order in (best, worst))
            assert (falling[1:] <= falling[:-1]).all() and (rising[1:] >= rising[:-1]).all()


@pytest.fixture(scope="module")
def sets():
    made = make_sets([3, 5, 3, 4])
    # The last would have to be held from one side alone.
    made.wrench[3] = [0, 0, 0, 0, 0, 50.0]
    return made


@pytest.mark.slow
def test_each_grasp_is_seen_with_the_answers_of_the_public_calls(sets):
    steps = GraspSteps(sets, "optimum")
    assert len(steps) == len(sets) * sets.wrenches
    for problem in range(len(steps)):
        number, load = divmod(problem, sets.wrenches)
        grasp, wrench = sets.grasp(number), sets.wrench[number, load]
        solved, count = steps.solve(problem), len(grasp.points)
        assert solved.touching.sum() == count
        np.testing.assert_allclose(solved.points[:count].mean(0), 0, atol=1e-12)
        for solve, (name, answer, margins) in zip(
            (jaxgrasp.closed_form, jaxgrasp.constrained_optimum), solved.answers(), strict=True
        ):
            alone = solve(grasp, wrench)
            assert int(alone.verdict) == int(answer.verdict), name
            if is_held(int(alone.verdict)):
                np.testing.assert_allclose(solved.forces(answer)[:count], alone.forces, rtol=1e-6, atol=1e-7)
                np.testing.assert_allclose(margins[:count], jaxgrasp.friction_margin(grasp, alone.forces), atol=1e-6)
            assert not solved.forces(answer)[count:].any()
        held = bool(is_held(int(solved.assessment.optimum.verdict)))
        assert (steps.reason(problem) == Reason.HOLDS) == held
        if solved.escape is not None:
            # Along it the load does work, and no contact is pushed into.
            assert solved.wrench @ -solved.escape > 0
    first, last = (steps.problem("best first", place) for place in (0, len(steps) - 1))
    assert steps.problem("worst first", 0) == last or steps.reason(first) == Reason.HOLDS
