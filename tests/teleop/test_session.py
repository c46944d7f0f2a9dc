"""Both sides of a teleoperation: messages, silence, stops, and a whole trial."""

import numpy as np
import pytest

from jaxgrasp.glove.loop.exchange import GloveState
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.passivity import MotionPort
from jaxgrasp.hand import human_hand
from jaxgrasp.teleop import (
    NetworkModel,
    NullFollower,
    PalmPose,
    PersonMessage,
    PersonSide,
    RobotMessage,
    RobotSide,
    SimulatedLink,
    run_trial,
)
from jaxgrasp.teleop.follower import FollowerContacts
from jaxgrasp.teleop.live import RobotConnection, RobotHere, run_person
from jaxgrasp.teleop.session import LARGEST_WRIST_ACCELERATION, MAX_SILENCE
from jaxgrasp.teleop.wrist import SimulatedWrist

HERE = PalmPose(np.zeros(3), np.eye(3))


def test_messages_are_what_was_packed():
    message = PersonMessage(np.arange(19.0), PalmPose(np.arange(3.0), np.eye(3)), 0.25)
    again = PersonMessage.of(message.vector(), 19)
    assert np.array_equal(again.vector(), message.vector()) and len(message.vector()) == PersonMessage.size(19)
    answer = RobotMessage(np.arange(14.0), 0.5, False)
    assert np.array_equal(RobotMessage.of(answer.vector(), 14).vector(), answer.vector())
    assert not RobotMessage.of(answer.vector(), 14).is_running
    pushed = answer._replace(wrist_force=np.array([1.0, -2, 3]))
    assert np.array_equal(RobotMessage.of(pushed.vector(), 14).wrist_force, [1, -2, 3])


@pytest.mark.parametrize("index", [0, 5, 20, 31])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_messages_that_are_not_finite_are_none(index, value):
    vector = PersonMessage(np.zeros(19), HERE, 0.0).vector()
    vector[index] = value
    assert PersonMessage.of(vector, 19) is None
    assert RobotMessage.of(np.append(vector[:15], value), 14) is None


def test_messages_without_a_rotation_are_none():
    assert PersonMessage.of(PersonMessage(np.zeros(19), PalmPose(np.zeros(3), 2 * np.eye(3)), 0.0).vector(), 19) is None


def test_no_torque_flows_from_a_robot_that_is_silent_or_stopped():
    side = PersonSide(human_hand(), lrp_hand_master())
    flexions, others = np.zeros(14), np.zeros(19)
    assert not side.step(0.0, flexions, others, HERE)[0].any() and "not answered" in side.trouble
    torque = RobotMessage(np.full(14, 0.05), 1.0, True)
    side.receive(0.01, torque.vector())
    assert side.step(0.01, flexions, others, HERE)[0] == pytest.approx(0.05) and not side.trouble
    assert not side.step(0.01 + MAX_SILENCE + 1e-3, flexions, others, HERE)[0].any() and "silent" in side.trouble
    side.receive(0.1, torque._replace(is_running=False).vector())
    assert not side.step(0.1, flexions, others, HERE)[0].any() and "emergency stop" in side.trouble


def test_the_wrist_feels_the_robots_force_and_none_of_a_silent_robot():
    device = SimulatedWrist()
    side = PersonSide(human_hand(), lrp_hand_master(), wrist_device=device)
    flexions, others, force = np.zeros(14), np.zeros(19), np.array([0.2, 0, -0.3])
    side.receive(0.01, RobotMessage(np.zeros(14), 1.0, True, wrist_force=force).vector())
    felt = []
    for k in range(1, 60):
        timestamp = 0.01 + 2e-3 * k
        side.step(timestamp, flexions, others, HERE)
        felt.append(device.read(timestamp))
    fresh = int(MAX_SILENCE / 2e-3) - 1
    assert felt[fresh - 1] == pytest.approx([*force, 0, 0, 0])
    # The side that hears nothing takes the force away at once; the device's own watchdog is for that side's death.
    assert not np.any(felt[fresh + 1 :])
    assert side.step(0.2, flexions, others, HERE)[0] == pytest.approx(0)


def test_without_a_device_on_the_wrist_its_motion_exchanges_no_energy():
    side = PersonSide(human_hand(), lrp_hand_master())
    pushed = RobotMessage(np.zeros(14), 0.0, True, wrist_force=np.array([0, 0, -5.0]))
    for k in range(20):
        side.receive(2e-3 * k, pushed.vector())
        side.step(2e-3 * k, np.zeros(14), np.zeros(19), PalmPose(np.array([0, 0, 1e-3 * k]), np.eye(3)))
    assert side.port.tank.net == 0


@pytest.mark.parametrize("delay_steps", [1, 10, 50])
def test_a_force_on_the_wrist_leaves_the_network_passive(delay_steps):
    """A wrist that is pushed into springy walls and pulled out again, over a late network."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        side = PersonSide(human_hand(), lrp_hand_master(), wrist_device=SimulatedWrist())
        far, stiffness = MotionPort(np.zeros(17)), rng.uniform(100, 1000)
        angular, phases = 2 * np.pi * rng.uniform(0.3, 2, 3), rng.uniform(0, 6, 3)
        # Their accelerations stay below those that the port allows for.
        sizes = 0.9 * LARGEST_WRIST_ACCELERATION / angular**2 * rng.uniform(0.1, 0.5)
        there, back = [], []
        for k in range(500):
            timestamp = 2e-3 * k
            place = sizes * (np.sin(angular * timestamp + phases) - np.sin(phases))
            if k >= delay_steps:
                side.receive(timestamp, back[k - delay_steps].vector())
            _, message = side.step(timestamp, np.zeros(14), np.zeros(19), PalmPose(place, np.eye(3)))
            there.append(message)
            heard = there[max(k - delay_steps, 0)]
            force = stiffness * np.maximum(far.angles[14:], 0)
            far.step(np.append(np.zeros(14), heard.wrist.origin), np.append(np.zeros(14), force), heard.sent)
            back.append(RobotMessage(np.zeros(14), far.tank.sent, True, wrist_force=-force))
            assert side.port.tank.net + far.tank.net >= -1e-3


def test_joints_without_a_channel_come_from_the_others():
    person = human_hand()
    side = PersonSide(person, lrp_hand_master())
    _, message = side.step(0.0, np.full(14, 0.3), np.full(19, 0.1), HERE)
    is_abduction = ["abduction" in joint for joint in person.joints]
    assert message.angles == pytest.approx(np.where(is_abduction, 0.1, 0.3))


def test_the_robots_side_follows_and_reports_a_stop(workplace):
    robot = NullFollower(workplace.follower.joints, workplace.follower.links)
    side = RobotSide(robot, workplace.retargeting, workplace.feedback)
    assert side.step(0.0, None).is_running and side.port is None
    axes = np.asarray(workplace.retargeting.calibration.axes)
    message = PersonMessage(workplace.open, PalmPose(np.ones(3), axes), 0.0)
    assert not side.step(0.01, message).torques.any()
    state = robot.read(0.02)
    # The person's axes stand as the palm's do in its own frame, so the palm's axes are the world's.
    assert state.palm.rotation == pytest.approx(np.eye(3)) and state.palm.origin == pytest.approx(1)
    thumb, index = (workplace.follower.links.index(f"{name} distal") for name in ("thumb", "index"))
    normals = np.array([[0, 0, 1.0], [0, 0, -1]])
    points = np.array([[0, -0.08, 0.09], [0, -0.08, 0.13]]) + 1
    robot.contacts = FollowerContacts(points, normals, 2 * normals, np.array([thumb, index]))
    torques = side.step(0.03, message).torques
    names = workplace.glove_model.joints
    assert torques[names.index("index MP")] > 0.01 and torques[names.index("ring MP")] == 0
    robot.contacts = robot.contacts._replace(forces=np.array([[0.5, 0, 2.0], [0, 0.25, -1]]))
    assert not side.step(0.035, message).wrist_force.any()
    with_wrist = RobotSide(robot, workplace.retargeting, workplace.feedback, has_wrist=True)
    # The hand feels the opposite of what it exerts on the object.
    assert with_wrist.step(0.037, message).wrist_force == pytest.approx([-0.5, -0.25, -1])
    robot.stop("button")
    assert not side.step(0.04, message).is_running


@pytest.mark.slow
def test_a_trial_is_repeatable_passive_and_lifts_the_object(workplace):
    heights = []

    def watch(timestamp, follower, torques):
        heights.append(workplace.task.tip(follower)[2])

    network = NetworkModel(0.02, 0.01, 0.05)
    results = [run_trial(workplace, 3, network=network, on_step=watch) for _ in range(2)]
    assert results[0] == results[1]
    assert max(heights) > 0.05 and results[0].peak_force > 0.5
    assert results[0].least_net_energy >= -1e-3


@pytest.mark.slow
def test_a_force_on_the_wrist_lowers_the_peak_of_the_contact_force(workplace):
    felt = {"has_feedback": True, "has_wrist": True}
    with_forces = [run_trial(workplace, seed, **felt).peak_force for seed in range(6)]
    without = [run_trial(workplace, seed, has_feedback=False).peak_force for seed in range(6)]
    assert np.mean(with_forces) < 0.7 * np.mean(without)


@pytest.mark.slow
def test_without_feedback_no_energy_is_exchanged(workplace):
    result = run_trial(workplace, 3, has_feedback=False)
    assert result.person_energy == result.robot_energy == 0


def test_a_robot_in_this_process_has_a_clock_of_its_own(workplace):
    workplace.reset()
    network, rng = NetworkModel(), np.random.default_rng(0)
    side = RobotSide(workplace.follower, workplace.retargeting, workplace.feedback)
    robot = RobotHere(side, SimulatedLink(network, rng), SimulatedLink(network, rng), 19)
    near = PersonSide(workplace.person, workplace.glove_model)
    wrist = PalmPose(workplace.task.home.origin, workplace.wrist_rotation)
    for k in range(30):
        now = 70_000 + 0.004 * k
        _, message = near.step(now, workplace.open[workplace.channels], workplace.open, wrist)
        robot.exchange(now, message, near)
    assert not near.trouble and workplace.follower.data.time == pytest.approx(29 * 0.004, abs=0.003)


def test_the_loop_of_a_glove_writes_a_law_at_each_step_and_ends():
    model, person = lrp_hand_master(), human_hand()
    near, laws = PersonSide(person, model), []

    class Robot(RobotConnection):
        def exchange(self, timestamp, message, near):
            if len(laws) >= 3:
                near.receive(timestamp, RobotMessage(np.full(14, 0.02), 1.0, True).vector())

        def close(self):
            pass

    angles = np.full(14, 0.1)
    state = GloveState(0.0, 3, 1, 0.0, 0.0, angles, angles, angles)
    loop = (near, Robot(), lambda: state, laws.append, lambda _: HERE, np.zeros(19), 500.0)
    times = run_person(*loop, lambda _: len(laws) < 8)
    assert times.summary()["turns"] == 8 and not laws[0].is_valid and laws[-1].is_valid
    assert laws[-1].torques == pytest.approx(0.02) and not laws[-1].derivative.any()
