"""Faults of limits and torsion, reported before anything is computed."""

import jax
import numpy as np
import pytest

from jaxgrasp import Grasp, GraspError, Limits, check_grasp, check_limits

POINTS = np.zeros((2, 3, 3))
INWARD = np.broadcast_to([0.0, 0.0, 1.0], (2, 3, 3)).copy()
UNITS = np.ones((2, 3))


def grasp(**fields) -> Grasp:
    return Grasp(**({"points": POINTS, "normals": INWARD, "friction": UNITS, "squeeze": UNITS} | fields))


def limits(**fields) -> Limits:
    good = {
        "normal_min": 0 * UNITS,
        "normal_max": np.full((2, 3), np.inf),
        "torque_map": np.ones((2, 3, 3, 4)),
        "torque_max": np.ones((2, 4)),
    }
    return Limits(**(good | fields))


def put(array: np.ndarray, place: tuple[int, ...], value: float) -> np.ndarray:
    changed = array.copy()
    changed[place] = value
    return changed


def test_good_ones_pass_unchanged():
    expected = limits()
    assert check_limits(expected, grasp()) is expected
    assert check_limits(Limits(), grasp()) == Limits()
    soft = grasp(torsion=0.01 * UNITS)
    assert check_grasp(soft) is soft


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"normal_min": put(0 * UNITS, (1, 2), -1.0)}, r"normal_min\[1, 2\] is -1.0: expected a finite number"),
        ({"normal_min": put(0 * UNITS, (0, 1), np.inf)}, r"normal_min\[0, 1\] is inf: expected a finite number"),
        ({"normal_max": put(UNITS, (0, 1), np.nan)}, r"normal_max\[0, 1\] is nan: expected a number, zero or more"),
        (
            {"normal_min": 2 * UNITS, "normal_max": UNITS},
            r"normal_max\[0, 0\] is 1.0: expected no less than normal_min",
        ),
        ({"torque_map": put(np.ones((2, 3, 3, 4)), (1, 0, 2, 3), np.inf)}, r"torque_map\[1, 0, 2, 3\] is inf"),
        ({"torque_max": put(np.ones((2, 4)), (1, 3), -0.5)}, r"torque_max\[1, 3\] is -0.5: expected a number, zero"),
        ({"torque_max": None}, "torque_max is None: expected an array, beside torque_map"),
        ({"torque_map": None}, "torque_map is None: expected an array, beside torque_max"),
        ({"torque_map": np.ones((2, 3, 2, 4))}, r"torque_map is an array of shape .*: expected a shape \(2, 3, 3 or 4"),
        ({"torque_max": np.ones((2, 3))}, r"torque_max is an array of shape \(2, 3\): expected the shape \(2, 4\)"),
        ({"normal_max": np.ones((2, 4))}, r"normal_max is an array of shape \(2, 4\): expected the shape \(2, 3\)"),
    ],
)
def test_each_fault_names_its_field_place_and_value(fields, message, unchecked):
    with pytest.raises(GraspError, match=message):
        check_limits(limits(**fields), grasp())


def test_absent_contacts_are_not_looked_at():
    present = put(UNITS, (1, 2), 0.0)
    spoilt = limits(normal_min=put(0 * UNITS, (1, 2), np.nan))
    assert check_limits(spoilt, grasp(present=present)) is spoilt
    assert check_grasp(grasp(present=present, torsion=put(UNITS, (1, 2), np.nan)))


@pytest.mark.parametrize(("value", "expected"), [(np.nan, "a finite length"), (-0.1, "a finite length")])
def test_torsion_that_is_no_length(value, expected):
    with pytest.raises(GraspError, match=rf"torsion\[1, 0\] is {value}: expected {expected}"):
        check_grasp(grasp(torsion=put(0 * UNITS, (1, 0), value)))


def test_torsion_without_friction():
    with pytest.raises(GraspError, match=r"torsion\[0, 2\] is 0.01: expected 0 where friction is 0"):
        check_grasp(grasp(friction=put(UNITS, (0, 2), 0.0), torsion=0.01 * UNITS))


def test_traced_limits_have_no_values():
    with pytest.raises(TypeError, match="check_limits needs concrete arrays"):
        jax.jit(lambda traced: check_limits(traced, grasp()).torque_max)(limits())
