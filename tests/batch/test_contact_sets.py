"""Contact sets of different sizes: slices, padding, faults."""

import dataclasses

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.contact_sets import CONTACT_FIELDS, ContactSets


def assert_same(a: ContactSets, b: ContactSets) -> None:
    for name in (*CONTACT_FIELDS, "offsets", "wrench"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_slices_and_indices_choose_the_same_rows(ragged):
    assert_same(ragged.rows(slice(2, 5)), ragged.rows(np.array([2, 3, 4])))
    assert_same(ragged.rows(slice(0, 6, 2)), ragged.rows(np.array([0, 2, 4])))
    assert len(ragged.rows(slice(3, 3))) == 0
    assert len(ragged.rows(np.array([], int))) == 0


def test_padding_comes_back_out(ragged):
    padded = ragged.padded(8)
    assert padded.points.shape == (7, 8, 3)
    assert padded.present.sum() == len(ragged.points)
    assert_same(ContactSets.from_grasp(padded, ragged.wrench), ragged)


def test_equal_sizes_need_no_padding(ragged):
    fives = ragged.rows(np.flatnonzero(ragged.sizes == 5))
    assert fives.padded(5).present is None


def test_one_wrench_serves_every_grasp(ragged):
    sets = ContactSets.from_grasp(ragged.padded(6), np.arange(6.0))
    assert sets.wrench.shape == (7, 1, 6)


@pytest.mark.parametrize(
    ("field", "contact", "value", "words"),
    [
        ("points", 4, [0, np.nan, 0], ["points[1, 1]", "nan", "finite coordinates"]),
        ("normals", 0, [0, 0, 2], ["normals[0, 0]", "2", "length 1"]),
        ("normals", 9, [0, 0, 0], ["normals[2, 1]", "length 0", "length 1"]),
        ("normals", 9, [0, np.inf, 0], ["normals[2, 1]", "inf", "finite"]),
        ("friction", 10, -0.1, ["friction[3, 0]", "-0.1", "zero or more"]),
        ("friction", 10, np.inf, ["friction[3, 0]", "inf", "zero or more"]),
        ("squeeze", 27, -1.0, ["squeeze[6, 5]", "-1.0", "zero or more"]),
        ("wrench", (5, 0, 2), np.nan, ["wrench[5]", "nan", "six finite numbers"]),
    ],
)
def test_a_fault_names_field_index_value_and_expectation(ragged, field, contact, value, words):
    array = getattr(ragged, field).copy()
    array[contact] = value
    (fault,) = dataclasses.replace(ragged, **{field: array}).faults()
    for word in words:
        assert word in str(fault)
    numbered = next(dataclasses.replace(ragged, **{field: array}).faults(first_grasp=100))
    assert numbered.index[0] == fault.index[0] + 100


def test_every_fault_is_found(ragged):
    friction = ragged.friction.copy()
    friction[[0, 3, 20]] = -1
    assert len(list(dataclasses.replace(ragged, friction=friction).faults())) == 3


def test_a_grasp_without_contacts_is_a_fault(ragged):
    offsets = np.insert(ragged.offsets, 3, ragged.offsets[3])
    wrench = np.insert(ragged.wrench, 3, 0, axis=0)
    (fault,) = dataclasses.replace(ragged, offsets=offsets, wrench=wrench).faults()
    assert "offsets[3]" in str(fault)


@pytest.mark.parametrize("shape", [(6, 6), (7, 5), (7, 0, 6), (7,), (8, 2, 6)])
def test_wrenches_that_do_not_fit_are_refused(ragged, shape):
    with pytest.raises(jaxgrasp.GraspError, match=r"wrench is an array of shape .*: expected a shape \(7, 6\)"):
        ContactSets.from_grasp(ragged.padded(6), np.zeros(shape))
