"""Vibration through a teleoperation: from the contacts of a robot to the law of a glove, and to the page."""

import numpy as np
import pytest

from jaxgrasp.glove import GloveState, lrp_hand_master
from jaxgrasp.glove.substitution import FINGERS, Sensations, Substitution, SubstitutionLaw
from jaxgrasp.hand import human_hand
from jaxgrasp.teleop import FollowerContacts, NullFollower, PalmPose, PersonMessage, PersonSide, RobotMessage, RobotSide
from jaxgrasp.teleop.live import RobotConnection, run_person
from jaxgrasp.teleop.session import MAX_SILENCE, substitute_contacts

HERE = PalmPose(np.zeros(3), np.eye(3))
FELT = Sensations(np.array([0.1, 0.2, 0.3, 0.4, 0.5]), np.array([0, 34, 35, 36, 40.0]))


def test_messages_carry_sensations():
    message = RobotMessage(np.arange(14.0), 0.5, True, FELT)
    back = RobotMessage.of(message.vector(), 14)
    np.testing.assert_array_equal(back.sensations.vector(), FELT.vector())
    assert back.is_running and not RobotMessage(np.zeros(14), 0.0, True).sensations.vector().any()
    assert RobotMessage.of(message.vector()[:16], 14) is None


def test_the_persons_side_is_silent_where_the_robot_is():
    side = PersonSide(human_hand(), lrp_hand_master())
    step = (np.zeros(14), np.zeros(19), HERE)
    side.step(0.0, *step)
    assert not side.sensations.vector().any()
    message = RobotMessage(np.zeros(14), 0.0, True, FELT)
    side.receive(0.0, message.vector())
    side.step(0.01, *step)
    np.testing.assert_array_equal(side.sensations.amplitudes, FELT.amplitudes)
    side.step(0.01 + MAX_SILENCE, *step)
    assert not side.sensations.vector().any()
    side.receive(0.1, message._replace(is_running=False).vector())
    side.step(0.1, *step)
    assert not side.sensations.vector().any()


def test_contacts_of_a_robot_slip_by_finger():
    """Amplitudes of a finger that holds firmly, of two that near their cones, and of a palm, which has no channel."""
    links = np.array([FINGERS.index("thumb"), FINGERS.index("index"), FINGERS.index("ring"), -1])
    normals = np.tile([0.0, 0, 1], (4, 1))
    # Margins 1 - |f_t| / (0.5 f_n): 0.8, 0.15, -0.2, and one of the palm.
    forces = np.array([[0.1, 0, 1], [0, 0.85, 2], [0.6, 0, 1], [9, 0, 1]])
    contacts = FollowerContacts(np.zeros((4, 3)), normals, forces, np.arange(4))
    substitution = Substitution(SubstitutionLaw(friction=0.5, onset_amplitude=0.0))
    felt = substitute_contacts(substitution, 1.0, contacts, links)
    np.testing.assert_allclose(felt.amplitudes, [0, 0.5, 0, 1, 0], atol=1e-12)
    assert not substitute_contacts(substitution, 1.1, FollowerContacts.none(), links).vector().any()


def test_the_robots_side_tells_what_a_cut_torque_lacks(workplace):
    robot = NullFollower(workplace.follower.joints, workplace.follower.links)
    law = SubstitutionLaw(onset_amplitude=0.0, highest_temperature=40.0)
    side = RobotSide(robot, workplace.retargeting, workplace.feedback, substitution=Substitution(law))
    axes = np.asarray(workplace.retargeting.calibration.axes)
    message = PersonMessage(workplace.open, PalmPose(np.ones(3), axes), 0.0)
    side.step(0.01, message)
    thumb, index = (workplace.follower.links.index(f"{name} distal") for name in ("thumb", "index"))
    normals = np.array([[0, 0, 1.0], [0, 0, -1]])
    points = np.array([[0, -0.08, 0.09], [0, -0.08, 0.13]]) + 1
    for force, is_cut in ((0.2, False), (200.0, True)):
        robot.contacts = FollowerContacts(points, normals, force * normals, np.array([thumb, index]))
        for timestamp in (0.03, 0.04):
            answer = side.step(timestamp, message)
        assert (answer.sensations.amplitudes[FINGERS.index("index")] > 0.3) == is_cut
        assert not answer.sensations.amplitudes[2:].any() and answer.sensations.temperatures[1] > 34
    without = RobotSide(robot, workplace.retargeting, workplace.feedback)
    assert not without.step(0.05, message).sensations.vector().any()


def test_the_loop_of_a_glove_writes_sensations_with_its_law():
    model, person = lrp_hand_master(), human_hand()
    near, laws = PersonSide(person, model), []

    class Robot(RobotConnection):
        def exchange(self, timestamp, message, near):
            near.receive(timestamp, RobotMessage(np.zeros(14), 0.0, True, FELT).vector())

        def close(self):
            pass

    angles = np.full(14, 0.1)
    state = GloveState(0.0, 3, 1, 0.0, 0.0, angles, angles, angles)
    loop = (near, Robot(), lambda: state, laws.append, lambda _: HERE, np.zeros(19), 500.0)
    run_person(*loop, lambda _: len(laws) < 4)
    np.testing.assert_array_equal(laws[-1].sensations.vector(), FELT.vector())


def test_the_page_shows_each_fingers_amplitude():
    page = pytest.importorskip("jaxgrasp.view.teleop_page")
    html = page.sensations_html(FELT)
    for finger, amplitude in zip(FINGERS, FELT.amplitudes, strict=True):
        assert f'data-finger="{finger}"' in html and f"{100 * amplitude:.0f} %" in html
    assert html.count("&deg;C") == 4 and "40.0 &deg;C" in html
