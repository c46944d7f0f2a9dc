"""check_grasp names the field, the first bad index, the value and what was expected."""

import jax
import numpy as np
import pytest

from jaxgrasp import Grasp, GraspError, check_grasp
from jaxgrasp.model.faults import value_faults


def fields() -> dict[str, np.ndarray]:
    """Return two grasps of three contacts, all good."""
    points = np.random.default_rng(0).normal(size=(2, 3, 3))
    normals = points.mean(1, keepdims=True) - points
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return {"points": points, "normals": normals, "friction": np.full((2, 3), 0.5), "squeeze": np.ones((2, 3))}


def fault_of(**changed):
    with pytest.raises(GraspError) as caught:
        check_grasp(Grasp(**{**fields(), **changed}))
    return caught.value.fault


def test_a_good_grasp_comes_back():
    grasp = Grasp(**fields())
    assert check_grasp(grasp) is grasp
    zero = Grasp(**{**fields(), "friction": np.zeros((2, 3)), "squeeze": np.zeros((2, 3))})
    assert check_grasp(zero) is zero


@pytest.mark.parametrize("field", ["points", "normals", "friction", "squeeze"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(field, value):
    data = fields()
    data[field][1, 2] = value
    fault = fault_of(**{field: data[field]})
    assert (fault.field, fault.index) == (field, (1, 2))
    assert "finite" in fault.expected
    assert ("nan" if np.isnan(value) else "inf") in str(fault.value)
    assert str(fault) == f"{field}[1, 2] is {fault.value}: expected {fault.expected}"


@pytest.mark.parametrize("field", ["friction", "squeeze"])
def test_negative_values(field):
    data = fields()
    data[field][0, 1] = -0.25
    fault = fault_of(**{field: data[field]})
    assert (fault.field, fault.index, fault.value) == (field, (0, 1), "-0.25")
    assert "zero or more" in fault.expected


@pytest.mark.parametrize("length", [0.0, 0.999, 1.00001, 2.0])
def test_normals_that_are_not_unit(length):
    data = fields()
    data["normals"][1, 0] *= length
    fault = fault_of(normals=data["normals"])
    assert (fault.field, fault.index) == ("normals", (1, 0))
    assert f"of length {length:.9g}" in fault.value and "length 1" in fault.expected


def test_normals_of_a_single_precision_file_pass():
    data = {name: array.astype(np.float32) for name, array in fields().items()}
    check_grasp(Grasp(**data))
    data = {name: array.astype(np.float32).astype(float) for name, array in fields().items()}
    check_grasp(Grasp(**data))


def test_the_first_bad_entry_is_named():
    data = fields()
    data["friction"][0, 2] = data["friction"][1, 0] = -1
    data["squeeze"][0, 0] = -1
    fault = fault_of(friction=data["friction"], squeeze=data["squeeze"])
    assert (fault.field, fault.index) == ("friction", (0, 2))


@pytest.mark.parametrize("field, shape", [("normals", (2, 4, 3)), ("friction", (3,)), ("squeeze", (2, 3, 1))])
def test_shapes_that_do_not_fit(field, shape):
    # Built without the constructor's shape check, as unpickled or unchecked data would be.
    grasp = object.__new__(Grasp)
    for name, array in {**fields(), "present": None, "torsion": None, field: np.ones(shape)}.items():
        object.__setattr__(grasp, name, array)
    with pytest.raises(GraspError) as caught:
        check_grasp(grasp)
    assert caught.value.fault.field == field
    assert str(shape) in str(caught.value)


def test_absent_contacts_are_not_looked_at():
    data = fields()
    present = np.ones((2, 3))
    present[0, 1] = 0
    for array in data.values():
        array[0, 1] = np.nan
    check_grasp(Grasp(**data, present=present))
    data["points"][1, 1] = np.nan
    assert fault_of(**data, present=present).index == (1, 1)


def test_presence_is_zero_or_one():
    fault = fault_of(present=np.full((2, 3), 0.5))
    assert (fault.field, fault.index, fault.expected) == ("present", (0, 0), "0 or 1")


def test_mixed_dtypes_are_named():
    fault = fault_of(friction=np.full((2, 3), 0.5, np.float32))
    assert fault.field == "friction" and "float32" in fault.value and "float64" in fault.expected


def test_traced_grasps_cannot_be_checked():
    with pytest.raises(TypeError, match="outside jit"):
        jax.jit(lambda grasp: check_grasp(grasp).points)(Grasp(**fields()))


def test_every_fault_is_found_at_once():
    data = fields()
    data["points"][0, 0, 1] = np.nan
    data["friction"][1, 1] = -1
    places = [(fault.field, fault.index) for fault in value_faults(**data)]
    assert places == [("points", (0, 0)), ("friction", (1, 1))]
