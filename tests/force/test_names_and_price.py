"""Names of sharings and verdicts, and the price of friction."""

import inspect

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.interop import torch as tensors
from jaxgrasp.literature import kuhn_tucker
from jaxgrasp.problem.flatten import read_sharing

POINTS = np.array([[0.05, 0, 0], [-0.05, 0, 0], [0, 0.05, 0.01]])
NORMALS = -POINTS / np.linalg.norm(POINTS, axis=1)[:, None]
GRASP = Grasp(POINTS, NORMALS, np.array([0.6, 0.6, 0.0]), np.array([2.0, 3.0, 1.0]))
AS_SQUEEZED = np.concatenate([GRASP.squeeze @ NORMALS, np.zeros(3)])
"""Wrench of the squeezing forces alone: the closed form is the optimum."""
ABOUT_X = np.array([0, 0, 0, 0.1, 0, 0])
"""Torque that no contact exerts: two lie on its axis, and the third has no friction."""
WRENCHES = np.stack([AS_SQUEEZED, AS_SQUEEZED + [0, 0, 2.5, 0, 0, 0], AS_SQUEEZED + ABOUT_X, np.full(6, np.nan)])


@pytest.mark.parametrize("method, name", [pytest.param("A", "uniform", marks=pytest.mark.slow), ("B", "squeeze")])
def test_the_papers_methods_are_names_of_sharings(method, name):
    assert read_sharing(method) == read_sharing(name)
    for solve in (jaxgrasp.closed_form, jaxgrasp.constrained_optimum):
        named, lettered = solve(GRASP, WRENCHES, name), solve(GRASP, WRENCHES, method)
        np.testing.assert_array_equal(named.forces, lettered.forces)
    forces = [kuhn_tucker(GRASP, WRENCHES[0], sharing=sharing).forces for sharing in (name, method)]
    np.testing.assert_array_equal(*forces)


def test_every_public_function_reads_a_sharing_by_the_same_names():
    """Functions with a ``sharing`` argument, those for tensors too, refuse an unknown one and list the known ones."""
    others = {"wrench": WRENCHES[0], "grasp": GRASP, "multiplier": np.ones(6)}
    functions = [getattr(jaxgrasp, name) for name in jaxgrasp.__all__ if name.islower()] + [kuhn_tucker]
    checked = []
    for function in functions:
        if not callable(function) or "sharing" not in (parameters := inspect.signature(function).parameters):
            continue
        required = [name for name, parameter in parameters.items() if parameter.default is parameter.empty]
        if set(required) - set(others):
            continue
        with pytest.raises(ValueError, match="'squeeze' or 'B', 'uniform' or 'A'"):
            function(**{name: others[name] for name in required}, sharing="C")
        checked.append(function.__name__)
    assert {"closed_form", "constrained_optimum", "kuhn_tucker", "least_squeeze", "least_friction"} <= set(checked)
    with pytest.raises(ValueError, match="'squeeze' or 'B', 'uniform' or 'A'"):
        tensors._forces("closed_form", "C", *[None] * 6)


def test_verdicts_have_names():
    answers = jaxgrasp.constrained_optimum(GRASP, WRENCHES)
    expected = [Verdict(int(code)).name for code in answers.verdict]
    assert answers.verdict_name.tolist() == expected and len(set(expected)) >= 3
    assert answers[1].verdict_name == expected[1] == "OPTIMAL"
    assert answers.verdict_name.shape == (4,) and answers[:0].verdict_name.shape == (0,)
    assert jaxgrasp.reachable_wrench(GRASP, WRENCHES[0]).verdict_name == "CLOSED_FORM_OPTIMAL"


@pytest.mark.parametrize("sharing", ["A", "B"])
def test_price_of_friction(sharing):
    """The price of friction is its definition in the forces alone, whatever the objectives are."""
    weights = GRASP.squeeze if sharing == "B" else np.ones(3)

    def objective(forces) -> np.ndarray:
        away = np.asarray(forces) - GRASP.squeeze[:, None] * GRASP.normals
        return np.sum(np.sum(away**2, -1) / (2 * weights), -1)

    closed, optimum = jaxgrasp.closed_form_and_optimum(GRASP, WRENCHES, sharing)
    price = jaxgrasp.price_of_friction(closed, optimum)
    assert price.shape == (4,) and price[0] == 0 and np.isnan(price[2:]).all()
    at_optimum = objective(optimum.forces[1])
    assert price[1] > 1e-3
    assert price[1] == pytest.approx((at_optimum - objective(closed.forces[1])) / at_optimum, rel=1e-6)
    assert float(jaxgrasp.price_of_friction(closed[1], optimum[1])) == pytest.approx(price[1])
    with pytest.raises(ValueError, match=r"optimum.verdict\[1\] is OUTSIDE_CONES"):
        jaxgrasp.price_of_friction(optimum, closed)
