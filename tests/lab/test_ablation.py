"""Loss of a grip's forces without each of the glove's joints, against the same posture computed alone."""

import csv

import equinox as eqx
import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.grip import observe
from jaxgrasp.grip.scene_file import gripped_scene, load_scene, ready_scenes
from jaxgrasp.hand import Pose, Posture, find_contacts
from jaxgrasp.lab.ablation import joint_losses
from jaxgrasp.world import World, at_rest, world_of

pytestmark = pytest.mark.slow
MODEL = lrp_hand_master()


@pytest.fixture(scope="module")
def made():
    return gripped_scene(load_scene(ready_scenes()["cylinder"]))


def test_losses_are_those_of_the_posture_without_the_joint(made):
    losses = joint_losses(made, MODEL)
    assert {loss.joint for loss in losses} == set(MODEL.joints)
    np.testing.assert_allclose(sum(loss.torque_share for loss in losses), 1.0)
    assert [loss.torque_share for loss in losses] == sorted((loss.torque_share for loss in losses), reverse=True)
    joints = list(made.scene.hand.joints)
    squeeze = made.scene.stiffness * np.asarray(made.scene.contributions)
    total_squeeze = float(np.asarray(made.contacts.depths) @ squeeze)
    for loss in losses[:4]:
        angles = np.asarray(made.closed.angles).copy()
        angles[joints.index(loss.joint)] = 0.0
        left = find_contacts(made.scene.hand, Posture(made.closed.wrist, angles), made.scene.body.shape, made.placed)
        assert loss.contacts == int(made.contacts.present.sum() - left.present.sum())
        np.testing.assert_allclose(
            loss.squeeze, 1 - float(np.asarray(left.depths) @ squeeze) / total_squeeze, atol=1e-9
        )


def test_what_is_felt_is_that_of_the_whole_hand_clear_of_the_table(made):
    losses = joint_losses(made, MODEL)
    lifted = eqx.tree_at(lambda s: s.table.origin, made.scene, made.scene.table.origin - np.array([0, 0, 0.5]))
    torques = -np.asarray(observe(lifted, made.closed, made.placed, law=made.law).torques)
    by_joint = dict(zip(made.scene.hand.joints, torques, strict=True))
    np.testing.assert_allclose([loss.torque for loss in losses], [by_joint[loss.joint] for loss in losses], atol=1e-9)


def test_among_several_objects_each_is_carried_by_the_hand_alone():
    """For a ball on two blocks that the hand does not touch, the losses are those of the ball alone."""
    file = load_scene(ready_scenes()["stack"])
    made = gripped_scene(file)
    world, state = world_of(file, made)
    for loss, alone in zip(joint_losses(made, MODEL, (world, state)), joint_losses(made, MODEL), strict=True):
        assert (loss.joint, loss.contacts, loss.holds) == (alone.joint, alone.contacts, alone.holds)
        np.testing.assert_allclose(loss[1:3] + loss[4:5], alone[1:3] + alone[4:5], atol=1e-9)


def test_two_objects_at_one_place_are_twice_the_loss(made):
    """Each is touched as the one is alone, and weighs as much: twice the torques and contacts, shares as they were."""
    body = World(made.scene).bodies[0]
    state = at_rest(Pose(*(np.stack([part, part]) for part in (made.placed.origin, made.placed.rotation))))
    alone = {loss.joint: loss for loss in joint_losses(made, MODEL)}
    for loss in joint_losses(made, MODEL, (World(made.scene, (body,)), state)):
        expected = alone[loss.joint]
        assert (loss.contacts, loss.holds) == (2 * expected.contacts, expected.holds)
        np.testing.assert_allclose(loss.torque, 2 * expected.torque, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(
            (loss.torque_share, loss.squeeze), (expected.torque_share, expected.squeeze), atol=1e-9
        )


def test_several_objects_are_a_scene_like_another(folder, capsys):
    assert main(["glove", "ablate", "stack"]) == 0
    assert "a ball on two blocks: without one of the glove's joints" in capsys.readouterr().out


def test_a_joint_is_a_line_and_a_row(folder, capsys):
    assert main(["glove", "ablate", "cylinder", "--out", "lost.csv"]) == 0
    output = capsys.readouterr().out
    with open(folder / "lost.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["joint"] for row in rows] and {row["joint"] for row in rows} == set(MODEL.joints)
    assert all(joint in output for joint in MODEL.joints)
    np.testing.assert_allclose(sum(float(row["share felt"]) for row in rows), 1.0, atol=1e-5)
    assert main(["glove", "ablate", "nowhere"]) == 1
    assert "expected a TOML file, or one of" in capsys.readouterr().err
