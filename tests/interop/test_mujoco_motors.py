"""Largest joint torques of other programs' hands, by MuJoCo's own torques at the ends of the motors' ranges."""

from pathlib import Path

import numpy as np
import pytest

from jaxgrasp.interop import hand_from_mujoco, hand_from_urdf
from tests.interop.test_mujoco_hand import allegro, model_of

mujoco = pytest.importorskip("mujoco")

ARM = """
<mujoco>
  <worldbody>
    <body name="palm">
      <geom type="sphere" size="0.03"/>
      <body><joint name="servo" axis="0 1 0"/><geom type="sphere" size="0.01"/>
      <body><joint name="geared" axis="0 1 0"/><geom type="sphere" size="0.01"/>
      <body><joint name="plain" axis="0 1 0"/><geom type="sphere" size="0.01"/>
      <body><joint name="capped" axis="0 1 0" actuatorfrcrange="-0.4 0.6"/><geom type="sphere" size="0.01"/>
      <body><joint name="pair" axis="0 1 0"/><geom type="sphere" size="0.01"/>
      <body><joint name="one way" axis="0 1 0"/><geom type="sphere" size="0.01"/>
      <body><joint name="unlimited" axis="0 1 0"/><geom type="sphere" size="0.01"/>
      <body><joint name="idle" axis="0 1 0"/><geom type="sphere" size="0.01"/>
      <body><joint name="near" axis="0 1 0"/><geom type="sphere" size="0.01"/>
      <body><joint name="far" type="slide" axis="0 0 1"/><geom type="sphere" size="0.01"/>
      </body></body></body></body></body></body></body></body></body></body>
    </body>
  </worldbody>
  <tendon><fixed name="both"><joint joint="near" coef="0.02"/><joint joint="far" coef="-3"/></fixed></tendon>
  <actuator>
    <position joint="servo" kp="3" forcerange="-2 1.5"/>
    <motor joint="geared" gear="-10" forcerange="-0.2 0.3"/>
    <motor joint="plain" gear="4" ctrlrange="-1 2"/>
    <motor joint="capped" forcerange="-5 5"/>
    <motor joint="pair" gear="2" forcerange="0 0.7"/>
    <motor joint="pair" gear="-2" forcerange="0 0.5"/>
    <motor joint="one way" forcerange="0 1"/>
    <motor joint="unlimited"/>
    <motor tendon="both" forcerange="-10 10"/>
  </actuator>
</mujoco>
"""


def test_the_largest_torques_are_those_that_mujoco_exerts_at_full_drive():
    """Both ways, each motor driven hard alone and all together: the smaller of the largest torques of either way."""
    model = mujoco.MjModel.from_xml_string(ARM)
    hand = hand_from_mujoco(model, "palm")
    names, largest = hand.hand.joints, np.asarray(hand.hand.torque_max)
    data = mujoco.MjData(model)
    reached = []
    for drive in [*(1e6 * np.eye(model.nu)), *(-1e6 * np.eye(model.nu))]:
        data.ctrl[:] = drive
        mujoco.mj_forward(model, data)
        reached.append(data.qfrc_actuator[hand.velocities].copy())
    low, high = -np.min(reached, 0), np.max(reached, 0)
    unknown = np.isin(names, ["one way", "unlimited", "idle"])
    np.testing.assert_allclose(largest[~unknown], np.minimum(low, high)[~unknown])
    np.testing.assert_array_equal(largest[unknown], np.inf)
    by_hand = {"servo": 1.5, "geared": 2, "plain": 4, "capped": 0.4, "pair": 1.0, "near": 0.2, "far": 30}
    np.testing.assert_allclose([largest[names.index(name)] for name in by_hand], list(by_hand.values()))


def test_known_hands_have_the_torques_that_their_files_say():
    shadow = hand_from_mujoco(*model_of("shadow")[:2]).hand
    torques = dict(zip(shadow.joints, np.asarray(shadow.torque_max), strict=True))
    assert torques["robot0:FFJ2"] == 0.9 and torques["robot0:THJ4"] == 2.3722
    # The last joints of the four fingers have no motor: a tendon couples them to the ones before.
    assert [name for name, torque in torques.items() if np.isinf(torque)] == [f"robot0:{f}FJ0" for f in "FMRL"]
    # Servos without a limit of their force.
    assert hand_from_mujoco(*model_of("adroit")[:2]).hand.torque_max is None
    np.testing.assert_array_equal(hand_from_urdf(allegro(), "palm_link").hand.torque_max, 15)


def test_a_urdfs_effort_of_zero_says_nothing(tmp_path: Path):
    path = tmp_path / "hand.urdf"
    link = '<link name="{}"><collision><geometry><box size="0.02 0.02 0.04"/></geometry></collision></link>'
    joint = (
        '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="1" effort="{3}" velocity="1"/></joint>'
    )
    parts = [link.format(name) for name in "abc"] + [joint.format("p", "a", "b", 0), joint.format("q", "b", "c", 0.7)]
    path.write_text(f'<robot name="small">{"".join(parts)}</robot>')
    np.testing.assert_array_equal(hand_from_urdf(path, "a").hand.torque_max, [np.inf, 0.7])
