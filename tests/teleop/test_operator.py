"""The simulated person's arm: it yields to a force on the wrist by its stiffness, and to none not at all."""

import numpy as np
import pytest

from jaxgrasp.teleop.operator import PersonModel, SimulatedOperator
from jaxgrasp.teleop.tasks import make_task

STEP = 4e-3
STILL = PersonModel(tremor=0.0)


def person(seed: int = 0) -> SimulatedOperator:
    angles = np.zeros(4)
    return SimulatedOperator(make_task("peg"), angles, angles + 1, [0, 1, 2], np.random.default_rng(seed), model=STILL)


def places(operator, force, count=400):
    return np.array([operator.step(STEP * k, np.zeros(3), None, force)[1].origin for k in range(count)])


@pytest.mark.parametrize("force", [[0.0, 0, -1], [2.0, -0.5, 0.3]])
def test_the_arm_comes_to_rest_where_its_stiffness_bears_the_force(force):
    shift = places(person(), np.array(force)) - places(person(), None)
    assert shift[-1] == pytest.approx(np.array(force) / STILL.arm_stiffness, rel=0.02)


def test_the_arm_gains_no_energy_from_its_own_swing():
    """After the force has gone, kinetic and elastic energy only fall."""
    operator = person()
    shift = places(operator, np.array([0, 0, -3.0]), 50) - places(person(), None, 50)
    free = [shift[-2], shift[-1]]
    for k in range(50, 300):
        origin = operator.step(STEP * k, np.zeros(3), None, np.zeros(3))[1].origin
        free.append(origin - operator._place[:3])
    speeds, middles = np.diff(free, axis=0) / STEP, (np.array(free)[1:] + np.array(free)[:-1]) / 2
    energy = 0.5 * STILL.arm_mass * np.sum(speeds**2, -1) + 0.5 * STILL.arm_stiffness * np.sum(middles**2, -1)
    assert energy[-1] < 0.05 * energy[0] and energy[:50].min() > energy[-50:].max()


def test_no_force_moves_the_hand_as_planned():
    assert np.array_equal(places(person(), np.zeros(3)), places(person(), None))
