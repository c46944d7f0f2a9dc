"""Stable, slipping or lost: the paper's conditions (2) and (3), contact by contact."""

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.grip import Hold, Touch, monitor
from jaxgrasp.testing import problems as P

COUNT = 64


@pytest.fixture(scope="module")
def case():
    problem = P.problems("ordinary", 3, COUNT, seed=1)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    return grasp, problem.wrench, jax.device_get(monitor(grasp, problem.wrench))


def broken(grasp: Grasp, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the contacts that violate conditions (3) and (2), by their definitions."""
    along = np.einsum("bni,bni->bn", forces, grasp.normals)
    across = np.linalg.norm(np.cross(grasp.normals, forces), axis=-1)
    return along < 0, across > grasp.friction * along


def test_it_says_what_both_laws_find(case):
    grasp, wrench, assessment = case
    closed, optimum = jaxgrasp.closed_form(grasp, wrench), jaxgrasp.constrained_optimum(grasp, wrench)
    np.testing.assert_allclose(assessment.closed.forces, closed.forces, rtol=1e-12)
    np.testing.assert_array_equal(assessment.optimum.verdict, optimum.verdict)
    assert {Hold.STABLE, Hold.SLIPPING} == set(assessment.hold.tolist())
    np.testing.assert_array_equal(assessment.hold == Hold.STABLE, closed.verdict == Verdict.CLOSED_FORM_OPTIMAL)
    np.testing.assert_array_equal(
        assessment.disagrees, (assessment.hold == Hold.SLIPPING) & (optimum.verdict == Verdict.OPTIMAL)
    )
    assert assessment.disagrees.any()


def test_each_contact_names_the_condition_that_it_breaks(case):
    grasp, _, assessment = case
    pulls, slides = broken(grasp, assessment.forces)
    slipping = assessment.hold == Hold.SLIPPING
    np.testing.assert_array_equal((assessment.touches == Touch.PULLS)[slipping], pulls[slipping])
    np.testing.assert_array_equal((assessment.touches == Touch.SLIDES)[slipping], (slides & ~pulls)[slipping])
    assert (assessment.touches[slipping] != Touch.HOLDS).any(-1).all()
    assert (assessment.touches[~slipping] == Touch.HOLDS).all()


@pytest.mark.slow
def test_the_optimum_as_law_holds_whatever_can_be_held(case):
    grasp, wrench, by_closed = case
    assessment = monitor(grasp, wrench, law="optimum")
    held = (by_closed.optimum.verdict == Verdict.OPTIMAL) | (by_closed.hold == Hold.STABLE)
    np.testing.assert_array_equal(assessment.hold == Hold.STABLE, held)
    np.testing.assert_allclose(assessment.forces, by_closed.optimum.forces, rtol=1e-12)


@pytest.mark.slow
def test_without_contacts_the_object_is_lost(case):
    grasp, wrench, assessment = case
    present = np.ones((COUNT, 3))
    present[::2] = 0
    present[1::4, 1] = 0
    lost = monitor(Grasp(grasp.points, grasp.normals, grasp.friction, grasp.squeeze, present), wrench)
    assert (lost.hold[::2] == Hold.LOST).all() and (lost.hold[1::2] != Hold.LOST).all()
    np.testing.assert_array_equal(lost.touches == Touch.ABSENT, present == 0)
    assert not lost.disagrees[::2].any() and (lost.forces[::2] == 0).all()


def test_another_law_is_refused(case, unchecked):
    with pytest.raises(ValueError, match="law is 'hope': expected 'closed-form' or 'optimum'"):
        monitor(case[0], case[1], law="hope")


@pytest.mark.slow
@pytest.mark.parametrize("sharing", ["uniform", "squeeze"])
def test_sharing_is_named_or_given(sharing):
    made = P.problems("ordinary", 4, 6, seed=2)
    grasp = Grasp(made.points, made.normals, made.friction, made.squeeze)
    named = monitor(grasp, made.wrench, sharing)
    by_weights = monitor(grasp, made.wrench, made.weights(sharing))
    np.testing.assert_array_equal(named.touches, by_weights.touches)
    letter = {"squeeze": "B", "uniform": "A"}[sharing]
    np.testing.assert_array_equal(monitor(grasp, made.wrench, letter).touches, named.touches)
    with pytest.raises(ValueError, match="sharing is 'C'"):
        monitor(grasp, made.wrench, "C")
