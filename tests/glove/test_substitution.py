"""From contacts to vibration: laws of the amplitude, 20 ms at most through the line, and silence after faults."""

import time

import numpy as np
import pytest

from jaxgrasp.glove import Guard, TorqueLaw, VirtualGlove
from jaxgrasp.glove.glove_device import LinkState
from jaxgrasp.glove.guard import GuardState
from jaxgrasp.glove.host import GloveHost
from jaxgrasp.glove.loop.rendering import IOController
from jaxgrasp.glove.protocol.device import MAX_AMPLITUDE
from jaxgrasp.glove.simulated.simulation import HeldPeer, Simulation
from jaxgrasp.glove.substitution import (
    Sensations,
    SensationSender,
    Substitution,
    SubstitutionLaw,
    finger_contacts,
    finger_saturation,
    slip_margins,
)
from tests.glove.virtual import MODEL, SENSORS, DelayedLine

Z = np.array([0.0, 0.0, 1.0])
FREE, NOTHING = np.full(5, np.inf), np.zeros(5)


@pytest.mark.parametrize("friction", [0.2, 0.5, 1.0])
def test_the_margin_is_one_along_the_normal_and_zero_on_the_cone(friction):
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    tangents = np.cross(normals, rng.normal(size=(50, 3)))
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    sizes = rng.uniform(0.1, 10, (50, 1))
    for share in (0.0, 0.3, 1.0, 2.0):
        margins = slip_margins(sizes * (normals + share * friction * tangents), normals, friction)
        np.testing.assert_allclose(margins, 1 - share, atol=1e-12)


def test_contacts_without_a_force_have_all_margin_and_those_that_only_slide_have_none():
    margins = slip_margins(np.array([[0, 0, 0], [1.0, 0, 0], [1.0, 0, -1]]), np.stack([Z] * 3), 0.5)
    assert list(margins) == [np.inf, -np.inf, -np.inf]


def test_a_fingers_contacts_count_together_and_the_palm_does_not():
    forces = np.array([[0, 0, 2.0], [0.5, 0, 0.0], [0, 0, 7.0], [3.0, 0, 4.0]])
    normal, margins = finger_contacts(forces, np.stack([Z] * 4), np.array([1, 1, -1, 3]), 0.5)
    assert list(normal) == [0, 2, 0, 4, 0]
    assert list(margins) == [np.inf, 0.5, np.inf, -0.5, np.inf]


def settled(margin: float, saturation: float = 0.0, law: SubstitutionLaw | None = None) -> float:
    """Return the amplitude of a finger that has touched for long."""
    substitution = Substitution(law)
    for timestamp in (0.0, 1000.0):
        sensations = substitution.step(timestamp, np.ones(5), np.full(5, margin), np.full(5, saturation))
    return float(sensations.amplitudes[2])


def test_the_amplitude_never_falls_as_a_cause_grows_and_is_within_bounds():
    by_margin = [settled(margin) for margin in np.linspace(1.5, -2, 40)]
    assert np.all(np.diff(by_margin) >= 0) and by_margin[0] == 0 and by_margin[-1] == 1
    assert settled(0.3) == 0 and settled(0.15) == pytest.approx(0.5) and settled(0.0) == 1 == settled(-np.inf)
    by_saturation = [settled(1.0, share) for share in np.linspace(0, 1.5, 20)]
    assert np.all(np.diff(by_saturation) >= 0) and by_saturation[-1] == 0.5
    assert settled(0.15, 1.0) == pytest.approx(0.5) and settled(0.0, 1.0) == 1, "no cause hides another"


def test_a_contact_begins_with_a_pulse_that_decays_once():
    substitution = Substitution(SubstitutionLaw(onset_decay=0.04))
    firm, times = np.array([0, 1.0, 0, 0, 0]), np.arange(0, 0.3, 0.005)
    pulse = np.array([substitution.step(t, firm, np.ones(5)).amplitudes for t in times])
    np.testing.assert_allclose(pulse[:, 1], 0.6 * np.exp(-times / 0.04), rtol=1e-12)
    assert not pulse[:, [0, 2, 3, 4]].any()
    # A force that trembles about the threshold begins no contact anew.
    for timestamp, force, amplitude in ((1.0, 0.04, 0.0), (1.1, 0.06, 0.0), (1.2, 0.02, 0.0), (1.3, 0.06, 0.6)):
        sensations = substitution.step(timestamp, force * (firm > 0), np.ones(5))
        assert sensations.amplitudes[1] == pytest.approx(amplitude, abs=2e-6)


def test_what_is_no_number_and_what_does_not_touch_is_silent():
    nan = np.full(5, np.nan)
    for normal, margins in ((nan, nan), (NOTHING, FREE), (NOTHING, -FREE)):
        assert normal.shape == margins.shape == (5,)
        sensations = Substitution().step(0.0, normal, margins, nan)
        assert not sensations.vector().any()
    assert not Sensations.of(np.full(10, np.nan)).vector().any()


def test_warmth_follows_the_grip_within_the_laws_bounds():
    law = SubstitutionLaw(highest_temperature=40.0, full_force=8.0)
    temperatures = Substitution(law).step(0.0, np.array([0, 1e-2, 0.8, 8, 80]), np.ones(5)).temperatures
    np.testing.assert_allclose(temperatures, [0, 0, 34.6, 40, 40])
    assert not Substitution().step(0.0, np.ones(5), np.ones(5)).temperatures.any()


def test_saturation_is_the_largest_share_that_a_finger_lacks():
    joints = ("thumb MP", "index MP", "index PIP", "ring MP", "wrist")
    shares = finger_saturation(np.array([0.1, 0.24, 0.15, 0.0, 9.0]), np.full(5, 0.12), joints)
    np.testing.assert_allclose(shares, [0, 0.5, 0, 0, 0])
    without_motor = finger_saturation(np.array([0.1, 0.1]), np.array([0.0, 0.05]), ("thumb IP", "index MP"))
    np.testing.assert_allclose(without_motor, [0, 0.5, 0, 0, 0])


@pytest.mark.parametrize(
    "options, message",
    [
        ({"friction": 0.0}, "friction is 0.0: expected a positive number"),
        ({"onset_amplitude": 1.1}, "onset_amplitude is 1.1: expected 0 to 1"),
        ({"warning_margin": 2.0}, "warning_margin is 2.0: expected at most 1"),
        ({"highest_temperature": 42.5}, "highest_temperature is 42.5: expected 34 to 42 deg C"),
        ({"onset_decay": float("nan")}, "onset_decay is nan: expected a positive number"),
    ],
)
def test_numbers_of_no_law_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        SubstitutionLaw(**options)


def test_contacts_of_no_finger_are_refused():
    with pytest.raises(ValueError, match=r"fingers\[1\] is 5: expected -1 to 4"):
        finger_contacts(np.ones((2, 3)), np.stack([Z] * 2), np.array([0, 5]), 0.5)
    with pytest.raises(ValueError, match="friction is -1.0: expected a positive number"):
        slip_margins(np.ones((2, 3)), np.stack([Z] * 2), -1.0)


def test_laws_carry_sensations_between_processes():
    rng = np.random.default_rng(0)
    sensations = Sensations(rng.uniform(size=5), rng.uniform(30, 40, 5))
    law = TorqueLaw(3.0, True, rng.normal(size=14), rng.normal(size=14), rng.normal(size=(14, 14)), sensations)
    vector = law.vector()
    assert vector.shape == (TorqueLaw.size(14),)
    back = TorqueLaw.of(vector, 14).since(5.0)
    assert back.is_valid and back.computed_at == 2.0
    np.testing.assert_array_equal(back.sensations.vector(), sensations.vector())


class Rig:
    """An engine at 250 Hz, the I/O side and a simulated glove, in virtual time; phases of the loops are random."""

    def __init__(self, seed: int = 0, baud: int = 115_200, **options):
        rng = np.random.default_rng(seed)
        self.now, self.engine_period = 50.0, 0.004
        self.line = DelayedLine(baud, lambda: self.now)
        self.simulation = Simulation({"clock": 9, **options}, self.line.far, self.now, lambda _: None, MODEL, SENSORS)
        self.host = GloveHost(MODEL, SENSORS, lambda: self.line, Guard(MODEL, ramp=0.2), baud=baud)
        self.peer = HeldPeer()
        self.controller = IOController(self.host, self.peer)
        self.substitution = Substitution(SubstitutionLaw(highest_temperature=42.0))
        self.margin, self.normal_force, self.torque = 1.0, 1.0, 0.0
        self.is_engine_alive = self.is_host_alive = True
        self.history: list[tuple[float, list[int], list[bool]]] = []
        self._next_engine, self._next_turn = self.now + rng.uniform(0, 0.004), self.now + rng.uniform(0, 0.005)

    @property
    def device(self):
        return self.simulation.glove.device

    def run(self, seconds: float) -> "Rig":
        end = self.now + seconds
        while self.now < end:
            self.now += 0.0005
            self.line.carry()
            if self.is_engine_alive and self.now >= self._next_engine:
                self._next_engine += self.engine_period
                felt = self.substitution.step(self.now, np.full(5, self.normal_force), np.full(5, self.margin))
                zeros = np.zeros((14, 14))
                law = TorqueLaw(self.now, True, np.zeros(14), np.full(14, self.torque), zeros, felt)
                self.peer.latest_law = law
            if round(self.now / 0.0005) % 2 == 0:
                self.simulation.step(self.now)
                self.history.append((self.now, list(self.device.amplitudes), list(self.device.are_heating)))
            if self.is_host_alive and self.now >= self._next_turn:
                self._next_turn += 0.005
                self.controller.step(self.now)
        return self

    def linked(self) -> "Rig":
        self.run(0.6)
        assert self.host.state == LinkState.LINKED and self.host.channels_of_sensations == (5, 5)
        return self

    def armed(self) -> "Rig":
        self.torque = 0.03
        self.linked().controller.arm(self.now)
        self.run(0.5)
        assert self.host.guard.state == GuardState.ARMED and max(self.device.counts) > 2000
        return self

    def silent_after(self, since: float) -> float:
        return max((t for t, amplitudes, _ in self.history if t >= since and any(amplitudes)), default=since) - since

    def cold_after(self, since: float) -> float:
        return max((t for t, _, heating in self.history if t >= since and any(heating)), default=since) - since


@pytest.mark.parametrize("arms", [False, True])
def test_slip_is_felt_within_20_ms(arms):
    """With torques on the same line of 115,200 baud, over phases of the loops, from slip to the channel's drive."""
    delays = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        rig = Rig(seed).armed() if arms else Rig(seed).linked()
        for k in range(12):
            rig.margin = 1.0
            # A heat that changes competes for the line.
            rig.normal_force = 1.0 + 2.0 * (k % 2)
            rig.run(float(rng.uniform(0.03, 0.05)))
            assert not any(rig.device.amplitudes)
            rig.margin, rig.normal_force, slipped_at = -0.1, 5.0 - rig.normal_force, rig.now
            rig.run(0.04)
            rows = [row for row in rig.history if row[0] >= slipped_at]
            delays.append(next(t for t, amplitudes, _ in rows if amplitudes[0] == 1000) - slipped_at)
            assert all(amplitudes[0] == 1000 for t, amplitudes, _ in rows if t > slipped_at + 0.02), "and goes on"
        assert (rig.host.guard.state == GuardState.ARMED) == arms
    assert max(delays) <= 0.020


def test_torques_go_on_while_amplitudes_change_at_every_turn():
    rig = Rig().armed()
    held = []
    for k in range(100):
        rig.margin = 0.3 * (k % 2)
        rig.run(0.005)
        held.append(min(rig.device.counts))
    assert min(held) > 2000 and rig.host.guard.state == GuardState.ARMED


@pytest.mark.parametrize("dead", ["engine", "host"])
def test_vibration_and_heat_end_when_the_engine_or_the_host_dies(dead):
    rig = Rig().linked()
    rig.margin, rig.normal_force = -1.0, 100.0
    rig.run(0.3)
    assert rig.device.amplitudes == [1000] * 5 and any(rig.device.are_heating)
    died_at = rig.now
    setattr(rig, f"is_{dead}_alive", False)
    rig.run(0.6)
    assert rig.silent_after(died_at) <= 0.055
    assert rig.cold_after(died_at) <= 0.255


def test_a_stop_silences_until_the_glove_is_armed_anew():
    rig = Rig().armed()
    rig.margin = -1.0
    rig.run(0.2)
    stopped_at = rig.now
    rig.host.stop(rig.now)
    rig.run(0.3)
    assert rig.silent_after(stopped_at) <= 0.012
    rig.controller.arm(rig.now)
    rig.run(0.3)
    assert rig.device.amplitudes == [1000] * 5


def test_no_torque_and_no_vibration_come_of_a_line_that_spoils_frames():
    rig = Rig().linked()
    rig.simulation.obey({"spoil": 0.3, "seed": 5}, rig.now)
    rig.margin = 0.15
    rig.history.clear()
    rig.run(1.0)
    assert {amplitude for _, amplitudes, _ in rig.history for amplitude in amplitudes} <= {0, 500}
    assert sum(rig.device.reader.refused.values()) > 20


def test_skin_says_what_the_device_does_and_never_exceeds_the_bound():
    rig = Rig().linked()
    rig.normal_force, rig.margin = 100.0, 0.0
    rig.run(12.0)
    assert rig.host.skin.amplitudes == pytest.approx(1.0)
    assert np.all(rig.host.skin.temperatures > 41.0) and np.all(rig.host.skin.temperatures <= 42.0)
    assert rig.simulation.glove.skin_temperatures.max() <= 42.0


def test_a_glove_without_the_channels_is_sent_neither_kind():
    rig = Rig(sensations=0)
    rig.margin = -1.0
    rig.run(1.0)
    assert rig.host.state == LinkState.LINKED and rig.host.channels_of_sensations == (0, 0)
    assert rig.host.counts.sensations == 0 and sum(rig.device.reader.refused.values()) == 0


@pytest.mark.parametrize(
    "said, message",
    [
        ((6, 50, 0, 0, 0), "6 vibration channels with a watchdog of 50 ms: expected 1 to 5 channels and 1 to 50 ms"),
        ((5, 51, 0, 0, 0), "watchdog of 51 ms"),
        ((5, 50, 5, 250, 4201), "a bound of 42.01 deg C: expected .* at most 42 deg C"),
        ((5, 50, 5, 0, 4200), "watchdog of 0 ms"),
    ],
)
def test_channels_beyond_the_protocols_bounds_are_not_used(said, message):
    import re

    sender = SensationSender()
    assert re.search(message, sender.learn(said)) and (sender.vibrators, sender.heaters) == (0, 0)
    sender.request(Sensations(np.ones(5), np.full(5, 40.0)))
    assert sender.due(1.0) is None


def test_values_are_cut_before_they_are_sent():
    sender = SensationSender()
    assert sender.learn((5, 50, 5, 250, 4200)) == ""
    sender.request(Sensations(np.array([2.0, -1, np.nan, np.inf, 0.25]), np.array([99.0, -3, np.nan, 36.5, 0])))
    kind, values = sender.due(0.0)
    assert values == (MAX_AMPLITUDE, 0, 0, 0, 250)
    sender.sent(0.0, kind, values)
    assert sender.due(0.005) is None, "never two in a row"
    assert sender.due(0.01)[1] == (4200, 0, 0, 3650, 0)


def test_the_virtual_glove_has_the_channels():
    glove = VirtualGlove(MODEL, SENSORS)
    zeros = np.zeros(14)
    for k in range(200):
        glove.peer.latest_law = TorqueLaw(
            glove.time, True, zeros, zeros, np.zeros((14, 14)), Sensations(np.full(5, 0.7), np.zeros(5))
        )
        glove.run(0.005 * (k + 1))
    assert glove.simulation.glove.device.amplitudes == [700] * 5


@pytest.mark.slow
@pytest.mark.realtime
def test_slip_is_felt_within_20_ms_by_the_clock():
    """The same in real time: the glove and the host in processes of their own."""
    from jaxgrasp.glove import GloveProcess, Simulator

    with Simulator() as simulator, GloveProcess(simulator.port, 14) as glove:
        zeros, delays = np.zeros(14), []
        silence, slipping = Sensations.none(), Sensations(np.ones(5), np.zeros(5))

        def write(sensations: Sensations, seconds: float) -> None:
            end = time.perf_counter() + seconds
            while time.perf_counter() < end:
                law = TorqueLaw(time.perf_counter(), True, zeros, zeros, np.zeros((14, 14)), sensations)
                glove.write(law)
                time.sleep(0.004)

        write(silence, 1.5)
        assert glove.report()["vibrators"] == glove.report()["heaters"] == 5
        for k in range(20):
            write(silence, 0.1 + 0.003 * k)
            slipped_at = time.perf_counter()
            write(slipping, 0.06)
            began = [event["at"] for event in simulator.vibrations() if event["at"] >= slipped_at]
            delays.append(began[0] - slipped_at)
        assert np.quantile(delays, 0.9) <= 0.020
