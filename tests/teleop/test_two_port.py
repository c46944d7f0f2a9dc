"""A network with delay, jitter and loss gives out no more energy than came in at both of its ports."""

import numpy as np
import pytest

from benchmarks.network_runs import STEP, play
from jaxgrasp.glove.passivity import INITIAL_ENERGY, EnergyTank, MotionPort, TorquePort
from jaxgrasp.teleop.network import NetworkModel, SimulatedLink

LEAST = -1e-3
"""Net energy that a run may not fall below [J]."""


@pytest.mark.parametrize("seed", range(20))
def test_net_energy_stays_above_a_millijoule_of_loss(seed):
    _, least = play(seed)
    assert least >= LEAST


def test_without_control_the_same_runs_give_out_energy():
    assert min(play(seed, is_controlled=False)[1] for seed in range(20)) < 20 * LEAST


@pytest.mark.slow
def test_net_energy_of_ten_thousand_random_runs():
    assert min(play(seed, steps=250)[1] for seed in range(10_000)) >= LEAST


@pytest.mark.parametrize("speed", [0.2, 1.0, 3.0])
def test_stiffness_at_zero_delay_is_within_a_tenth(speed):
    stiffness, near, far = 0.4, TorquePort(), MotionPort(np.zeros(2))
    torques, sent = np.zeros(2), 0.0
    for k in range(int(0.3 / speed / STEP)):
        angles = np.full(2, speed * STEP * (k + 1))
        torques = near.step(angles, stiffness * far.angles, sent)
        far.step(angles, stiffness * far.angles, near.tank.sent)
        sent = far.tank.sent
    # At rest the desired angles have caught up as far as there is energy.
    for _ in range(50):
        torques = near.step(angles, stiffness * far.angles, sent)
        far.step(angles, stiffness * far.angles, near.tank.sent)
    assert torques == pytest.approx(stiffness * angles, rel=0.1)


def test_lost_totals_lose_no_energy():
    tank, other = EnergyTank(0.0, 0.0), EnergyTank(0.0, 0.0)
    for k in range(10):
        tank.add(1e-3)
        if k in (3, 9):
            other.receive(tank.sent)
    other.receive(tank.sent / 2)
    other.receive(np.nan)
    assert other.level == pytest.approx(10e-3) and tank.level == pytest.approx(0)


def test_a_reserve_lets_tremor_cancel_at_its_own_port():
    tank = EnergyTank()
    for _ in range(1000):
        tank.add(1e-4)
        tank.add(-1e-4)
    assert tank.sent == 0 and tank.level == pytest.approx(INITIAL_ENERGY)


def test_motion_that_was_held_back_is_made_up_for():
    port = MotionPort(np.zeros(1), initial=0.0, reserve=0.0)
    assert port.step(np.ones(1), np.full(1, 0.1), 0.0) == pytest.approx(0)
    assert port.step(np.ones(1), np.full(1, 0.1), 0.05) == pytest.approx(0.5)
    assert port.step(np.ones(1), np.full(1, 0.1), 0.2) == pytest.approx(1)


@pytest.mark.parametrize("energy", [-1.0, np.nan, np.inf])
def test_tanks_refuse_what_is_no_energy(energy):
    with pytest.raises(ValueError, match="initial is"):
        EnergyTank(initial=energy)


@pytest.mark.parametrize("field", [{"delay": -1.0}, {"jitter": np.inf}, {"loss": 1.0}])
def test_networks_refuse_faults_that_there_are_none_of(field):
    with pytest.raises(ValueError, match=next(iter(field))):
        NetworkModel(**field)


def test_a_late_message_never_replaces_a_newer_one():
    link = SimulatedLink(NetworkModel(0.02, 0.05, 0.2), np.random.default_rng(0))
    newest = -1.0
    for k in range(500):
        link.send(k * STEP, np.array([k], float))
        values = link.receive(k * STEP)
        if values is not None:
            assert values[0] >= newest
            newest = values[0]
    assert newest > 450
