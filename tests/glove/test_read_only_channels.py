"""Channels without a motor: they are read, asked for nothing, and spoil no other channel's torque."""

import math

import numpy as np
import pytest

from jaxgrasp.glove.guard import Guard, GuardState, holding_time
from jaxgrasp.glove.host import GloveHost
from jaxgrasp.glove.model import GloveModel, load_glove
from jaxgrasp.glove.monitors import PassivityWatch
from jaxgrasp.glove.sensors import nominal_sensors
from jaxgrasp.glove.simulated.simulation import MemoryLine

MIXED = GloveModel("mixed", ("index MP", "index PIP", "middle MP"), (0.1, 0.0, 0.2), continuous=(0.05, 0.0, 0.1))
FILE = 'name = "a"\njoints = ["index MP", "index PIP"]\nlimits = [0.1, 0]\ncontinuous = [0.05, 0]\n'
ALONE = GloveModel("alone", ("index MP", "middle MP"), (0.1, 0.2), continuous=(0.05, 0.1))


@pytest.mark.parametrize("projection", ["clip", "scale"])
def test_the_others_are_as_without_it(projection):
    guards = Guard(MIXED, projection=projection, ramp=0.1), Guard(ALONE, projection=projection, ramp=0.1)
    for guard in guards:
        guard.arm(0.0)
    rng = np.random.default_rng(0)
    for k in range(4_000):
        timestamp = 0.01 * k
        torques = rng.uniform(-0.1, 0.5, 3)
        mixed, alone = guards[0].step(timestamp, torques, timestamp), guards[1].step(timestamp, torques[::2], timestamp)
        for name in ("counts", "torques", "assisting", "beyond", "held_back"):
            values = getattr(mixed, name)
            np.testing.assert_array_equal(values[::2], getattr(alone, name))
            assert values[1] == 0, "what it cannot give is not cut"
    assert mixed.state == GuardState.ARMED and alone.torques[0] < 0.1, "the motors have warmed"
    guards[0].step(50.0, np.array([0.1, math.nan, 0.1]), 50.0)
    assert guards[0].state == GuardState.LATCHED, "it must be asked for a number all the same"


def test_energy_and_holding_time_are_those_of_the_others():
    watches = PassivityWatch(MIXED), PassivityWatch(ALONE)
    rng = np.random.default_rng(1)
    for k in range(200):
        angles, torques = rng.uniform(0, 1, 3), np.array([0.1, 0.0, 0.2])
        faults = watches[0].update(0.01 * k, angles), watches[1].update(0.01 * k, angles[::2])
        assert faults[0] == faults[1]
        damped = watches[0].damp(torques)
        np.testing.assert_array_equal(damped[::2], watches[1].damp(torques[::2]))
        assert damped[1] == 0
        watches[0].commanded(0.01 * k, torques)
        watches[1].commanded(0.01 * k, torques[::2])
    torques = np.array([0.08, 0.3, 0.15])
    assert holding_time(MIXED, torques) == holding_time(ALONE, torques[::2]) < math.inf


def test_a_file_and_its_faults(tmp_path):
    path = tmp_path / "glove.toml"
    path.write_text(FILE)
    model = load_glove(path)
    assert model.is_resisted == (True, False) and model.max_counts[1] == 0
    assert np.all(nominal_sensors(model).gauges.arm > 0)
    for old, new, message in (
        ("[0.1, 0]", "[0.1, -1]", r"limits\[1\] is -1"),
        ("[0.05, 0]", "[0, 0]", r"continuous\[0\] is 0"),
        ("[0.05, 0]", "[0.05, 0.01]", r"continuous\[1\] is 0.01: expected at most its limit, 0"),
    ):
        path.write_text(FILE.replace(old, new))
        with pytest.raises(ValueError, match=message):
            load_glove(path)


def test_a_native_glove_has_a_motor_at_each_of_fourteen_channels():
    for model, message in (
        (MIXED, "the model's limit of index PIP is 0: expected a motor at every channel"),
        (GloveModel("many", tuple(map(str, range(15))), (0.1,) * 15), "the model has 15 channels: expected at most 14"),
    ):
        with pytest.raises(ValueError, match=message):
            GloveHost(model, nominal_sensors(model), lambda: MemoryLine(9600), Guard(model))
