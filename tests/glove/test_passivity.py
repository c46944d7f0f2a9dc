"""Energy out against energy in: springs that answer late are damped before they shake, and end where that fails."""

from collections import deque

import numpy as np
import pytest

from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.monitors import CREDIT, MAX_CREDIT, MAX_DEFICIT, REFILL, PassivityWatch
from jaxgrasp.glove.simulated.simulated_glove import Fingers
from tests.glove.virtual import SENSORS, World

MODEL = lrp_hand_master()
LIMIT = MODEL.limits[0]
WEAK = Fingers(stiffness=0.3, damping=0.003)
LOOSE = Fingers(stiffness=0.1, damping=0.002)


class LateSpring(World):
    """A hand in a spring whose torque answers angles of a while ago, with the true energy that its joints gave it."""

    def __init__(self, stiffness: float, late: float, fingers: Fingers, *, watched: bool = True):
        super().__init__()
        glove = self.simulation.glove
        glove._fingers = fingers
        self.stiffness = stiffness
        self.given = np.zeros(14)
        self.angles: list[float] = []
        step = glove.step

        def stepped(timestamp: float, dt: float, clock: int) -> None:
            before = glove.angles.copy()
            step(timestamp, dt, clock)
            self.given -= glove.tensions * SENSORS.gauges.arm * (glove.angles - before)
            self.angles.append(float(glove.angles[3]))

        glove.step = stepped
        if not watched:
            self.host._passivity.damp = lambda torques: torques
            self.host._passivity.update = lambda at, angles: ""
        self.bend(0.6)
        self.run(0.5)
        send, past = self.host.send, deque()

        def sent(timestamp, requested, measured_at, slope=None):
            past.append((timestamp, requested))
            while len(past) > 1 and past[1][0] <= timestamp - late:
                past.popleft()
            return send(timestamp, past[0][1], measured_at, slope)

        self.host.send = sent
        self.given[:] = 0
        self.host.arm(self.now)

    def allowed(self, seconds: float) -> float:
        """Return the energy that a joint may give in a time [J]."""
        return (CREDIT + MAX_DEFICIT + REFILL * seconds) * LIMIT


@pytest.mark.slow
def test_a_late_spring_shakes_without_it_and_less_with_it():
    spans, given_torques = [], []
    for watched in (False, True):
        world = LateSpring(0.25, 0.03, WEAK, watched=watched)
        world.run(5.0)
        assert world.host.guard.state == GuardState.ARMED, "damping is enough"
        spans.append(np.ptp(world.angles[-1000:]))
        given_torques.append(world.given[3])
    assert spans[0] > 0.2 and given_torques[0] > 0.15
    assert spans[1] < 0.75 * spans[0] and given_torques[1] < 0.6 * given_torques[0]


@pytest.mark.slow
@pytest.mark.parametrize(("late", "seconds"), [(0.0, 3.0), (0.03, 6.0)])
def test_what_damping_does_not_hold_ends(late, seconds):
    """The stop is judged by the energy that the simulated joints truly gave."""
    free = LateSpring(0.25, late, LOOSE, watched=False)
    free.run(seconds)
    assert np.max(free.given) > 1.3 * free.allowed(seconds)
    world = LateSpring(0.25, late, LOOSE)
    world.run(seconds)
    assert world.host.guard.state == GuardState.LATCHED and "more energy than it took" in world.host.guard.cause
    assert np.max(world.given) < 1.1 * world.allowed(seconds) and not any(world.device.counts)


@pytest.mark.slow
@pytest.mark.parametrize("hertz", [1.0, 2.0])
def test_no_hand_that_opens_and_closes_is_held_back(hertz):
    world = World().armed()
    ends = (0.3, 0.9)
    for k in range(int(3 * hertz)):
        world.bend(ends[k % 2], lasts=0.5 / hertz)
        world.run(0.5 / hertz)
        np.testing.assert_array_equal(world.host._passivity.damp(np.full(14, 0.1)), 0.1)
    assert world.host.guard.state == GuardState.ARMED


def test_what_was_wound_up_before_may_unwind():
    """Armed on bent fingers, which then open: that energy comes from before."""
    world = World().armed(0.9)
    world.bend(0.0)
    world.run(1.0)
    np.testing.assert_array_equal(world.host._passivity.damp(np.full(14, 0.1)), 0.1)
    assert world.host.guard.state == GuardState.ARMED


def test_energy_is_torque_times_angle_within_its_bounds():
    rng = np.random.default_rng(0)
    watch, expected = PassivityWatch(MODEL), np.full(14, CREDIT * LIMIT)
    angles, torques = np.zeros(14), np.zeros(14)
    watch.update(0.0, angles)
    for k in range(1, 400):
        turned = rng.uniform(-0.05, 0.05, 14)
        angles = angles + turned
        watch.update(0.01 * k, angles)
        expected = np.minimum(expected + torques * turned + REFILL * LIMIT * 0.01, MAX_CREDIT * LIMIT)
        np.testing.assert_allclose(watch.energy, expected, atol=1e-12)
        torques = rng.uniform(0, LIMIT, 14)
        watch.commanded(0.01 * k, torques)


def test_it_damps_against_the_speed_and_passes_on_what_is_no_torque():
    watch = PassivityWatch(MODEL)
    watch.update(0.0, np.zeros(14))
    watch.commanded(0.0, np.full(14, LIMIT))
    for k in range(1, 30):
        fault = watch.update(0.01 * k, np.full(14, -0.02 * k))
    assert (watch.energy < 0).all() and fault == ""
    torques = np.full(14, 0.1)
    assert np.all(watch.damp(torques) < 0)
    for bad in (None, "torque", [1.0], np.full(14, np.nan), [[0], [0, 0]], ["0.1"] * 14, [1j] * 14):
        assert watch.damp(bad) is bad or np.all(np.isnan(watch.damp(bad)))
    for k in range(30, 60):
        fault = fault or watch.update(0.01 * k, np.full(14, -0.02 * k))
    assert "thumb MP gives the hand more energy than it took" in fault
    watch.reset()
    assert watch.damp(torques) is torques
