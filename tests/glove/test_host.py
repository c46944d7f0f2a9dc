"""Host and device together: torque only while both are well, on a line that is as slow and as bad as it may be."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.host import GloveHost, LinkState
from jaxgrasp.glove.model import GloveModel
from jaxgrasp.glove.monitors import TensionWatch
from jaxgrasp.glove.protocol.device import Cause, DeviceState
from jaxgrasp.glove.protocol.frames import Kind
from jaxgrasp.glove.sensors import nominal_sensors
from tests.glove.virtual import MODEL, SENSORS, World
from tests.turns import later


def test_it_greets_arms_and_renders_a_spring():
    world = World().armed()
    held = np.array(world.device.counts) * MODEL.quantum
    angles = world.simulation.glove.angles
    np.testing.assert_allclose(held, 0.25 * (angles - 0.2), atol=2e-3)
    np.testing.assert_allclose(world.host.reading.angles, angles, atol=1e-3)
    np.testing.assert_allclose(world.host.reading.torques, held, atol=2e-4)
    assert 0 < world.now - world.host.reading.angles_at < 0.02
    assert world.line.far.max_waiting <= 2 * 46
    assert world.device.order.missing == world.device.order.stale == world.host.order.missing == 0
    assert world.host.counts.held_back == world.host.counts.cut == 0


def test_nothing_flows_unless_it_is_armed():
    world = World()
    world.bend(0.9)
    world.run(1.5)
    assert world.host.state == LinkState.LINKED and not any(counts.any() for _, counts in world.history)


@pytest.mark.parametrize("when", np.linspace(0, 0.02, 7))
def test_a_host_that_dies_leaves_no_torque(when):
    world = World().armed()
    world.run(when)
    world.is_host_alive = False
    died = world.now
    world.run(0.5)
    assert 0 < world.zero_after(died) <= 0.050
    assert world.device.cause.name == "WATCHDOG"


@pytest.mark.parametrize(
    ("order", "cause"),
    [
        ({"cut": 0.1}, "the device fell silent"),
        ({"fault": 1}, "the device latched"),
        ({"slack": 3}, "channel 3 pulls"),
        *later(({"cut": 0.6}, "the device fell silent"), ({"unplug": 0.3}, "the line is unplugged")),
    ],
)
def test_faults_zero_both_sides_in_time_and_stay_until_armed(order, cause):
    world = World().armed()
    world.simulation.obey(order, world.now)
    since = world.now
    world.run(1.2)
    assert world.zero_after(since) <= (0.3 if "slack" in order else 0.055)
    assert world.host.guard.state == GuardState.LATCHED and cause in world.host.guard.cause
    assert world.host.state == LinkState.LINKED, "it found its device again"
    assert not np.any(world.device.counts)
    world.simulation.obey({"slack": None}, world.now)
    world.host.arm(world.now)
    world.run(0.6)
    assert min(world.device.counts) > 3000


@pytest.mark.slow
def test_encoders_that_repeat_themselves_are_no_fault():
    """A resting hand does the same."""
    world = World().armed()
    world.simulation.obey({"stuck": True}, world.now)
    world.run(1.2)
    assert world.host.guard.state == GuardState.ARMED


@pytest.mark.parametrize("stiffness", [0.02, *later(0.06)])
def test_a_cable_that_comes_off_under_a_weak_torque_latches(stiffness):
    world = World()
    world.stiffness = stiffness
    world.bend(0.6)
    world.run(0.5)
    world.host.arm(world.now)
    world.run(1.0)
    assert world.host.guard.state == GuardState.ARMED and max(world.device.counts) < 4000
    world.simulation.obey({"slack": 3}, world.now)
    world.run(1.2)
    assert world.host.guard.state == GuardState.LATCHED and "its cable is slack" in world.host.guard.cause


@pytest.mark.parametrize("counts", [32767, -32768, 8000, -3000])
def test_encoders_that_jump_latch_before_their_angle_is_acted_on(counts):
    world = World().armed()
    held = np.array(world.device.counts)
    world.simulation.obey({"jump": counts}, world.now)
    since = world.now
    world.run(0.1)
    assert world.host.guard.state == GuardState.LATCHED
    assert "the encoder of thumb MP" in world.host.guard.cause
    assert world.zero_after(since) <= 0.055
    assert all(np.all(counts <= held + 1) for at, counts in world.history if at > since)


@pytest.mark.parametrize("seed", [0, *later(1, 2)])
def test_encoders_that_freeze_while_cables_move_latch(seed):
    """A person bends and stretches the fingers, and the cables' friction says so."""
    world = World(friction=True)
    world.host._watch = TensionWatch(14, relative=0.9)
    world.armed()
    world.simulation.obey({"stuck": True}, world.now)
    rng = np.random.default_rng(seed)
    for _ in range(4):
        world.bend(float(rng.uniform(0.3, 0.9)), lasts=0.2)
        world.run(0.4)
    assert (
        world.host.guard.state == GuardState.LATCHED and "stands still while its cable moves" in world.host.guard.cause
    )


@pytest.mark.parametrize("joint", [1, 3, *later(0, 4, 13)])
def test_an_encoder_that_freezes_under_steady_torque_latches_when_the_hand_opens(joint):
    """Nothing in its own channel tells: angle, command and tension stay as they were."""
    world = World().armed()
    world.simulation.glove.frozen = joint
    world.run(1.0)
    assert world.host.guard.state == GuardState.ARMED, world.host.guard.cause
    since = world.now
    world.bend(0.0, lasts=0.3)
    world.run(0.7)
    assert world.host.guard.state == GuardState.LATCHED, "the others have opened"
    assert f"the encoder of {MODEL.joints[joint]} stands still while" in world.host.guard.cause
    assert world.zero_after(since) <= 0.4


@pytest.mark.parametrize("frozen", [0, None])
def test_torque_ends_where_no_motion_at_all_is_measured_for_long(frozen):
    """A single encoder that froze, or a glove on a stand; another one is no fault."""
    world = World(**({"wander": 0.0} if frozen is None else {})).armed()
    world.simulation.glove.frozen = frozen
    since = world.now
    world.run(4.5)
    assert world.host.guard.state == GuardState.ARMED, world.host.guard.cause
    world.run(1.0)
    assert world.host.guard.state == GuardState.LATCHED
    assert "the encoder of thumb MP showed no motion for 5 s under 0.0" in world.host.guard.cause
    assert world.zero_after(since) <= 5.0 + 0.055


def test_a_hand_that_holds_for_long_is_no_fault():
    world = World().armed()
    world.run(7.0)
    assert world.host.guard.state == GuardState.ARMED, world.host.guard.cause


@pytest.mark.slow
@pytest.mark.parametrize("friction", [False, True])
def test_no_hand_that_moves_or_rests_is_a_fault(friction):
    world = World(friction=friction)
    world.host._watch = TensionWatch(14, relative=0.9)
    world.armed()
    rng = np.random.default_rng(5)
    for _ in range(8):
        world.bend(float(rng.uniform(0.0, 1.2)), lasts=float(rng.uniform(0.08, 0.5)))
        world.run(float(rng.uniform(0.3, 1.0)))
    world.run(3.0)
    assert world.host.guard.state == GuardState.ARMED, world.host.guard.cause


def test_encoders_that_fall_silent_latch():
    world = World().armed()
    world.simulation.glove.next_frame = lambda clock: world.device.status(clock)
    since = world.now
    world.run(0.4)
    assert world.zero_after(since) <= 0.055 and world.host.guard.cause == "the encoders fell silent"


def test_strain_gauges_that_fall_silent_latch():
    """Or a cable could come off and nobody would know."""
    world = World().armed()
    frame = world.simulation.glove.next_frame
    world.simulation.glove.next_frame = lambda clock: (
        reply if (reply := frame(clock)).kind != Kind.TENSIONS else frame(clock)
    )
    since = world.now
    world.run(0.5)
    assert world.zero_after(since) <= 0.2 and "strain gauges fell silent" in world.host.guard.cause
    with pytest.raises(ValueError, match="its strain gauges send no tensions"):
        world.host.arm(world.now)


def test_leaving_in_the_instant_of_a_command():
    """Two frames of one reading of the clock are two frames all the same."""
    world = World().armed()
    world.host.send(world.now, np.full(14, 0.1), world.now)
    world.host.close(world.now)
    world.is_host_alive, since = False, world.now
    world.run(0.3)
    assert world.zero_after(since) <= 0.02 and world.device.state.name == "IDLE"


def test_a_device_that_is_at_fault_is_not_armed():
    world = World()
    world.bend(0.6)
    world.run(0.5)
    world.simulation.obey({"fault": 1}, world.now)
    assert (world.device.state, world.device.cause) == (DeviceState.LATCHED, Cause.OWN)
    step = world.device.step
    world.device.step = lambda timestamp: (world.device.trip(Cause.OWN), step(timestamp))[1]
    world.host.arm(world.now)
    world.run(1.0)
    assert world.host.guard.state != GuardState.ARMED and not any(counts.any() for _, counts in world.history)


def test_the_emergency_stop_at_the_device():
    """The button ends torque within a millisecond, and none returns before it is released and the glove armed."""
    world = World().armed()
    world.simulation.obey({"press": True}, world.now)
    since = world.now
    world.run(0.3)
    assert world.zero_after(since) <= 0.001
    assert world.host.guard.state == GuardState.LATCHED
    assert world.host.guard.cause == "the device latched: its emergency stop was pressed"
    with pytest.raises(ValueError, match="its emergency stop is pressed"):
        world.host.arm(world.now)
    world.simulation.obey({"press": False}, world.now)
    world.run(0.1)
    assert not any(world.device.counts)
    world.host.arm(world.now)
    world.run(0.6)
    assert min(world.device.counts) > 3000


def test_a_pressed_stop_latches_a_host_that_is_not_armed():
    world = World()
    world.run(0.5)
    world.simulation.obey({"press": True}, world.now)
    world.run(0.1)
    assert world.host.guard.state == GuardState.LATCHED and "emergency stop" in world.host.guard.cause


@pytest.mark.parametrize("trouble", ["none", *later("late", "lost"), "spoilt"])
def test_the_emergency_stop_at_the_host(trouble):
    """It is said until the device says that it holds nothing for that, on a line that is late or loses the first."""
    world = World().armed()
    if trouble == "late":
        world.line.outward = lambda timestamp: 0.3
    elif trouble == "lost":
        world.simulation.obey({"cut": 0.2}, world.now)
    elif trouble == "spoilt":
        world.simulation.obey({"spoil": 0.7, "seed": 1}, world.now)
    world.host.stop(world.now)
    since = world.now
    world.run(1.5)
    assert world.zero_after(since) <= 0.055
    assert world.host.guard.state == GuardState.LATCHED and "emergency stop" in world.host.guard.cause
    assert (world.device.state, world.device.cause) == (DeviceState.LATCHED, Cause.STOPPED)
    assert not world.host._is_stopping
    commands = world.host.counts.commands
    world.run(0.1)
    assert world.host.counts.commands > commands, "and then it goes on listening"


def test_a_stop_before_any_link_is_kept():
    world = World()
    world.host.stop(world.now)
    assert world.host.guard.state == GuardState.LATCHED
    world.run(0.5)
    assert world.device.cause == Cause.STOPPED
    world.bend(0.6)
    world.host.arm(world.now)
    world.run(0.8)
    assert min(world.device.counts) > 3000


def test_an_echo_is_no_device():
    world = World()
    world.run(0.2)
    write = world.line.write
    world.line.write = lambda data: (world.line.to_host.extend(data), write(data))[1]
    world.bend(0.6)
    world.run(0.5)
    world.host.arm(world.now)
    world.run(0.5)
    assert world.host.guard.state == GuardState.ARMED and world.host.order.missing == 0


@pytest.mark.slow
@pytest.mark.parametrize("drift", [-0.005, 0.005])
def test_a_clock_that_is_off_by_half_a_per_cent(drift):
    world = World(drift=drift).armed()
    world.run(8.0)
    assert world.host.guard.state == GuardState.ARMED and 0 < world.now - world.host.reading.angles_at < 0.03


def test_a_slow_line_is_linked_and_holds_no_torque():
    """At 9,600 baud a frame takes 44 ms: angles are too old to act on."""
    world = World(baud=9600)
    world.run(2.0)
    assert world.host.state == LinkState.LINKED
    world.host.arm(world.now)
    world.run(2.0)
    assert not any(counts.any() for _, counts in world.history)


@pytest.mark.parametrize("stiffness", [np.nan, np.inf, -np.inf])
def test_a_bug_upstream_latches(stiffness):
    world = World().armed()
    world.stiffness, since = stiffness, world.now
    world.run(0.2)
    assert world.zero_after(since) <= 0.02 and "not finite" in world.host.guard.cause


def test_leaving_sends_zero():
    world = World().armed()
    world.host.close(world.now)
    world.is_host_alive, since = False, world.now
    world.run(0.3)
    assert world.zero_after(since) <= 0.012 and world.device.state.name == "IDLE"


def test_it_comes_back_within_two_seconds_of_its_port():
    world = World().armed()
    world.simulation.obey({"unplug": 3.0}, world.now)
    back = world.now + 3.0
    while world.host.state != LinkState.LINKED or world.now < back:
        world.run(0.01)
        assert world.now < back + 2
    assert world.host.counts.links == 2 and world.host.guard.state == GuardState.LATCHED


@pytest.mark.slow
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.floats(0, 0.4), st.integers(0, 10**6), st.sampled_from([57_600, 115_200, 921_600]))
def test_a_bad_line_breaks_no_law(share, seed, baud):
    """Bounds and rate at the device; and it is either armed with a living host, or zero."""
    world = World(baud=baud)
    world.bend(0.9)
    world.run(0.3)
    world.simulation.obey({"spoil": share, "seed": seed}, world.now)
    for _ in range(8):
        if world.host.state == LinkState.LINKED and world.now - world.host.reading.angles_at < 0.1:
            world.host.arm(world.now)
        world.run(0.25)
    before = np.zeros(14)
    for _, counts in world.history:
        assert np.all((counts >= 0) & (counts <= 11_999))
        assert np.all(counts - before <= 121)
        before = counts
    world.is_host_alive, since = False, world.now
    world.run(0.3)
    assert world.zero_after(since) <= 0.055 + 46 * 10 / baud


@pytest.mark.parametrize(
    "change, trouble",
    [
        ({"quantum": 2e-5}, "the device's torque per count is 100e-7 N.m: expected 200e-7"),
        ({"joints": ("a",), "limits": (0.12,)}, ""),
        ({"limits": (0.1,) * 14}, "the device allows 11999 counts: expected at most 10000"),
        ({"rate": 1.0}, "the device changes by 120 counts/ms: expected at most 1 N.m/s"),
    ],
)
def test_a_device_that_is_another_glove(change, trouble):
    model = GloveModel(**{"name": "other", "joints": MODEL.joints, "limits": MODEL.limits, **change})
    world = World()
    world.host = GloveHost(model, nominal_sensors(model), lambda: world.line, Guard(model))
    world.run(0.5)
    assert world.host.trouble == trouble or world.host.trouble.startswith(trouble)
    assert (world.host.state == LinkState.LINKED) == (not trouble)


def test_a_device_with_a_long_watchdog_is_refused():
    world = World()
    world.device._watchdog = 30_000
    world.run(0.5)
    assert world.host.trouble == "the device's watchdog is 30000 ms: expected 1 to 50"
    assert world.host.state == LinkState.GREETING


def test_arming_needs_a_link_and_angles():
    world = World()
    with pytest.raises(ValueError, match="cannot be armed: not opened yet"):
        world.host.arm(world.now)
    world.run(0.5)
    with pytest.raises(ValueError, match="encoders send no angles"):
        world.host.arm(world.now + 1)


@pytest.mark.parametrize(
    ("change", "trouble"),
    [
        (
            {"limits": (*(0.12,) * 3, 0.1, *(0.12,) * 10)},
            "the device allows 11999 counts at index PIP: expected at most 10000",
        ),
        (
            {"continuous": (0.12,) * 13 + (0.06,)},
            "the device allows 11999 counts continuously at little DIP: expected at most 5999",
        ),
        ({"continuous": (0.12,) * 14, "heating": 10.0}, "the device's motors warm in 30 s: expected 10"),
        ({"continuous": (0.12,) * 14, "heating": 31.0}, ""),
    ],
)
def test_a_device_with_other_bounds_of_a_joint_is_not_linked(change, trouble):
    model = replace(MODEL, **change)
    world = World()
    world.host = GloveHost(model, SENSORS, lambda: world.line, Guard(model))
    world.run(0.5)
    assert world.host.trouble.startswith(trouble) if trouble else world.host.trouble == ""
    assert (world.host.state == LinkState.LINKED) == (not trouble)


def test_a_device_that_says_no_bounds_is_not_linked():
    world = World()
    answer = world.device.answer
    world.device.answer = lambda timestamp: (
        reply if (reply := answer(timestamp)) and reply.kind == Kind.CAPABILITY else None
    )
    world.run(0.5)
    assert world.host.state == LinkState.GREETING and "has not reported all of its limits" in world.host.trouble


@pytest.mark.slow
def test_a_new_host_learns_how_warm_the_motors_are():
    """A new host reads the motors' thermal state from the device: both fade alike, and no cable seems broken."""
    model = replace(MODEL, continuous=(0.03,) * 14, heating=3.0)
    world = World(model)
    world.stiffness = 1.0
    world.armed()
    world.run(4.0)
    assert max(world.device.counts) < 3200, "faded"
    world.host = GloveHost(model, SENSORS, lambda: world.line, Guard(model, ramp=0.2))
    world.run(2.0)
    world.host.arm(world.now)
    world.run(1.0)
    assert world.host.guard.state == GuardState.ARMED
    commanded = np.array([torques for _, torques in world.host._watch._commands])[-1]
    np.testing.assert_allclose(np.array(world.device.counts) * MODEL.quantum, commanded, atol=4e-3)
