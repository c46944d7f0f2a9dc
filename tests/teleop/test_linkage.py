"""A glove's own linkage as the person's hand: the robot follows its caps as it follows the fingertips under them."""

import numpy as np
import pytest

from jaxgrasp.glove.other_devices.doglove import doglove_linkage
from jaxgrasp.hand import linkage_angles
from jaxgrasp.teleop import Workplace
from jaxgrasp.teleop.trial import FORCE_SCALE
from tests.teleop.test_feedback import state_of
from tests.teleop.test_retarget import settled


@pytest.mark.slow
def test_the_robot_follows_caps_as_the_fingertips_under_them(workplace):
    worn = Workplace("peg", workplace.hand_model, doglove_linkage(), linkage=True)
    assert worn.person.joints == doglove_linkage().joints and len(worn.channels) == 21
    for closure in (0.15, 0.3, 0.45):
        angles = workplace.open + closure * (workplace.closed - workplace.open)
        caps = linkage_angles(worn.person, workplace.person, angles)
        np.testing.assert_allclose(
            worn.retargeting.person_tips(caps), workplace.retargeting.person_tips(angles), atol=1e-4
        )
        followed = worn.retargeting.robot_tips(settled(worn.retargeting, caps))
        expected = workplace.retargeting.robot_tips(settled(workplace.retargeting, angles))
        # A cap is wider than a fingertip: thumb and finger count as touching a little sooner.
        np.testing.assert_allclose(followed, expected, atol=4e-3)
    worn.reset()
    assert np.all(np.isfinite(worn.follower.read(0.0).angles))


@pytest.mark.slow
def test_forces_on_the_robots_fingertips_come_to_the_servos(workplace):
    """By virtual work at the caps; what the robot's other links feel has no cap, and is left out by name."""
    model = doglove_linkage()
    worn = Workplace("peg", workplace.hand_model, model, linkage=True)
    assert all("distal" not in name for name in worn.feedback.left_out) and worn.feedback.left_out
    caps = worn.open + 0.3 * (worn.closed - worn.open)
    state = state_of(worn.feedback, np.random.default_rng(0), count=12)
    loads = worn.feedback.loads(state)
    points, forces = worn.feedback.forces(loads, caps)
    torques, step = worn.feedback.torques_of(loads, caps), 1e-6
    assert np.abs(torques).max() > 1e-3
    for k in range(21):
        turned = step * (np.arange(21) == k)
        # Contact points move with the caps' centres, and by the turn of the cap's radius.
        ahead, behind = (worn.feedback.contact_points(loads.normals, caps + s * turned) for s in (1, -1))
        centres = (ahead - behind) / (2 * step)
        axis = worn.feedback._frames(caps)[3][k]
        is_moved = np.any(np.abs(centres) > 1e-9, axis=1)
        rolled = np.where(is_moved[:, None], np.cross(axis, worn.feedback._pads[1][:, None] * loads.normals), 0.0)
        work = np.sum(forces * (centres + rolled))
        assert torques[k] == pytest.approx(FORCE_SCALE * work, abs=1e-6), model.joints[k]
