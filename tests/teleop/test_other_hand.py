"""Another hand than Shadow's: a model of our own with the names and the structure of Menagerie's Allegro hand."""

import numpy as np
import pytest

from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.hand import human_hand
from jaxgrasp.teleop import MujocoFollower, PalmPose, Retargeting, allegro_hand, robot_spec
from jaxgrasp.teleop.feedback import ForceFeedback

pytest.importorskip("mujoco")
HOME = PalmPose(np.array([0, 0, 0.5]), np.eye(3))
FINGERS = ("thumb", "index", "middle", "ring")


def chain(prefix, place, lengths, axis, turn=""):
    """Return a finger that points along z: a base that turns about z, and three joints about an axis."""
    parts = ["base", "proximal", "medial", "distal"]
    text, end = "", ""
    for k, (part, length) in enumerate(zip(parts, lengths, strict=True)):
        where = f'pos="{place}" {turn}' if k == 0 else f'pos="0 0 {lengths[k - 1]}"'
        about, span = ("0 0 1", "-0.4 0.4") if k == 0 else (axis, "-0.2 1.6")
        text += (
            f'<body name="{prefix}_{part}" {where}><joint name="{prefix}j{k}" axis="{about}" range="{span}"/>'
            f'<geom type="box" size="0.009 0.009 {length / 2}" pos="0 0 {length / 2}" mass="0.02"/>'
        )
        end += "</body>"
    tip = (
        f'<body name="{prefix}_tip"><geom type="capsule" size="0.01 0.008" pos="0 0 {lengths[-1]}" mass="0.01"/></body>'
    )
    return text + tip + end


MOTORS = "".join(f'<position joint="{finger}j{k}"/>' for finger in ("ff", "mf", "rf", "th") for k in range(4))
MODEL = f"""<mujoco><compiler angle="radian" autolimits="true"/>
<default><joint damping="0.1"/><position kp="5"/></default>
<worldbody><body name="palm"><geom type="box" size="0.015 0.05 0.04" pos="0 0 -0.04" mass="0.4"/>
{chain("ff", "0 0.04 0", (0.016, 0.054, 0.038, 0.03), "0 1 0")}
{chain("mf", "0 0 0", (0.016, 0.054, 0.038, 0.03), "0 1 0")}
{chain("rf", "0 -0.04 0", (0.016, 0.054, 0.038, 0.03), "0 1 0")}
{chain("th", "0.02 0.03 -0.05", (0.02, 0.04, 0.04, 0.03), "0 -1 0", 'euler="0 1.2 0"')}
</body></worldbody>
<actuator>{MOTORS}</actuator></mujoco>"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("hand") / "hand.xml"
    path.write_text(MODEL)
    model = allegro_hand(path)

    def add_ball(spec):
        body = spec.worldbody.add_body(name="ball", pos=[0, 0, 0.1])
        body.add_freejoint()
        body.add_geom(size=[0.02, 0, 0], mass=0.1)

    return MujocoFollower(robot_spec(model, HOME, add_ball), model, HOME, "ball")


def test_it_goes_where_it_is_told_with_limited_torques(robot):
    angles = np.array([0.3 if "j1" in joint or "j2" in joint else 0.0 for joint in robot.joints])
    largest = 0.0
    for k in range(500):
        robot.command(0.002 * k, angles, HOME)
        state = robot.read(0.002 * (k + 1))
        largest = max(largest, np.abs(robot.data.actuator_force[:16]).max())
    assert state.angles == pytest.approx(angles, abs=0.02)
    assert 0.5 < largest <= 0.7


def test_its_fingertips_are_retargeted_and_felt(robot):
    person = human_hand()
    retargeting = Retargeting(person, robot.hand, FINGERS)
    tips = {robot.links[k] for k in retargeting._robot_tips.links}
    assert tips == {f"{finger} distal" for finger in FINGERS}
    open_hand = np.array([0.6 if name == "thumb abduction" else 0.0 for name in person.joints])
    bent = open_hand + [0.5 if "MP" in name or "PIP" in name else 0.0 for name in person.joints]
    moved = []
    for angles in (open_hand, bent):
        retargeting.reset()
        for _ in range(60):
            posture = retargeting(angles)
        targets = np.asarray(retargeting.calibration.targets(retargeting.person_tips(angles)))
        moved.append(retargeting.robot_tips(posture))
        assert np.linalg.norm(moved[-1] - targets, axis=-1)[1:].max() < 0.02
    assert np.linalg.norm(moved[1] - moved[0], axis=-1)[1:].min() > 0.03
    feedback = ForceFeedback(person, lrp_hand_master(), robot.hand, np.asarray(retargeting.calibration.axes))
    assert not {f"{finger} distal" for finger in FINGERS} & set(feedback.left_out)
