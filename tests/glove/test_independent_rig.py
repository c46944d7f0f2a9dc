"""A device written from the page alone judges the host: torque ends in time after any fault, whatever delays do."""

import struct

import pytest

from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.host import LinkState
from tests.glove import independent_device as page
from tests.glove.independent_rig import FAULTS, IN_TIME, WAYS, Rig, one_fault
from tests.glove.test_frames import vectors
from tests.turns import in_turns

QUICK = ("the host dies", "the encoders fall silent")
NAMES = in_turns(FAULTS, QUICK)
BY_WAY = in_turns(WAYS, ["both"])


@pytest.mark.parametrize("direction", BY_WAY)
@pytest.mark.parametrize("name", NAMES)
def test_torque_ends_in_time_whatever_fails_while_delays_drift(name, direction):
    drifts = (-0.005, 0.0, 0.005)
    spent = [one_fault(name, direction, k, drift, 0.4 + 0.3 * k + 0.0017 * k) for k, drift in enumerate(drifts)]
    assert max(spent) <= IN_TIME, [f"{1e3 * duration:.0f} ms" for duration in spent]


@pytest.mark.parametrize("direction", BY_WAY)
@pytest.mark.parametrize(("rate", "most"), [(0.05, 0.28), (0.2, 0.14), (1.0, 0.1)])
def test_a_delay_that_grows_ends_torque_within_the_pages_bound(rate, most, direction):
    """And within what is measured here, where the round trip is 12 ms before."""
    spent = []
    for seed in range(3):
        world = Rig(seed, (-0.005, 0.0, 0.005)[seed]).armed()
        world.run(0.3 + 0.0013 * seed)
        since = world.now
        directions = ("outward", "inward") if direction == "both" else (direction,)
        for name in directions:
            growth = rate / len(directions)
            getattr(world, name).waits = lambda at, since=since, growth=growth: growth * (at - since)
        while world.host.guard.state == GuardState.ARMED:
            world.run(0.001)
        spent.append(world.now - since)
    assert max(spent) <= min(most, 0.013 / rate + 0.1), [f"{1e3 * duration:.0f} ms" for duration in spent]


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_nothing_flows_again_before_a_person_arms_it(name):
    world = Rig(5, 0.001).armed()
    FAULTS[name](world)
    world.run(0.3)
    since = world.now
    for direction in (world.outward, world.inward):
        direction.is_cut, direction.spoils, direction.waits = False, 0.0, lambda timestamp: 0.0
    world.is_plugged = world.is_host_alive = world.says_angles = True
    world.jump, world.is_law_old, world.law = None, False, lambda angles: 0.25 * (angles - 0.2)
    world.device.is_pressed = False
    world.run(1.0)
    assert world.zero_after(since) == 0.0
    assert world.host.state == LinkState.LINKED and world.host.guard.state != GuardState.ARMED
    world.host.arm(world.now)
    world.run(0.6)
    assert min(world.device.counts) > 3000


def test_the_pages_vectors_by_its_own_arithmetic():
    for frame, line in vectors():
        data = page.unstuffed(line[:-1])
        assert page.stuffed(data) == line and page.check_sum(data[:40]) == int.from_bytes(data[40:], "little")
        head, flags, sequence, clock, echo, *values = struct.unpack("<BBHII14h", data[:40])
        assert (head, flags & 15, flags >> 4) == (32 + frame.kind, int(frame.flags), frame.cause)
        assert (sequence, clock, echo, tuple(values)) == (frame.sequence, frame.clock, frame.echo, frame.values)
    assert page.check_sum(b"123456789") == 0xCBF43926
