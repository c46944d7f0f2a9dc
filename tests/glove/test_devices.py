"""Devices by name, and a user's own device in the place of the others."""

import re
import sys
from types import ModuleType

import numpy as np
import pytest

from jaxgrasp.glove import Capability, CoupledJoint, GloveDevice, GloveModel, lucidgloves, nominal_sensors
from jaxgrasp.glove.devices import READY, TWO_PORTS, device_baud, find_device_class, load_model, make_device
from jaxgrasp.glove.guard import Guard
from jaxgrasp.glove.loop.exchange import TorqueLaw
from jaxgrasp.glove.loop.rendering import IOController
from jaxgrasp.glove.model import load_glove, lrp_hand_master
from jaxgrasp.glove.monitors import TensionControl
from jaxgrasp.glove.other_devices.lucidgloves import LucidHost
from jaxgrasp.glove.simulated.simulation import HeldPeer, MemoryLine


class Buzzer(LucidHost):
    """A device of one's own."""

    capability = Capability("vibration", measures_torque=False, outlives_host=False)


@pytest.fixture
def own_module(monkeypatch):
    module = ModuleType("somebodys_glove")
    module.Buzzer, module.number, module.GloveModel = Buzzer, 3, GloveModel
    monkeypatch.setitem(sys.modules, "somebodys_glove", module)


def test_a_name_means_a_device(own_module):
    assert {name: find_device_class(name) for name in READY} == READY
    assert find_device_class("somebodys_glove:Buzzer") is Buzzer
    for kind in READY.values():
        assert issubclass(kind, GloveDevice)
        assert kind.capability.outlives_host == bool(kind.acceptance), "what outlives its host is armed by words"


def test_the_port_of_joints_is_given_where_it_is_used():
    model = lucidgloves()
    for device, port in (("doglove", None), ("opengloves", None), ("native", "there"), ("openxr", "there")):
        options = {"device": device} | ({} if port is None else {"joints_from": port})
        with pytest.raises(ValueError, match=f"joints_from is {port} for the device {device}: expected a port for dog"):
            make_device(options, model, nominal_sensors(model), lambda: MemoryLine(9600), Guard(model))


def test_ready_devices_fit_their_models():
    for name in READY:
        model, sensors = load_model({"device": name})
        options = {"device": name} | ({"joints_from": "nowhere"} if name in TWO_PORTS else {})
        device = make_device(options, model, sensors, lambda: MemoryLine(9600), Guard(model))
        assert type(device) is READY[name] and device.model is model and len(sensors.encoders.zero) == len(model.joints)
    assert [device_baud({"device": name}) for name in READY] == [115_200, 115_200, 3_000_000, 115_200, 115_200]
    assert device_baud({"device": "doglove", "baud": 57_600}) == 57_600


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "lucid",
            "expected native, lucidgloves, doglove, opengloves, openxr, or MODULE:CLASS of your own",
        ),
        ("", "device is ''"),
        ("no_such_module_here:Glove", "No module named 'no_such_module_here'"),
        ("somebodys_glove:Whistle", "has no attribute 'Whistle'"),
        ("somebodys_glove:number", "which is not a GloveDevice"),
        ("somebodys_glove:GloveModel", "which is not a GloveDevice"),
        (":Glove", "device is ':Glove'"),
    ],
)
def test_a_name_that_means_none(own_module, name, message):
    with pytest.raises(ValueError, match=message):
        find_device_class(name)


def test_a_device_of_ones_own_is_driven_like_the_others(own_module):
    model, line = lucidgloves(), MemoryLine(115_200)
    options = {"device": "somebodys_glove:Buzzer"}
    device = make_device(options, model, nominal_sensors(model), lambda: line, Guard(model, ramp=0.01))
    assert type(device) is Buzzer
    with pytest.raises(ValueError, match="control needs measured torques, and LucidGloves does not measure them"):
        IOController(device, HeldPeer(), control=TensionControl(5))
    controller = IOController(device, HeldPeer())
    for k in range(100):
        timestamp = 0.005 * k
        line.to_host += b"A0B0C2047D0E4095\n"
        controller.peer.latest_law = TorqueLaw(
            timestamp, True, np.zeros(5), np.array([0.0, 0.1, 0.1, 0, 0.1]), np.zeros((5, 5))
        )
        controller.step(timestamp)
        if k == 1:
            controller.arm(timestamp, device.acceptance)
    limits = [int(part) for part in re.split(b"[A-E]", bytes(line.to_device).splitlines()[-1])[1:]]
    np.testing.assert_allclose(limits, [0, 1000, 500, 0, 0], atol=1)
    state = controller.peer.state
    np.testing.assert_allclose(state.angles, np.array([0, 0, 2047 / 4095, 0, 1]) * model.spans)


def test_a_file_couples_joints(tmp_path):
    path = tmp_path / "glove.toml"
    path.write_text(
        'name = "two strings"\njoints = ["index MP", "middle MP"]\nlimits = 0.2\nspans = [1.5, 1.6]\n'
        '[coupled]\n"index PIP" = {follows = "index MP", ratio = 1.2}\n'
    )
    model = load_glove(path)
    assert model.spans == (1.5, 1.6) and model.coupled == (CoupledJoint("index PIP", "index MP", 1.2),)
    joints = ("thumb MP", "index MP", "index PIP", "middle MP")
    np.testing.assert_array_equal(model.transmission(joints), [[0, 1, 1.2, 0], [0, 0, 0, 1]])
    torques = np.array([[5.0, -0.1, -0.2, 0.3], [0.0, 1.0, 0, 0]])
    np.testing.assert_allclose(model.resisting(joints, torques), [[0.34, -0.3], [-1, 0]])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("spans = [1.5]", "spans has 1 entries: expected one for each of 2 joints"),
        ("spans = [1.5, -1]", r"spans\[1\] is -1.0: expected a positive number"),
        ("coupled = 3", "coupled is 3: expected a table of joints"),
        ('[coupled]\n"index PIP" = 1.2', r"coupled\['index PIP'\] is 1.2: expected {follows = JOINT, ratio = NUMBER}"),
        ('[coupled]\n"index PIP" = {follows = "index MP"}', "expected {follows = JOINT, ratio = NUMBER}"),
        ('[coupled]\n"index PIP" = {follows = "idex MP", ratio = 1}', "follows 'idex MP': did you mean 'index MP'"),
        ('[coupled]\n"index PIP" = {follows = "index MP", ratio = 0}', "has the ratio 0.0: expected a number that is"),
        (
            '[coupled]\n"middle MP" = {follows = "index MP", ratio = 1}',
            "coupled has 'middle MP', which is named already",
        ),
    ],
)
def test_a_file_that_couples_none(tmp_path, more, message):
    path = tmp_path / "glove.toml"
    path.write_text(f'name = "two strings"\njoints = ["index MP", "middle MP"]\nlimits = 0.2\n{more}\n')
    with pytest.raises(ValueError, match=message):
        load_glove(path)


def test_a_hand_without_a_coupled_joint():
    with pytest.raises(ValueError, match="the hand has no joint 'thumb IP', which LucidGloves couples"):
        lucidgloves().transmission([f"{finger} MP" for finger in ("thumb", "index", "middle", "ring", "little")])
    assert not lrp_hand_master().coupled
