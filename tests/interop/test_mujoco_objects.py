"""Laws of objects of several parts and of soft bodies: MuJoCo's forces balance the wrench on all parts together."""

import re
import warnings

import numpy as np
import pytest

from jaxgrasp.interop import from_mujoco

mujoco = pytest.importorskip("mujoco")

STAND = """
<mujoco>
  <option cone="{cone}" impratio="10" tolerance="1e-12" iterations="200" noslip_iterations="5"/>
  <worldbody>
    <geom type="plane" size="5 5 .1" condim="4"/>
    <body name="box" pos="0 0 .2"><freejoint/>
      <geom name="box" type="box" size=".2 .2 .2" mass="10" condim="4"/>
      {parts}
    </body>
  </worldbody>
</mujoco>
"""
LID = (
    '<body name="lid" pos=".1 0 .3"><joint axis="0 0 1" damping="1"/>'
    '<geom type="box" size=".05 .05 .05" mass="2"/>{}</body>'
)
SAGGING = (
    '<body name="arm" pos=".2 0 .25"><joint axis="0 1 0" stiffness="20" damping="3"/>'
    '<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1.5"/>'
    '<body name="weight" pos=".3 0 0"><joint type="ball" damping=".06"/>'
    '<geom type="sphere" pos="0 0 -.05" size=".03" mass=".7"/></body></body>'
)
DRAWER = (
    '<body name="drawer" pos="0 .2 .0"><joint type="slide" axis="0 1 0" damping="20" frictionloss="5"/>'
    '<geom type="box" size=".1 .05 .1" mass="3"/></body>'
)
TOUCHING = (
    '<body name="left" pos="-.06 0 .3"><joint type="slide" axis="1 0 0" stiffness="300" springref=".05" damping="20"/>'
    '<geom name="left" type="box" size=".05 .05 .05" mass="1"/></body>'
    '<body name="right" pos=".06 0 .3"><joint type="slide" axis="1 0 0" stiffness="300" springref="-.05" damping="20"/>'
    '<geom name="right" type="sphere" size=".05" mass="1"/></body>'
)
FLOATING = (
    '<body name="balloon" gravcomp=".8" pos=".1 0 .3"><joint damping="1"/>'
    '<geom type="sphere" size=".05" mass="2"/></body>'
)
PARTS = {
    "a lid": (LID.format(""), 12.0),
    "a lid with a knob": (LID.format('<body pos="0 0 .1"><geom type="sphere" size=".02" mass=".3"/></body>'), 12.3),
    "an arm that sags": (SAGGING, 12.2),
    "a drawer": (DRAWER, 13.0),
    "parts that press on one another": (TOUCHING, 12.0),
    "gravity compensation": (FLOATING, 10.4),
}
"""Parts on the box, and the mass that gravity pulls at [kg]."""


def stand(parts, cone="elliptic", seconds=4.0):
    model = mujoco.MjModel.from_xml_string(STAND.format(cone=cone, parts=parts))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    mujoco.mj_forward(model, data)
    return model, data


def wrench_of(read) -> np.ndarray:
    torques = np.cross(read.grasp.points, read.forces) + read.moments
    return np.concatenate([read.forces.sum(0), torques.sum(0)])


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
@pytest.mark.parametrize("name", PARTS)
def test_the_contacts_of_a_resting_object_carry_all_its_parts(name, cone):
    parts, mass = PARTS[name]
    model, data = stand(parts, cone)
    assert np.abs(data.qvel).max() < 1e-3
    read = from_mujoco(model, data, "box")
    np.testing.assert_allclose(read.wrench[:3], [0, 0, 9.81 * mass], atol=1e-9)
    np.testing.assert_allclose(wrench_of(read), read.wrench, atol=1e-3 * 9.81 * mass)
    assert set(read.links) == {"world"}


def test_contacts_between_parts_of_the_object_do_not_count():
    model, data = stand(TOUCHING)
    inside = {model.geom(name).id for name in ("left", "right")}
    between = [i for i in range(data.ncon) if {*data.contact[i].geom.tolist()} == inside]
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, between[0], force)
    assert force[0] > 1.0
    assert len(from_mujoco(model, data, "box").links) == data.ncon - len(between)


@pytest.mark.parametrize("name", ["a lid with a knob", "an arm that sags"])
def test_moving_parts_are_named_and_accelerating_balances_them(name):
    model, data = stand(PARTS[name][0], seconds=0.5)
    data.qvel[6:] += 3.0
    data.qvel[:6] += [0.1, 0.2, 0, 0.1, 0.3, 0.5]
    mujoco.mj_forward(model, data)
    with pytest.warns(
        UserWarning, match="parts of body 'box' move in their joints: inertial loads of '(lid|arm', 'weight)'"
    ):
        still = from_mujoco(model, data, "box")
    read = from_mujoco(model, data, "box", accelerating=True)
    np.testing.assert_allclose(wrench_of(read), read.wrench, atol=1e-8 * np.abs(read.forces).sum())
    assert np.abs(read.wrench - still.wrench).max() > 1.0


FLEX = """
<mujoco>
  <option timestep="0.001" {option}/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <flexcomp name="pad" type="grid" count="4 4 3" spacing=".03 .03 .03" pos="0 0 .05" dim="3" mass=".2" radius="0.003">
      <edge equality="true"/><contact selfcollide="none" condim="{condim}" {contact}/>
    </flexcomp>
    <body name="obj" pos="0 0 .12"><freejoint/><geom type="box" size=".03 .03 .03" mass=".3"/></body>
  </worldbody>
</mujoco>
"""
SOFT = """
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="obj" pos="0 0 .05"><freejoint/><geom type="box" size=".03 .03 .01" mass=".3"/>
      <flexcomp name="pad" type="grid" count="4 4 3" spacing=".02 .02 .02" pos="0 0 -.03" dim="3" mass=".2"
        radius="0.001">
        <pin gridrange="0 0 2 3 3 2"/><edge equality="true"/><contact selfcollide="none" condim="3"/>
      </flexcomp>
    </body>
  </worldbody>
</mujoco>
"""


def settled(text, steps):
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("condim", [3, 4])
def test_contacts_with_a_flex_carry_a_body(condim):
    model, data = settled(FLEX.format(option="", contact="", condim=condim), 500)
    read = from_mujoco(model, data, "obj")
    assert len(read.links) >= 4 and set(read.links) == {"pad"}
    assert (read.grasp.normals[:, 2] > 0.5).all()
    np.testing.assert_allclose(read.forces[:, 2].sum(), 0.3 * 9.81, rtol=1e-2)
    accelerating = from_mujoco(model, data, "obj", accelerating=True).wrench
    np.testing.assert_allclose(wrench_of(read), accelerating, atol=1e-8 * np.abs(read.forces).sum())
    assert (read.grasp.torsion is None) == (condim == 3)
    by_name = from_mujoco(model, data, "obj", hand="pad", squeeze="stiffness", stiffness={"pad": 10.0})
    np.testing.assert_allclose(by_name.grasp.squeeze, 10.0 * read.depths)
    np.testing.assert_array_equal(by_name.forces, read.forces)
    without = from_mujoco(model, data, "obj", exclude="pad")
    assert without.links == ()
    np.testing.assert_allclose(without.other_wrench, wrench_of(read), atol=1e-12)


def test_an_object_with_a_soft_part_is_carried_by_the_contacts_of_that_part():
    model, data = settled(SOFT, 1500)
    read = from_mujoco(model, data, "obj")
    assert len(read.links) >= 4 and set(read.links) == {"world"}
    assert all(contact.flex.max() == 0 for contact in data.contact)
    np.testing.assert_allclose(read.wrench[:3], [0, 0, 9.81 * model.body_mass.sum()], atol=1e-9)
    np.testing.assert_allclose(wrench_of(read), read.wrench, atol=1e-3)


def test_passive_contacts_are_named():
    text = SOFT.replace("<worldbody>", '<option integrator="discrete"/><worldbody>').replace(
        'condim="3"', 'passive="true"'
    )
    model, data = settled(text, 200)
    assert (data.contact.exclude == 4).all() and data.ncon
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        from_mujoco(model, data, "obj")
    contacts, load = [str(warning.message) for warning in caught]
    assert contacts.startswith("contacts with 'world' are left out: MuJoCo handles them as passive forces")
    assert load.startswith("body 'obj' is loaded by passive forces")


def test_a_sleeping_object_is_refused():
    text = STAND.format(cone="elliptic", parts="").replace(
        "/>\n  <worldbody>", '><flag sleep="enable"/></option><worldbody>', 1
    )
    model, data = settled(text, 2000)
    assert data.tree_asleep[0] >= 0 and data.ncon == 0
    with pytest.raises(ValueError, match="body 'box' sleeps"):
        from_mujoco(model, data, "box")


LOADED = """
<mujoco>
  <option {option}/>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="box" pos="0 0 .2">{joints}<geom type="box" size=".2 .2 .2" mass="10"/><site name="top"/>
      <body name="lid" pos=".1 0 .3"><joint name="hinge" axis="0 0 1" damping="1"/>
        <geom type="box" size=".05 .05 .05" mass="2"/></body>
    </body>
  </worldbody>
  <equality>{equality}</equality>
  <actuator>{actuator}</actuator>
</mujoco>
"""
SLIDES = (
    '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
    '<joint type="slide" axis="0 0 1" stiffness="9" springref="1"/><joint type="ball"/>'
)
THRUST = '<general site="top" gear="0 0 1 0 0 0" ctrlrange="-9 9"/>'


@pytest.mark.parametrize(
    ("change", "source"),
    [
        ({"equality": '<weld name="clamp" body1="box"/>'}, r"constraints other than contacts \('clamp'\)"),
        ({"equality": '<connect body1="lid" anchor="0 0 0"/>'}, r"constraints other than contacts \('equality 0'\)"),
        ({"actuator": THRUST}, "actuators"),
        ({"option": 'density="1.2" wind="3 0 0"'}, "passive forces"),
        ({"applied": 20.0}, "qfrc_applied"),
        ({"joints": SLIDES}, "passive forces"),
        ({}, None),
        ({"equality": '<joint joint1="hinge"/>'}, None),
    ],
    ids=str,
)
def test_other_loads_on_the_object_are_named(change, source):
    change = dict(change)
    applied = change.pop("applied", 0.0)
    defaults = {"option": "", "joints": "<freejoint/>", "equality": "", "actuator": ""}
    model = mujoco.MjModel.from_xml_string(LOADED.format(**defaults | change))
    data = mujoco.MjData(model)
    data.ctrl[:] = 5.0
    data.qfrc_applied[2] = applied
    mujoco.mj_step(model, data, 300)
    # Turned, where the axes of the free joint's torque and the world's differ.
    data.qpos[3:7] = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])
    mujoco.mj_forward(model, data)
    assert data.ncon
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        from_mujoco(model, data, "box", accelerating=True)
    messages = [str(warning.message) for warning in caught]
    assert len(messages) == (source is not None)
    if source:
        assert re.fullmatch(f"body 'box' is loaded by {source}.*, which is not in the wrench", messages[0])
