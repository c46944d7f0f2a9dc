"""Public functions of the rooms ask of their arguments what their annotations say, all of them by construction."""

import importlib
import inspect
import typing

import jax
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import grip, hand, literature, quality, sensitivity
from jaxgrasp.validation.checked import check_value, hints_of
from tests.test_bad_arguments import GRASP, WRENCH

ROOMS = (
    "hand",
    "grip",
    "quality",
    "sensitivity",
    "literature",
    "interop",
    "lab",
    "glove",
    "psychophysics",
    "world",
    "teleop",
)
FUNCTIONS = {
    f"{room}.{name}": function
    for room in ROOMS
    for name in dir(importlib.import_module(f"jaxgrasp.{room}"))
    if not name.startswith("_")
    and callable(function := getattr(importlib.import_module(f"jaxgrasp.{room}"), name))
    and not inspect.isclass(function)
}
UNCHECKED = {"model", "data"}
"""Of the physics engine, which need not be installed; what comes is looked at by what it holds."""
PARAMETERS = [
    pytest.param(name, hint, id=f"{where}-{name}")
    for where, function in FUNCTIONS.items()
    for name, hint in hints_of(function).items()
    if hint is not typing.Any
]


class Nothing:
    """Type that no function accepts."""


def takes(hint, kind: type) -> bool:
    return hint is kind or kind in typing.get_args(hint)


def refusal(name: str, value, hint) -> str:
    with pytest.raises((TypeError, ValueError)) as caught:
        check_value(name, value, hint)
    text = str(caught.value)
    assert text.startswith(f"{name} ") and ": expected " in text and "\n" not in text and len(text) < 250
    return text


def test_every_public_function_is_checked():
    assert len(FUNCTIONS) > 45
    assert [name for name, function in FUNCTIONS.items() if not getattr(function, "__is_checked__", False)] == []
    for function in FUNCTIONS.values():
        left_out = inspect.signature(function).parameters.keys() - hints_of(function).keys()
        assert left_out <= UNCHECKED | {name for name in left_out if name in ("effort", "options")}, function


@pytest.mark.parametrize(("name", "hint"), PARAMETERS)
def test_what_no_function_takes_is_refused_by_name(name, hint):
    refusal(name, Nothing(), hint)
    if not takes(hint, type(None)):
        assert "None" in refusal(name, None, hint)
    if hasattr(hint, "dim_str"):
        refusal(name, "abc", hint)
        refusal(name, {"a": 1}, hint)
        refusal(name, np.ones((2, 3, 6), complex), hint)
        refusal(name, np.full((2, 3, 6), "a"), hint)
        refusal(name, [[1, 2], [3]], hint)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: literature.nakamura(None, WRENCH[0]), "grasp is None: expected a Grasp"),
        (lambda: literature.buss(GRASP[0], 1j * WRENCH[0]), r"wrench is .*: expected an array of numbers"),
        (lambda: literature.kuhn_tucker(GRASP[0], WRENCH[0][:5]), r"wrench has shape \(5,\): expected \(..., 6\)"),
        (lambda: literature.lagrange_forces(GRASP, "w", None), "wrench is 'w' of type str: expected an array"),
        (lambda: hand.check_shape("ball"), "shape is 'ball' of type str: expected a Shape"),
        (lambda: hand.human_hand("long"), "length is 'long' of type str: expected a number"),
        (lambda: hand.human_hand(side=3), "side is 3 of type int: expected a text"),
        (lambda: hand.mirrored(None), "hand is None: expected a Hand"),
        (lambda: grip.precision_grip(None, hand.Sphere(0.03)), "hand is None: expected a Hand"),
        (lambda: grip.power_grip(hand.human_hand(), hand.Sphere(0.03), np.nan), "depth is nan: expected"),
        (lambda: quality.ferrari_canny("grasp"), "grasp is 'grasp' of type str: expected a Grasp"),
        (lambda: quality.ferrari_canny(GRASP, "l7"), "bound is 'l7': expected 'l1' or 'linf'"),
        (lambda: quality.ferrari_canny(GRASP, max_points=2.5), "max_points is 2.5 of type float: expected a whole"),
        (lambda: sensitivity.friction_reserve(GRASP, WRENCH[:, :5]), r"wrench has shape \(2, 5\): expected \(..., 6\)"),
        (lambda: grip.monitor(GRASP, "abc"), "wrench is 'abc' of type str: expected an array"),
    ],
)
def test_whole_calls_name_what_is_wrong(call, words):
    with pytest.raises((TypeError, ValueError), match=words):
        call()


def test_transformed_arguments_pass():
    """Tracers, lists and numbers of every kind are what they stand for."""
    values = jax.jit(jax.vmap(quality.singular_values))(jax.tree.map(jax.numpy.asarray, GRASP))
    np.testing.assert_allclose(values, quality.singular_values(GRASP), rtol=1e-12)
    check_value("x", [1.0, 2, 3], jaxgrasp.model.arrays.Float[np.ndarray, "3"])
    check_value("x", np.float32(1), float)
    check_value("x", jax.numpy.asarray(1.0), float)


def test_too_few_or_unknown_arguments_are_named_by_python_itself():
    with pytest.raises(TypeError, match="missing .*required.* 'grasp'"):
        quality.singular_values()
    with pytest.raises(TypeError, match="unexpected keyword argument 'nothing'"):
        quality.singular_values(GRASP, nothing=1)
