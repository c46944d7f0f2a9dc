"""Whatever comes for an argument: one sentence that names it, says what came and what was expected, before any work."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Grasp, Limits, grip, hand
from jaxgrasp.testing import problems as P

MADE = P.problems("ordinary", 3, 2, seed=1)
GRASP = Grasp(MADE.points, MADE.normals, MADE.friction, MADE.squeeze)
WRENCH, FORCES = MADE.wrench, MADE.squeeze[..., None] * MADE.normals
GRASP_AND_WRENCH = {"grasp": GRASP, "wrench": WRENCH}
ZERO, CODES = jnp.zeros(2), jnp.zeros(2, int)
ANSWER = jaxgrasp.Solution(
    forces=jnp.asarray(FORCES),
    multiplier=jnp.asarray(WRENCH),
    verdict=CODES,
    residual=ZERO,
    objective=ZERO,
    steps=CODES,
    route=CODES,
    rank=CODES,
    certificate=jnp.asarray(WRENCH),
    force_bound=ZERO,
)
CALLS: dict[str, dict] = {
    "best_forces": GRASP_AND_WRENCH | {"objective": "least_norm"},
    "check_grasp": {"grasp": GRASP},
    "check_limits": {"limits": Limits(normal_max=np.ones((2, 3))), "grasp": GRASP},
    "closed_form": GRASP_AND_WRENCH,
    "closed_form_and_optimum": GRASP_AND_WRENCH,
    "constrained_optimum": GRASP_AND_WRENCH | {"start": WRENCH},
    "dual_value": GRASP_AND_WRENCH | {"multiplier": WRENCH},
    "friction_margin": {"grasp": GRASP, "forces": FORCES},
    "grasp_matrix": {"points": MADE.points},
    "least_friction": GRASP_AND_WRENCH,
    "least_squeeze": GRASP_AND_WRENCH,
    "least_squeeze_factor": GRASP_AND_WRENCH,
    "multiplier_forces": {"grasp": GRASP, "multiplier": WRENCH},
    "price_of_friction": {"closed": ANSWER, "optimum": ANSWER},
    "pyramid_optimum": GRASP_AND_WRENCH,
    "reachable_wrench": GRASP_AND_WRENCH,
    "slip_angle": {"grasp": GRASP, "forces": FORCES},
    "split_forces": GRASP_AND_WRENCH,
    "stability_margin": {"grasp": GRASP, "forces": FORCES},
    "verify_certificate": GRASP_AND_WRENCH | {"certificate": WRENCH},
    "weight_wrench": {"mass": 0.3, "center_of_mass": np.zeros(3), "gravity": np.array([0, 0, -9.81])},
    "wrench_margin": GRASP_AND_WRENCH | {"direction": WRENCH},
}
OTHERWISE = {
    "evaluate": "tests/batch, tests/cli",
    "load_grasps": "tests/batch/test_files.py",
    "save_grasps": "tests/batch/test_files.py",
    "use_cache": "tests/numerics/test_compiled_code.py",
}
"""Files and folders are their arguments, which have tests of their own."""


def wrong(value) -> dict:
    """Return wrong values that a user may pass in place of ``value``, by name."""
    wrong_values = {"None": None, "text": "abc", "dict": {"a": 1}}
    if isinstance(value, np.ndarray):
        wrong_values |= {
            "complex": value * (1 + 1j),
            "short": value[..., :-1],
            "strings": np.full(value.shape, "a"),
            "objects": np.full(value.shape, None),
            "scalar": np.float64(3.0),
        }
    return wrong_values


CASES = [
    pytest.param(name, argument, wrong_value, id=f"{name}-{argument}-{label}")
    for name, arguments in CALLS.items()
    for argument, value in arguments.items()
    for label, wrong_value in wrong(value).items()
    if not (label == "None" and argument == "start")
]


def test_every_public_function_is_tried():
    functions = {name for name in jaxgrasp._HOME if inspect.isfunction(getattr(jaxgrasp, name))}
    assert functions == CALLS.keys() | OTHERWISE.keys()


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(("name", "argument", "wrong_value"), CASES)
def test_a_wrong_argument_is_named(name, argument, wrong_value):
    with pytest.raises((TypeError, ValueError)) as caught:
        getattr(jaxgrasp, name)(**CALLS[name] | {argument: wrong_value})
    text = str(caught.value)
    assert text.startswith(argument) and "expected" in text and "\n" not in text and len(text) < 250


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("field", ["points", "normals", "friction", "squeeze", "present", "torsion"])
def test_a_wrong_field_of_a_grasp_is_named(field):
    fields = {name: getattr(GRASP, name) for name in ("points", "normals", "friction", "squeeze")}
    for wrong_value in ("abc", {"a": 1}, np.full((2, 3), 1j), np.full((2, 3), "a")):
        with pytest.raises(TypeError, match=f"^{field} is .*expected"):
            jaxgrasp.closed_form(Grasp(**fields | {field: wrong_value}), WRENCH)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: jaxgrasp.weight_wrench(-1.0, np.zeros(3), np.zeros(3)), "mass is -1.0: expected zero or more"),
        (lambda: jaxgrasp.weight_wrench(np.array([1.0, -2]), np.zeros(3), np.zeros(3)), r"mass\[1\] is -2.0"),
        (lambda: jaxgrasp.least_friction(GRASP, WRENCH, total=-1.0), "total is -1.0: expected zero or more"),
        (lambda: hand.signed_distance(hand.Sphere(1.0), np.zeros(2)), r"points has shape \(2,\): expected \(..., 3\)"),
        (lambda: hand.signed_distance("ball", np.zeros(3)), "shape is 'ball' of type str: expected a Shape"),
        (lambda: grip.power_grip(hand.human_hand(), hand.Cylinder(-0.03, 0.1)), "radius is -0.03: expected"),
        (lambda: grip.power_grip(None, hand.Sphere(0.03)), "hand is None: expected a Hand"),
        (lambda: grip.power_grip(hand.human_hand(), hand.Sphere(0.03), -1e-3), "depth is -0.001: expected"),
    ],
)
def test_what_cannot_be_is_refused(call, words):
    with pytest.raises((TypeError, ValueError), match=words):
        call()


def test_forces_that_are_no_numbers_have_margins_that_are_none():
    margins = jaxgrasp.friction_margin(GRASP, np.full_like(FORCES, np.nan))
    assert np.isnan(margins).all()
    assert np.isnan(jaxgrasp.stability_margin(GRASP, np.full_like(FORCES, np.nan))).all()


@pytest.mark.usefixtures("unchecked")
def test_integers_and_traced_arrays_pass():
    whole_numbers = jax.tree.map(lambda x: np.ones(x.shape, int), GRASP)
    assert jaxgrasp.closed_form(whole_numbers, np.zeros(6, int)).forces.shape == (2, 3, 3)
    solution = jax.jit(jaxgrasp.closed_form)(GRASP, WRENCH)
    np.testing.assert_allclose(solution.forces, jaxgrasp.closed_form(GRASP, WRENCH).forces, rtol=1e-12, atol=1e-12)
    mapped = jax.vmap(lambda g, w: jaxgrasp.friction_margin(g, jaxgrasp.closed_form(g, w).forces))(GRASP, WRENCH)
    assert mapped.shape == (2, 3)
