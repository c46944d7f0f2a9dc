"""Forces back: the shares are the closed form's, balance the wrench, and the torques are the Jacobian's."""

import numpy as np
import pytest

from jaxgrasp import Grasp, closed_form
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.hand import joint_torques, pose_hand
from jaxgrasp.model.hand import Pose, Posture
from jaxgrasp.teleop.feedback import ForceFeedback, shared_forces
from jaxgrasp.teleop.follower import FollowerContacts, FollowerState, PalmPose
from jaxgrasp.teleop.trial import FORCE_SCALE


def random_grasp(seed, n=6, absent=2):
    rng = np.random.default_rng(seed)
    arms, normals = rng.normal(size=(2, n, 3)) * 0.05
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    squeeze = rng.uniform(0.5, 5, n)
    squeeze[:absent] = 0
    return arms, normals, squeeze, rng.normal(size=6) * [1, 1, 1, 0.05, 0.05, 0.05]


@pytest.mark.parametrize("seed", range(4))
def test_shares_are_those_of_the_closed_form(seed):
    arms, normals, squeeze, wrench = random_grasp(seed)
    forces = shared_forces(arms, normals, squeeze, wrench)
    solution = closed_form(Grasp(arms, normals, np.ones(6), squeeze), wrench)
    assert forces == pytest.approx(np.asarray(solution.forces), abs=1e-9)
    balance = np.concatenate([forces.sum(0), np.cross(arms, forces).sum(0)])
    assert balance == pytest.approx(wrench, abs=1e-9)
    assert np.all(forces[squeeze == 0] == 0)


def test_two_contacts_cannot_turn_about_their_line():
    arms = np.array([[0.03, 0, 0], [-0.03, 0, 0]])
    forces = shared_forces(arms, -arms / 0.03, np.full(2, 4.0), np.array([0, 0, 2.0, 0.5, 0, 0]))
    # The torque about the line is left out, all else is balanced.
    assert forces == pytest.approx(np.array([[-4.0, 0, 1], [4, 0, 1]]), abs=1e-9)


def state_of(feedback, rng, count=7):
    links = rng.integers(0, len(feedback._link_of_robot), count)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    forces = normals * rng.uniform(0.2, 2, (count, 1)) + 0.1 * rng.normal(size=(count, 3))
    contacts = FollowerContacts(0.1 * rng.normal(size=(count, 3)), normals, forces, links)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    palm = PalmPose(rng.normal(size=3), axes * np.linalg.det(axes))
    return FollowerState(0.0, np.zeros(1), palm, contacts, 0.1 * rng.normal(size=3), "")


@pytest.mark.parametrize("seed", range(3))
def test_torques_are_those_of_the_packages_jacobian(workplace, seed):
    rng = np.random.default_rng(seed)
    feedback = workplace.feedback
    state, angles = state_of(feedback, rng), workplace.open + 0.3 * (workplace.closed - workplace.open)
    loads = feedback.loads(state)
    points, forces = feedback.forces(loads, angles)
    person = workplace.person
    frames = pose_hand(person, Posture(Pose(np.zeros(3), np.eye(3)), angles))
    expected = FORCE_SCALE * feedback.model.resisting(
        person.joints, np.asarray(joint_torques(person, frames, points, forces))
    )
    assert feedback.torques(state, angles) == pytest.approx(np.clip(expected, 0, 0.12), abs=1e-9)
    assert forces.sum(0) == pytest.approx(loads.wrench[:3], abs=1e-9)


def test_what_touches_nothing_gives_no_torque(workplace):
    state = state_of(workplace.feedback, np.random.default_rng(0))._replace(contacts=FollowerContacts.none())
    assert np.all(workplace.feedback.torques(state, workplace.open) == 0)


def test_turning_the_robot_and_all_it_touches_changes_nothing(workplace):
    rng = np.random.default_rng(5)
    feedback, state = workplace.feedback, state_of(workplace.feedback, rng)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    points, normals, forces, links = state.contacts
    turned = FollowerContacts(points @ turn.T + 1, normals @ turn.T, forces @ turn.T, links)
    palm = PalmPose(turn @ state.palm.origin + 1, turn @ state.palm.rotation)
    other = state._replace(contacts=turned, palm=palm, object_centre=turn @ state.object_centre + 1)
    assert feedback.torques(other, workplace.open) == pytest.approx(feedback.torques(state, workplace.open), abs=1e-12)


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan])
def test_a_scale_must_be_positive(workplace, scale):
    with pytest.raises(ValueError, match="scale is"):
        ForceFeedback(workplace.person, lrp_hand_master(), workplace.follower.hand, np.eye(3), scale)
