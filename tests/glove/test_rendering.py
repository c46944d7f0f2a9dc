"""The I/O side between two computers or processes: laws followed while they are fresh, zero as soon as they are not."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.loop.exchange import WORDS_SIZE, GloveState, Slot, TorqueLaw, pack_words, unpack_words
from jaxgrasp.glove.loop.peers import EngineLink, LinkPeer, SlotPeer, make_slots
from jaxgrasp.glove.loop.rendering import EDGES, IOController, TickTimes, TorqueRecord, loop_delay, turn_rate
from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.monitors import TensionControl, TensionWatch
from jaxgrasp.glove.network.link import NetworkLink
from jaxgrasp.glove.sensors import nominal_sensors
from jaxgrasp.glove.simulated.simulated_glove import Cable, Fingers
from jaxgrasp.glove.simulated.simulation import HeldPeer, VirtualGlove

MODEL = lrp_hand_master()
SPRING = 0.25


def law(timestamp: float, angles: np.ndarray, valid: bool = True) -> TorqueLaw:
    return TorqueLaw(timestamp, valid, angles, np.maximum(SPRING * (angles - 0.2), 0), SPRING * np.diag(angles > 0.2))


def rendered(seconds: float, *, period: float = 0.01, friction: bool = False, control: TensionControl | None = None):
    """Run a glove that renders a spring, whose law is computed once a ``period`` [s]; return it."""
    glove = VirtualGlove(MODEL, nominal_sensors(MODEL), friction=friction)
    glove.controller._control = control
    glove.order(bend=[0.6] * 14, lasts=0.3)
    go(glove, 0.5, period)
    glove.controller.arm(glove.time)
    go(glove, 0.5 + seconds, period)
    return glove


def go(glove: VirtualGlove, until: float, period: float = 0.01, valid: bool = True) -> None:
    while glove.time < until:
        glove.run(glove.time + period)
        if glove.peer.state is not None and np.all(np.isfinite(glove.peer.state.angles)):
            glove.peer.latest_law = law(glove.time, glove.peer.state.angles, valid)


def held(glove: VirtualGlove) -> np.ndarray:
    return np.array(glove.simulation.glove.device.counts) * MODEL.quantum


def test_it_follows_a_law_and_fresh_angles_between_two():
    glove = rendered(3.0, period=0.02)
    angles = glove.simulation.glove.angles
    np.testing.assert_allclose(held(glove), SPRING * (angles - 0.2), atol=1e-3)
    glove.order(bend=[0.75] * 14, lasts=0.05)
    old = glove.peer.latest_law
    glove.run(glove.time + 0.028)
    assert np.min(glove.simulation.glove.angles - old.angles) > 0.005, "they bend while the engine says nothing"
    assert np.min(held(glove) - old.torques) > 1e-4


@pytest.mark.parametrize("end", ["silence", "invalid", "nothing", "future"])
def test_a_law_that_may_not_be_acted_on_zeroes_and_latches(end):
    glove = rendered(1.0)
    assert held(glove).min() > 0.02
    since = glove.time
    if end == "nothing":
        glove.peer.latest_law = None
    elif end == "future":
        glove.peer.latest_law = law(glove.time + 1.0, glove.peer.state.angles)
    elif end == "invalid":
        go(glove, since + 0.05, valid=False)
    glove.run(since + 0.3)
    zero = next(t for t, counts, _ in glove.record if t > since and not counts.any())
    assert zero - since <= 0.055
    assert glove.controller.host.guard.state == GuardState.LATCHED and not held(glove).any()
    with pytest.raises(ValueError, match="the glove cannot be armed"):
        glove.controller.arm(glove.time)
    go(glove, glove.time + 0.3)
    assert not held(glove).any(), "never by itself"
    glove.controller.arm(glove.time)
    go(glove, glove.time + 0.5)
    assert held(glove).min() > 0.005


@pytest.mark.slow
def test_control_by_tension_overcomes_the_cables_friction():
    """Without it the capstan's share is missing or too much; with it the finger feels what was wanted, and no more."""
    off, on = (rendered(4.0, friction=True, control=tension_control) for tension_control in (None, TensionControl(14)))
    errors = []
    for glove in (off, on):
        rendered_torques = glove.simulation.glove.tensions * nominal_sensors(MODEL).gauges.arm
        expected = SPRING * (glove.simulation.glove.angles - 0.2)
        errors.append(np.abs(rendered_torques / expected - 1).max())
        assert glove.controller.host.guard.state == GuardState.ARMED
    assert errors[0] > 0.03 and errors[1] < 0.25 * errors[0]


def test_what_the_law_asks_what_the_glove_gives_and_how_long_it_is_cut():
    """0.49 N.m asked of a glove that has 0.12: the state says so for each joint, and the record for how long."""
    glove = VirtualGlove(MODEL, nominal_sensors(MODEL))
    asked = np.where(np.arange(14) == 3, 0.49, 0.05)

    def run(seconds: float) -> GloveState:
        end = glove.time + seconds
        while glove.time < end:
            glove.run(glove.time + 0.01)
            glove.peer.latest_law = TorqueLaw(glove.time, True, np.zeros(14), asked, np.zeros((14, 14)))
        return glove.peer.state

    glove.order(bend=[0.9] * 14, lasts=0.3)
    state = run(0.5)
    np.testing.assert_array_equal(state.asked, asked)
    assert not state.torques.any() and not state.cut_s.any() and state.guard == GuardState.DISARMED
    glove.controller.arm(glove.time)
    armed_at = glove.time
    state = run(4.0)
    np.testing.assert_array_equal(state.asked, asked)
    np.testing.assert_allclose(state.torques, np.where(asked > 0.12, 0.12, asked), atol=2e-5)
    assert state.cut_s[3] == pytest.approx(glove.time - armed_at, abs=0.1) and state.cut_s.sum() == state.cut_s[3]
    lines = TorqueRecord.lines(glove.controller.record.summary())
    assert len(lines) == 2 and re.search(r"index PIP .*asked 0.490 N.m, given 0.120 N.m, cut for [34]\.\d s", lines[1])
    glove.controller.host.stop(glove.time)
    state = run(0.1)
    assert not state.torques.any() and "emergency stop" in state.cause
    again = GloveState.of(state.vector(), 14)
    assert again.cause == state.cause
    np.testing.assert_array_equal(again.cut_s, state.cut_s)
    assert TorqueRecord.lines(TorqueRecord(MODEL.joints).summary()) == ["no torque was cut"]


@pytest.mark.parametrize("words", ["", "a cause", "\N{GREEK SMALL LETTER MU}" * 100, "x" * 119 + "\N{DEGREE SIGN}"])
def test_words_go_through_numbers(words):
    packed = pack_words(words)
    assert packed.shape == (WORDS_SIZE,) and np.all(np.isfinite(packed))
    unpacked = unpack_words(packed.astype(np.float32).astype(float))
    assert words.startswith(unpacked) and (unpacked == words or len(words.encode()) > WORDS_SIZE)
    assert unpack_words(np.full(WORDS_SIZE, np.nan)) == ""


def test_busy_times_are_told_in_the_median_and_at_99_per_cent():
    times = TickTimes(0.01)
    rng = np.random.default_rng(0)
    busy = rng.lognormal(np.log(2e-3), 0.4, 5000)
    for seconds in busy:
        times.add(0.0, float(seconds))
    summary = times.summary()
    assert summary["busy_median"] == pytest.approx(1e3 * np.median(busy), rel=0.025)
    assert summary["busy_99"] == pytest.approx(1e3 * np.quantile(busy, 0.99), rel=0.025)
    assert "busy for 2 ms in the median and 5" in TickTimes.text(summary) and " ms at 99 %" in TickTimes.text(summary)
    assert TickTimes(0.01).summary()["busy_99"] == 0.0
    for extreme in (0.0, 1e-9, 100.0):
        times.add(0.0, extreme)


def test_control_does_not_wind_up():
    """A slack cable asks for ever more; what the guard does not let through does not add up."""
    control = TensionControl(1, integral=5.0)
    requested, measured = np.array([0.1]), np.array([0.0])
    for _ in range(2000):
        request = control.request(requested, measured)
        control.update_integral(np.minimum(request, 0.12), requested, measured, 0.005)
    assert request[0] < 0.3
    for _ in range(60):
        request = control.request(requested, np.array([0.12]))
        control.update_integral(np.clip(request, 0, 0.12), requested, np.array([0.12]), 0.005)
    assert request[0] < 0.11


def test_capstan():
    """In steady motion tension grows by exp(mu wrap) where a finger pulls the cable out, and falls on its way back."""
    for speed in (0.05, -0.05):
        cable = Cable(2, wrap=2.0, sliding=0.1, resting=0.3)
        for _ in range(100):
            tensions = cable.pull(np.array([1.0, 3.0]), np.full(2, speed), 0.001)
        np.testing.assert_allclose(tensions, np.array([1.0, 3.0]) * np.exp(0.2 * np.sign(speed)), rtol=1e-6)
    np.testing.assert_array_equal(Cable(2).pull(np.zeros(2), np.ones(2), 1.0), 0)


def test_a_watch_forgives_delay_and_friction_but_not_for_long():
    watch = TensionWatch(1)
    for k in range(40):
        watch.commanded(0.005 * k, np.array([0.1 if k >= 20 else 0.0]))
        late = np.array([0.1 if k >= 30 else 0.0])
        assert watch.fault(0.005 * k, late * 1.3, np.array([False])) == ""
    broken = [watch.fault(0.2 + 0.01 * k, np.zeros(1), np.array([False])) for k in range(13)]
    assert broken[:10] == [""] * 10 and "channel 0 pulls 0.000 N.m: commanded 0.100" in broken[12]
    watch.reset()
    watch.commanded(1.0, np.array([0.12]))
    assert watch.fault(2.0, np.array([0.05]), np.array([True])) == ""
    for k in range(20):
        fault = watch.fault(2.0 + 0.01 * k, np.array([np.nan]), np.array([False]))
    assert "nan" in fault


@pytest.mark.parametrize("command", [0.005, 0.012, 0.039])
def test_a_slack_cable_shows_at_weak_commands_too(command):
    """And friction, noise of the gauges or a late measurement do not look like one."""
    rng = np.random.default_rng(0)
    for pulls in (0.62, 1.0, 0.0):
        watch, fault = TensionWatch(2), ""
        for k in range(400):
            timestamp = 0.005 * k
            requested = np.full(2, command * min(1.0, timestamp / 0.2) * (1 + 0.5 * np.sin(20 * timestamp)))
            watch.commanded(timestamp, requested)
            measured = np.array([max(requested[0], 0), max(pulls * requested[1], 0)]) + rng.normal(0, 3e-4, 2)
            fault = fault or watch.fault(timestamp, measured, np.zeros(2, bool))
        assert ("channel 1 pulls" in fault and "its cable is slack" in fault) == (pulls == 0.0), pulls


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 50), st.data())
def test_slots_hold_the_latest_whole_value(tmp_path_factory, size, data):
    path = tmp_path_factory.mktemp("slot") / "s"
    writer = Slot(path, size, create=True)
    reader = Slot(path, size)
    assert reader.read() is None
    for value in data.draw(st.lists(st.floats(allow_nan=False), min_size=1, max_size=5)):
        writer.write(np.full(size, value))
        np.testing.assert_array_equal(reader.read(), value)
    last = reader.read()
    # Half a value is not seen, the one before is.
    writer._memory[15:16] = bytes([writer._memory[15] ^ 1])
    writer._memory[0:1] = bytes([writer._memory[0] ^ 3])
    np.testing.assert_array_equal(reader.read(), last)
    with pytest.raises(ValueError, match="bytes: expected"):
        Slot(path, size + 1)
    writer.close()
    reader.close()


def test_peers_by_slots_and_by_a_link(folder):
    angles, timestamp = np.linspace(0.1, 1.4, 14), 5.0
    given_law = law(timestamp, angles)
    state = GloveState(
        timestamp, int(LinkState.ARMED), int(GuardState.ARMED), 0.5, 4.99, angles, angles / 10, angles / 11
    )
    laws, states = make_slots(folder, 14)
    peer = SlotPeer(folder, 14)
    assert peer.law(timestamp) is None
    laws.write(given_law.vector())
    peer.publish(timestamp, state)
    for name, value in vars(given_law).items():
        np.testing.assert_array_equal(getattr(peer.law(timestamp), name), value)
    for name, value in vars(GloveState.of(states.read(), 14)).items():
        np.testing.assert_array_equal(value, getattr(state, name))
    peer.close()


def test_peers_by_a_link():
    """Times become ages and times again, on clocks that differ; a law that was old when it was sent stays so."""
    angles = np.linspace(0.1, 1.4, 14)
    link = NetworkLink("127.0.0.1", 0, TorqueLaw.size(14), listens=True, oldest=1.0)
    glove = LinkPeer(link, 14)
    engine = EngineLink(NetworkLink("127.0.0.1", link.port, GloveState.size(14), oldest=1.0), 14)
    for k in range(300):
        # The engine's clock is another, and the glove's is a large number.
        engine_time, timestamp = 77.0 + 0.001 * k, 1.0e7 + 0.001 * k
        state = GloveState(
            timestamp, int(LinkState.ARMED), int(GuardState.ARMED), 0.5, timestamp - 0.007, angles, angles, angles
        )
        glove.publish(timestamp, state)
        heard = engine.state(engine_time)
        if heard is not None:
            engine.write(engine_time, law(engine_time - 0.02, angles))
        law_heard = glove.law(timestamp)
    assert heard is not None and law_heard is not None and law_heard.is_valid
    np.testing.assert_allclose(law_heard.torques, law(0.0, angles).torques, rtol=1e-6)
    assert abs(timestamp - law_heard.computed_at - 0.02) < 0.01
    assert abs(engine_time - heard.angles_at - 0.007) < 0.01 and (heard.link, heard.guard) == (4, 1)
    np.testing.assert_allclose(heard.angles, angles, rtol=1e-6)
    glove.close()
    engine.close()


def test_an_engine_calls_again_when_its_glove_was_started_anew():
    first = NetworkLink("127.0.0.1", 0, TorqueLaw.size(14), listens=True, oldest=0.2)
    engine = EngineLink(NetworkLink("127.0.0.1", first.port, GloveState.size(14), oldest=0.2), 14)

    def talk(glove: LinkPeer, start: float, seconds: float) -> int:
        heard = 0
        for k in range(int(seconds / 0.005)):
            timestamp = start + 0.005 * k
            glove.publish(timestamp, GloveState(timestamp, 2, 0, 0.0, timestamp, *np.ones((3, 14))))
            state = engine.state(timestamp)
            heard += state is not None
            if state is not None:
                engine.write(timestamp, law(timestamp, state.angles))
            glove.law(timestamp)
        return heard

    assert talk(LinkPeer(first, 14), 0.0, 1.0) > 150
    first.close()
    again = NetworkLink("127.0.0.1", first.port, TorqueLaw.size(14), listens=True, oldest=0.2)
    assert talk(LinkPeer(again, 14), 1.0, 2.0) > 200
    again.close()
    engine.close()


def test_what_is_no_state():
    good = GloveState(1.0, 2, 0, 0.0, 1.0, *np.ones((3, 14))).vector()
    assert GloveState.of(good, 14) is not None
    for k, value in ((0, np.nan), (1, np.nan), (1, 7), (1, 1.5), (2, np.inf), (2, -1)):
        bad = good.copy()
        bad[k] = value
        assert GloveState.of(bad, 14) is None


@pytest.mark.parametrize("oldest", [0.0, -1.0, 1e9, np.inf, np.nan, "x"])
def test_a_law_may_not_be_followed_for_long(unchecked, oldest):
    host = VirtualGlove(MODEL, nominal_sensors(MODEL)).controller.host
    with pytest.raises(ValueError, match="oldest is .*: expected more than 0 and at most 0.05 s"):
        IOController(host, HeldPeer(), oldest=oldest)


def test_a_law_with_a_bad_number_is_not_valid():
    vector = law(1.0, np.ones(14)).vector()
    vector[100] = np.nan
    assert not TorqueLaw.of(vector, 14).is_valid


def test_tick_times():
    times = TickTimes(0.01)
    for late, busy in ((0.0, 0.001), (0.003, 0.001), (0.2, 0.0), (0.0, 0.02)):
        times.add(late, busy)
    summary = times.summary()
    assert (summary["turns"], summary["overruns"], summary["worst"]) == (4, 2, 200.0)
    assert sum(summary["late"]) == sum(summary["busy"]) == 4 and len(summary["late"]) == len(EDGES) + 1
    assert "4 turns, 50.0% overruns" in TickTimes.text(summary) and ">100 ms 25.0%" in TickTimes.text(summary)


def tremble(baud: int, stiffness: float) -> float:
    """Render a spring on a line; return the largest standard deviation of an angle once it has settled [rad]."""
    glove = VirtualGlove(MODEL, nominal_sensors(MODEL), baud=baud)
    slope = stiffness * np.eye(14)
    glove.order(bend=[0.6] * 14, lasts=0.3)
    while glove.time < 3.5:
        glove.run(glove.time + 0.01)
        state = glove.peer.state
        if state is not None and np.all(np.isfinite(state.angles)):
            torques = np.maximum(stiffness * (state.angles - 0.56), 0)
            glove.peer.latest_law = TorqueLaw(glove.time, True, state.angles, torques, slope)
        if glove.controller.host.guard.state != GuardState.ARMED and 0.45 < glove.time < 0.5:
            glove.controller.arm(glove.time)
    assert held(glove).min() > 0.005
    times, _, angles = (np.array(part) for part in zip(*glove.record, strict=True))
    return float(angles[times > 3.0].std(0).max())


@pytest.mark.parametrize("baud", [115_200, 460_800])
def test_springs_are_quiet_up_to_the_stiffness_that_the_delay_of_the_line_allows(baud):
    """K - J w^2 + j D w = -S exp(-j w T): the loop of a person with a glove, simulated frame by frame."""
    largest = Fingers().quiet_stiffness(loop_delay(baud, 100.0))
    assert tremble(baud, 0.9 * largest) < 5e-4
    assert tremble(baud, 2.0 * largest) > 5e-3


def test_the_quiet_stiffness_is_at_the_limit_of_stability():
    fingers = Fingers()
    assert fingers.quiet_stiffness(0.0) == np.inf
    before = np.inf
    for delay in (0.002, 0.005, 0.01, 0.02, 0.05):
        stiffness = fingers.quiet_stiffness(delay)
        assert 0 < stiffness < before
        # By delay differential equation, J q'' + D q' + K q + S q(t - T) = 0, in small steps
        step, amplitudes = 1e-5, []
        for factor in (0.95, 1.05):
            lag = round(delay / step)
            q = np.zeros(lag + 1 + int(60 * 2 * np.pi / 80 / step / 10))
            q[: lag + 1] = 1e-3
            speed = 0.0
            for k in range(lag, len(q) - 1):
                pull = -fingers.stiffness * q[k] - factor * stiffness * q[k - lag]
                speed = (speed + step * pull / fingers.inertia) / (1 + step * fingers.damping / fingers.inertia)
                q[k + 1] = q[k] + step * speed
            quarter = (len(q) - lag) // 4
            amplitudes.append((np.abs(q[lag + quarter : lag + 2 * quarter]).max(), np.abs(q[-quarter:]).max()))
        (first, later), (first_beyond, later_beyond) = amplitudes
        assert later < first and later_beyond > first_beyond
        before = stiffness


def test_turns_follow_the_line_within_bounds():
    assert turn_rate(9_600) == turn_rate(57_600) == 200.0 and turn_rate(3_000_000) == 500.0
    assert turn_rate(115_200) == 200.0 and loop_delay(460_800, 100.0) < loop_delay(115_200, 100.0)
