"""Robots far away: commands are checked, forces are limited, a stop takes force away, silence holds the posture."""

import numpy as np
import pytest

from jaxgrasp.teleop import FollowerContacts, NullFollower, PalmPose, robot_spec
from jaxgrasp.teleop.mujoco_hand import ARM_LIMITS, MujocoFollower
from jaxgrasp.teleop.operator import OPEN_CLOSURE, PersonModel

HERE = PalmPose(np.zeros(3), np.eye(3))


def test_a_null_robot_reaches_what_it_is_told_and_stops():
    robot = NullFollower(("a", "b"), ("tip",))
    robot.contacts = FollowerContacts(np.zeros((1, 3)), np.eye(3)[:1], np.eye(3)[:1], np.zeros(1, int))
    robot.command(0.0, np.array([0.1, 0.2]), HERE)
    assert robot.read(0.1).angles == pytest.approx([0.1, 0.2]) and len(robot.read(0.1).contacts.links) == 1
    robot.stop("button")
    robot.stop("later")
    robot.command(0.2, np.zeros(2), HERE)
    state = robot.read(0.2)
    assert state.cause == "button" and state.angles == pytest.approx([0.1, 0.2]) and not len(state.contacts.links)
    robot.release()
    assert not robot.read(0.3).cause


@pytest.mark.parametrize(
    ("angles", "palm", "message"),
    [
        (np.zeros(3), HERE, "angles has shape"),
        (np.array([0, np.nan]), HERE, r"angles\[1\], of b, is nan"),
        (np.zeros(2), PalmPose(np.array([0, np.inf, 0]), np.eye(3)), "palm.origin"),
        (np.zeros(2), PalmPose(np.zeros(3), 2 * np.eye(3)), "palm.rotation"),
    ],
)
def test_bad_commands_are_refused_by_name(angles, palm, message):
    with pytest.raises(ValueError, match=message):
        NullFollower(("a", "b")).command(0.0, angles, palm)


def test_the_wrench_of_contacts_is_about_the_given_point():
    contacts = FollowerContacts(
        np.array([[1.0, 0, 0]]), np.array([[0, 0, 1.0]]), np.array([[0, 0, 2.0]]), np.zeros(1, int)
    )
    assert contacts.wrench(np.zeros(3)) == pytest.approx([0, 0, 2, 0, -2, 0])
    assert contacts.wrench(np.array([1.0, 0, 0]))[3:] == pytest.approx(0)


def grip(workplace, until):
    """Close the hand about the peg's grip, and hold it; return the robot's posture in the grip."""
    follower, home = workplace.follower, workplace.task.home
    workplace.reset()
    for k in range(int(until / 0.002)):
        share = min(k / 300, 1.0)
        closure = OPEN_CLOSURE + share * (PersonModel().grip_closure - OPEN_CLOSURE)
        posture = workplace.retargeting(workplace.open + closure * (workplace.closed - workplace.open))
        follower.command(0.002 * k, posture, home)
        follower.read(0.002 * (k + 1))
    return posture


def test_a_grip_is_measured_with_its_normals_and_held_when_lifted(workplace):
    follower, home = workplace.follower, workplace.task.home
    posture = grip(workplace, 1.0)
    raised = PalmPose(home.origin + [0, 0, 0.05], home.rotation)
    for k in range(500):
        follower.command(
            1.0 + 0.002 * k, posture, PalmPose(home.origin + [0, 0, 0.05 * min(k / 250, 1)], home.rotation)
        )
        state = follower.read(1.0 + 0.002 * (k + 1))
    contacts = state.contacts
    fingers = {follower.links[k].split()[0] for k in contacts.links}
    assert "thumb" in fingers and len(fingers) >= 3
    assert np.all(np.sum(contacts.normals * contacts.forces, -1) >= 0)
    # The hand carries the weight, and nothing else does.
    weight = 9.81 * follower.model.body_subtreemass[follower.model.body("object").id]
    assert contacts.wrench(state.object_centre)[:3] == pytest.approx([0, 0, weight], abs=0.1 * weight)
    assert np.linalg.norm(follower.environment_force()) == pytest.approx(0)
    assert state.palm.origin == pytest.approx(raised.origin, abs=3e-3)


def test_arm_forces_are_limited(workplace):
    follower, home = workplace.follower, workplace.task.home
    workplace.reset()
    far = PalmPose(home.origin - [0, 0, 1.0], home.rotation)
    for k in range(200):
        follower.command(0.002 * k, workplace.retargeting.open, far)
        follower.read(0.002 * (k + 1))
        assert np.all(np.abs(follower.wrist_force) <= np.array(ARM_LIMITS) + 1e-9)
    assert abs(follower.wrist_force[2]) == pytest.approx(ARM_LIMITS[2])


def test_an_emergency_stop_takes_all_force_away(workplace):
    follower = workplace.follower
    grip(workplace, 0.8)
    follower.stop("button")
    state = follower.read(1.0)
    assert state.cause == "button"
    assert np.abs(follower.data.actuator_force).max() < 0.2
    follower.command(1.0, workplace.retargeting.open, workplace.task.home)
    assert follower.read(1.2).cause == "button" and np.abs(follower.data.actuator_force).max() < 0.2
    follower.release()
    assert not follower.read(1.3).cause


def test_a_robot_that_hears_nothing_holds_its_posture(workplace):
    follower, home = workplace.follower, workplace.task.home
    workplace.reset()
    follower.command(0.0, workplace.retargeting.open, PalmPose(home.origin + [0, 0.2, 0], home.rotation))
    place = follower.read(0.12).palm.origin
    # It is on its way, and goes no further.
    assert np.linalg.norm(follower.read(1.0).palm.origin - place) < 0.03
    assert np.linalg.norm(place - home.origin) < 0.19


def test_a_hand_without_the_wrist_is_refused_by_name(workplace):
    model = workplace.hand_model
    with pytest.raises(ValueError, match="no body of that name"):
        robot_spec(type(model)(model.path, "forearm of nobody"), HERE)
    with pytest.raises(ValueError, match="no body 'peg of nobody'"):
        MujocoFollower(workplace.task.spec(model), model, workplace.task.home, "peg of nobody")
