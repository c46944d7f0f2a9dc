"""Delays that grow where nobody sees them: torque ends in time all the same, and ages stay true."""

import numpy as np
import pytest

from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.host import LinkState
from jaxgrasp.glove.protocol.frames import PeerClock, RoundTrip
from tests.glove.virtual import World
from tests.turns import later

IN_TIME = 0.055
"""Torque after any fault [s]."""
WAYS = ["both", *later("outward", "inward")]


def growing(since: float, rate: float, most: float):
    return lambda timestamp: float(np.clip(rate * (timestamp - since), 0, most))


def delayed(direction: str, rate: float, most: float, **options) -> World:
    """Run armed for two seconds, then let a delay grow; return the world."""
    world = World(**options).armed()
    world.run(2.0)
    for side in ("outward", "inward") if direction == "both" else (direction,):
        setattr(world.line, side, growing(world.now, rate, most))
    return world


@pytest.mark.repeats
@pytest.mark.parametrize("direction", WAYS)
@pytest.mark.parametrize(("rate", "most"), [(0.1, 0.3), *later((0.165, 0.495), (0.005, 0.14)), (1.0, 0.5)])
def test_a_growing_delay_is_seen_and_ends_torque(direction, rate, most):
    world = delayed(direction, rate, most)
    since = world.now
    world.run(0.04 / rate + 0.3)
    assert world.host.guard.state == GuardState.LATCHED and world.host.guard.cause
    # Not before there is anything to see; a tenth of a second after the line is 25 ms late at most.
    elapsed_s = world.zero_after(since)
    assert 0.002 / rate < elapsed_s < 0.025 / rate + 0.1 + IN_TIME
    assert world.host.state >= LinkState.GREETING


@pytest.mark.repeats
@pytest.mark.parametrize("direction", WAYS)
@pytest.mark.parametrize("waits", [0.0, *later(0.004, 0.008, 0.012), 0.02, *later(0.1), 0.4])
def test_a_host_that_dies_leaves_no_torque_whatever_the_delay(direction, waits):
    world = delayed(direction, 0.1, waits)
    world.run(waits / 0.1)
    world.is_host_alive, died = False, world.now
    world.run(1.5)
    assert world.zero_after(died) <= IN_TIME


@pytest.mark.parametrize("waits", [0.1, 0.4])
def test_it_is_not_armed_over_a_line_that_is_late(waits):
    world = World()
    world.line.outward = lambda timestamp: waits
    world.bend(0.6)
    world.run(1.0)
    assert world.host.state == LinkState.LINKED
    world.host.arm(world.now)
    world.run(2.0)
    assert not any(counts.any() for _, counts in world.history)


RATES = [("both", 0.02), *later(("inward", 0.05), ("inward", 0.005), ("outward", 0.05))]


@pytest.mark.repeats
@pytest.mark.parametrize("drift", [-0.005, *later(0.0, 0.005)])
@pytest.mark.parametrize(("direction", "rate"), RATES)
def test_the_age_of_angles_is_right_while_they_are_used(direction, rate, drift):
    """Against the true time of each frame, which only the world knows."""
    world = World(drift=drift).armed()
    simulation = world.simulation
    sent: dict[int, float] = {}
    clock = simulation.clock
    simulation.clock = lambda timestamp: (sent.setdefault(clock(timestamp), timestamp), clock(timestamp))[1]
    world.run(8.0)
    setattr(world.line, "outward" if direction == "outward" else "inward", growing(world.now, rate, 0.2))
    if direction == "both":
        world.line.outward = world.line.inward
    wrong, ages = [], []
    sent_at = world.host._clock.sent_at

    def recorded_sent_at(ticks, arrived, trip):
        estimate = sent_at(ticks, arrived, trip)
        if world.host.guard.state == GuardState.ARMED:
            wrong.append(estimate - sent[ticks])
            ages.append(arrived - sent[ticks])
        return estimate

    world.host._clock.sent_at = recorded_sent_at
    world.run(0.03 / rate)
    assert world.host.guard.state == GuardState.LATCHED
    assert np.abs(wrong).max() <= 2e-3, "2 ms"
    assert direction == "outward" or np.max(ages) > 0.012, "and they did grow"


def test_a_short_delay_is_no_fault():
    world = World()
    world.line.inward = world.line.outward = lambda timestamp: 0.003
    world.armed()
    world.run(3.0)
    assert world.host.guard.state == GuardState.ARMED


def test_old_frames_arm_nothing():
    """All that a host ever said, byte for byte, a second time."""
    world = World()
    sent_data = []
    write = world.line.write
    world.line.write = lambda data: (sent_data.append(data), write(data))[1]
    world.armed()
    world.host.close(world.now)
    world.is_host_alive = False
    world.run(0.2)
    start = len(world.history)
    for data in sent_data:
        write(data)
        world.run(0.005)
    assert not any(counts.any() for _, counts in world.history[start:])


def test_a_clock_tells_drift_from_delay():
    rng = np.random.default_rng(0)
    clock, drift = PeerClock(), 0.004
    errors = []
    for k in range(6000):
        sent = 50.0 + 0.004 * k
        grown = max(0.0, 0.003 * (sent - 60.0))
        waits = 0.001 + rng.exponential(5e-4) + grown
        estimate = clock.sent_at(int((1 + drift) * sent * 1e6) % 2**32, sent + waits, 0.002 + waits)
        errors.append(estimate - sent - 0.001)
    assert np.abs(errors[1000:]).max() < 2e-3
    plain = np.array([max(0.0, 0.003 * (0.004 * k - 10)) for k in range(6000)])
    assert plain[-1] > 0.04, "by arrivals alone it would be off by this"


def test_a_round_trip_is_the_least_of_the_last_moments():
    round_trip = RoundTrip(0.1)
    assert round_trip.shortest(0.0) == np.inf
    rng, trips = np.random.default_rng(1), []
    for k in range(500):
        timestamp, trip = 0.01 * k, float(rng.exponential())
        trips.append((timestamp, trip))
        round_trip.add(timestamp, trip)
        assert round_trip.shortest(timestamp) == min(trip for at, trip in trips if at >= timestamp - 0.1)
    assert round_trip.shortest(timestamp + 1) == np.inf
