"""What a glove loses of a grip without one of its joints, against the same posture looked at alone."""

import csv

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.grip import Body, observe
from jaxgrasp.grip.scene_file import gripped_scene, load_scene, ready_scenes
from jaxgrasp.hand import Pose, Posture, Sphere, find_contacts, pose_hand
from jaxgrasp.lab.ablation import joint_losses
from jaxgrasp.world import Thing, World, at_rest, world_of

pytestmark = pytest.mark.slow
MODEL = lrp_hand_master()


@pytest.fixture(scope="module")
def made():
    return gripped_scene(load_scene(ready_scenes()["cylinder"]))


def test_losses_are_those_of_the_posture_without_the_joint(made):
    losses = joint_losses(made, MODEL)
    assert {one.joint for one in losses} == set(MODEL.joints)
    np.testing.assert_allclose(sum(one.felt for one in losses), 1.0)
    assert [one.felt for one in losses] == sorted((one.felt for one in losses), reverse=True)
    joints = list(made.scene.hand.joints)
    squeeze = made.scene.stiffness * np.asarray(made.scene.contributions)
    whole = float(np.asarray(made.contacts.depths) @ squeeze)
    for one in losses[:4]:
        angles = np.asarray(made.closed.angles).copy()
        angles[joints.index(one.joint)] = 0.0
        left = find_contacts(made.scene.hand, Posture(made.closed.wrist, angles), made.scene.body.shape, made.placed)
        assert one.contacts == int(made.contacts.present.sum() - left.present.sum())
        np.testing.assert_allclose(one.squeeze, 1 - float(np.asarray(left.depths) @ squeeze) / whole, atol=1e-9)


def test_what_is_felt_is_that_of_the_whole_hand_clear_of_the_table(made):
    losses = joint_losses(made, MODEL)
    lifted = eqx.tree_at(lambda s: s.table.origin, made.scene, made.scene.table.origin - np.array([0, 0, 0.5]))
    torques = -np.asarray(observe(lifted, made.closed, made.placed, law=made.law).torques)
    by_joint = dict(zip(made.scene.hand.joints, torques, strict=True))
    np.testing.assert_allclose([one.torque for one in losses], [by_joint[one.joint] for one in losses], atol=1e-9)


def test_among_several_objects_each_is_carried_by_the_hand_alone():
    """Of a ball on two blocks, which the hand does not touch, what is lost is what is lost of the ball alone."""
    file = load_scene(ready_scenes()["stack"])
    made = gripped_scene(file)
    world, state = world_of(file, made)
    for one, alone in zip(joint_losses(made, MODEL, (world, state)), joint_losses(made, MODEL), strict=True):
        assert (one.joint, one.contacts, one.holds) == (alone.joint, alone.contacts, alone.holds)
        np.testing.assert_allclose(one[1:3] + one[4:5], alone[1:3] + alone[4:5], atol=1e-9)
    # A ball at the palm's outside leans on the little finger: its weight and contact are of that finger's joints too.
    little = [link.name for link in made.scene.hand.links].index("little distal")
    links = pose_hand(made.scene.hand, made.closed).links
    radius = float(np.max(made.scene.hand.skin.radii[little]))
    pad = np.asarray(links.origin)[little] + np.asarray(links.rotation)[little] @ np.asarray(
        made.scene.hand.skin.centers[little][-1]
    )
    beside = np.concatenate([state.placed.origin, [pad + [0.0, 0.0, 0.01 + radius - 1e-3]]])
    more = Thing(Body(Sphere(0.01), 0.02), 0.6, 800.0, 0.5)
    placed = Pose(beside, np.concatenate([state.placed.rotation, np.eye(3)[None]]))
    whole = World(made.scene, (*world.others, more)), at_rest(placed)
    both = {one.joint: one for one in joint_losses(made, MODEL, whole)}
    alone = {one.joint: one for one in joint_losses(made, MODEL)}
    gripping = ("thumb MP", "index MP")
    assert all(both[joint].contacts == alone[joint].contacts for joint in gripping)
    assert both["little MP"].contacts == alone["little MP"].contacts + 1
    # By the forces on both objects: those of a hand that has the second one alone come on top.
    second = eqx.tree_at(
        lambda s: (s.body, s.table.origin), made.scene, (more.body, made.scene.table.origin - np.array([0, 0, 1.0]))
    )
    there = Pose(jnp.asarray(beside[-1]), jnp.eye(3))
    torques = -np.asarray(observe(second, made.closed, there, law=made.law).torques)
    by_joint = dict(zip(made.scene.hand.joints, torques, strict=True))
    for joint, one in both.items():
        assert one.torque == pytest.approx(alone[joint].torque + by_joint[joint], abs=1e-9)
    assert max(abs(by_joint[joint]) for joint in both) > 1e-4


def test_several_objects_are_a_scene_like_another(folder, capsys):
    assert main(["glove", "ablate", "stack"]) == 0
    assert "a ball on two blocks: without one of the glove's joints" in capsys.readouterr().out


def test_a_joint_is_a_line_and_a_row(folder, capsys):
    assert main(["glove", "ablate", "cylinder", "--out", "lost.csv"]) == 0
    said = capsys.readouterr().out
    with open(folder / "lost.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["joint"] for row in rows] and {row["joint"] for row in rows} == set(MODEL.joints)
    assert all(joint in said for joint in MODEL.joints)
    np.testing.assert_allclose(sum(float(row["share felt"]) for row in rows), 1.0, atol=1e-5)
    assert main(["glove", "ablate", "nowhere"]) == 1
    assert "expected a TOML file, or one of" in capsys.readouterr().err
