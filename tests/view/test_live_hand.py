"""A live hand: what it sees is what the paper's loop observes, and its programs are compiled once."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip.monitor import Hold
from jaxgrasp.grip.scene_entries import TableEntry
from jaxgrasp.grip.scene_file import GrippedScene, SceneFile, gripped_scene
from jaxgrasp.grip.tick import observe
from jaxgrasp.hand.human_hand import open_angles
from jaxgrasp.hand.kinematics import pose_hand
from jaxgrasp.report.surfaces import pose_matrix
from jaxgrasp.view import live_scene
from jaxgrasp.view.live_scene import LiveHand

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def made() -> GrippedScene:
    return gripped_scene(SceneFile(table=TableEntry(below=0.1)))


@pytest.fixture(scope="module")
def hand(made) -> LiveHand:
    return LiveHand(made, "optimum")


def test_it_sees_what_the_loop_observes(made, hand):
    picture = hand.look(hand.initial_controls())
    tick = observe(made.scene, made.closed, made.placed, law="optimum")
    np.testing.assert_allclose(picture.points[picture.touching], tick.contacts.points[picture.touching], atol=1e-9)
    for name in ("closed", "optimum"):
        got, expected = (getattr(each_step.assessment, name) for each_step in (picture, tick))
        assert int(got.verdict) == int(expected.verdict)
        np.testing.assert_allclose(got.forces, expected.forces, atol=1e-6)
    np.testing.assert_allclose(picture.hand.torques, tick.torques, atol=1e-7)
    np.testing.assert_allclose(
        picture.hand.links, pose_matrix(pose_hand(made.scene.hand, made.closed).links), atol=1e-9
    )


def test_sliders_change_what_they_say_and_compile_nothing(hand):
    first = hand.initial_controls()
    plain = hand.look(first)
    programs = live_scene._programs().look._cache_size()
    heavy = hand.look(first._replace(mass=2 * first.mass))
    np.testing.assert_allclose(heavy.wrench, 2 * plain.wrench)
    firm = hand.look(first._replace(squeeze=3.0))
    np.testing.assert_allclose(firm.grasp.squeeze, 3 * plain.grasp.squeeze)
    assert np.asarray(hand.look(first._replace(friction=0.9)).grasp.friction) == pytest.approx(0.9)
    aside = hand.look(first._replace(shift=np.array([0.0, 0.0, -0.001])))
    assert aside.object_pose[2, 3] == pytest.approx(plain.object_pose[2, 3] - 0.001)
    turned = hand.look(first._replace(gravity=np.array([9.81, 0, 0])))
    np.testing.assert_allclose(turned.wrench[:3], [-plain.wrench[2], 0, 0], atol=1e-9)
    escaped = hand.look(first._replace(angles=open_angles(hand.gripped.scene.hand), shift=np.array([0, 0, -0.3])))
    assert int(escaped.assessment.hold) == Hold.LOST and not escaped.touching.any()
    assert live_scene._programs().look._cache_size() == programs


def test_where_no_forces_exist_the_object_escapes_along_what_no_contact_resists(hand):
    picture = hand.look(hand.initial_controls()._replace(friction=0.0))
    twist = picture.escape
    velocities = twist[:3] + np.cross(twist[3:], np.asarray(picture.grasp.points))
    # Frictionless, a contact keeps the object from coming nearer along its normal, and from nothing else.
    into = np.sum(velocities * np.asarray(picture.grasp.normals), axis=1)[picture.touching]
    assert into.min() >= -1e-6 * np.abs(velocities).max()
    assert -twist @ picture.wrench > 0


def test_time_goes_on_a_held_object_is_lifted_and_one_that_is_let_go_falls(hand):
    first = hand.initial_controls()
    hand.reset()
    for k in range(20):
        picture = hand.step(first._replace(lift=np.array([0, 0, 0.001 * k])), 1 / 30)
    assert int(picture.assessment.hold) == Hold.STABLE
    assert picture.object_pose[2, 3] == pytest.approx(float(hand.gripped.placed.origin[2]) + 0.018, abs=2e-3)
    height = picture.object_pose[2, 3]
    opened = first._replace(lift=np.array([0, 0, 0.02]), angles=open_angles(hand.gripped.scene.hand))
    for _ in range(12):
        picture = hand.step(opened, 1 / 30)
    assert picture.object_pose[2, 3] < height - 0.03
    hand.reset()
    assert hand.step(first, 1 / 30).object_pose[2, 3] == pytest.approx(
        float(jnp.asarray(hand.gripped.placed.origin)[2])
    )
