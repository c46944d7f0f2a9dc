"""Postures that no hand can take are refused by name, or clamped; NaN is never taken for absence."""

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp import Verdict
from jaxgrasp.hand import Pose, Posture, Sphere, check_clear, check_posture, clamp_posture, find_contacts, human_hand
from tests.hand.hands import random_posture

HAND = human_hand()


def changed(posture: Posture, field: str, index: tuple, value: float) -> Posture:
    arrays = {
        name: np.array(array)
        for name, array in (
            ("origin", posture.wrist.origin),
            ("rotation", posture.wrist.rotation),
            ("angles", posture.angles),
        )
    }
    arrays[field][index] = value
    return Posture(Pose(arrays["origin"], arrays["rotation"]), arrays["angles"])


def test_every_posture_within_limits_passes():
    check_posture(HAND, random_posture(HAND, 100))


@pytest.mark.parametrize(
    "field, index, value, message",
    [
        ("angles", (3, 4), 2.0, r"angles\[3, 4\] \(index MP\) is 2 rad: expected 0 to 1.5708"),
        ("angles", (0, 0), -0.1, r"angles\[0, 0\] \(thumb abduction\) is -0.1 rad: expected 0 to 1.0472"),
        ("angles", (2, 1), np.nan, r"angles\[2, 1\] \(thumb MP\) is nan rad"),
        ("origin", (1, 2), np.inf, r"wrist.origin\[1, 2\] is inf: expected a finite number"),
        ("rotation", (2, 0, 0), 1.5, r"wrist.rotation\[2\] is not a rotation"),
        ("rotation", (4,), -np.eye(3), r"wrist.rotation\[4\] is not a rotation"),
        ("rotation", (1, 1, 1), np.nan, r"wrist.rotation\[1\] is not a rotation"),
    ],
)
def test_the_first_bad_entry_is_named(field, index, value, message):
    with pytest.raises(ValueError, match=message):
        check_posture(HAND, changed(random_posture(HAND, 5), field, index, value))


def test_clamping_brings_angles_to_their_limits_and_leaves_the_rest():
    posture = random_posture(HAND, 5)
    wild = changed(posture, "angles", (3, 4), 2.0)
    tamed = clamp_posture(HAND, wild)
    check_posture(HAND, tamed)
    assert float(tamed.angles[3, 4]) == pytest.approx(np.pi / 2)
    keep = np.ones((5, 19), bool)
    keep[3, 4] = False
    np.testing.assert_array_equal(np.asarray(tamed.angles)[keep], posture.angles[keep])


@pytest.mark.slow
def test_a_pose_that_is_not_a_number_is_bad_data_and_leaves_its_neighbours_alone():
    posture = random_posture(HAND, 5)
    placed = Pose(posture.wrist.origin + 0.05 * posture.wrist.rotation[..., 0], posture.wrist.rotation)
    sound = find_contacts(HAND, posture, Sphere(0.05), placed)
    radii = np.array([0.05, 0.05, np.nan, 0.05, 0.05])
    for broken, shape in (
        (changed(posture, "origin", (2, 0), np.nan), Sphere(0.05)),
        (changed(posture, "angles", (2, 5), np.nan), Sphere(0.05)),
        (posture, Sphere(radii)),
    ):
        contacts = find_contacts(HAND, broken, shape, placed)
        assert np.isnan(contacts.present[2]).any()
        others = np.array([0, 1, 3, 4])
        np.testing.assert_allclose(contacts.depths[others], sound.depths[others], atol=1e-15)
        grasp = jaxgrasp.hand.grasp_from_contacts(contacts, 0.5, 1000.0)
        wrench = np.broadcast_to([0.0, 0, 3, 0, 0, 0], (5, 6))
        verdict = jaxgrasp.closed_form(grasp, wrench).verdict
        assert verdict[2] == Verdict.INVALID_DATA and (verdict[others] != Verdict.INVALID_DATA).all()


def test_a_start_inside_the_object_is_refused_by_name():
    posture = random_posture(HAND, 5)
    outside = posture.wrist.origin + np.array([0.0, 0.0, 1.0])
    check_clear(HAND, posture, Sphere(0.05), Pose(outside, posture.wrist.rotation))
    within = outside.copy()
    within[3] = posture.wrist.origin[3]
    with pytest.raises(
        ValueError, match=r"posture\[3\]: the link .* starts .* m inside the object: expected at most 0 m"
    ):
        check_clear(HAND, posture, Sphere(0.05), Pose(within, posture.wrist.rotation))
    check_clear(HAND, posture, Sphere(0.05), Pose(within, posture.wrist.rotation), depth=0.2)
    within[3] = np.nan
    with pytest.raises(ValueError, match=r"posture\[3\]: .* starts nan m inside"):
        check_clear(HAND, posture, Sphere(0.05), Pose(within, posture.wrist.rotation), depth=0.2)
