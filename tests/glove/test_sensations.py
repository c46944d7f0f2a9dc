"""Vibration and heat: both watchdogs, the bound of temperatures, and devices and hosts of before."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.protocol.device import HOTTEST, Cause, Device, DeviceState
from jaxgrasp.glove.protocol.frames import Flag, Frame, FrameReader, Kind
from tests.glove.test_device import MS, Compiled, Host, firmware  # noqa: F401

SKIN = (5, 5, 3400, 3000, 800)
"""Vibrators, heaters, resting temperature, rise and time constant."""


def devices(firmware):  # noqa: F811
    names = ("vibrators", "heaters", "resting", "heat_rise", "heat_time")
    return Device(seed=77, **dict(zip(names, SKIN, strict=True))), Compiled(firmware, skin=SKIN)


def skin(device, timestamp: int) -> tuple[int, ...]:
    frame = device.skin(timestamp)
    frame = frame if isinstance(frame, Frame) else FrameReader().feed(frame)[0]
    assert frame.kind == Kind.SKIN
    return frame.values


def greet(device) -> Host:
    host = Host()
    device.step(0)
    device.receive(0, host.line(0, Kind.HELLO, (7,)))
    return host


def test_amplitudes_are_cut_and_need_no_arm(firmware):  # noqa: F811
    for device in devices(firmware):
        host = greet(device)
        device.receive(1, host.line(1, Kind.VIBRATE, (-5, 0, 350, 1000, 32_000, 700)))
        device.step(MS)
        assert skin(device, MS)[:5] == (0, 0, 350, 1000, 1000) and device.state == DeviceState.IDLE


@pytest.mark.parametrize("kind, watchdog, place", [(Kind.VIBRATE, 50, 0), (Kind.HEAT, 250, 10)])
def test_each_has_a_watchdog_of_its_own_which_nothing_else_feeds(firmware, kind, watchdog, place):  # noqa: F811
    for device in devices(firmware):
        host = greet(device)
        device.receive(1, host.line(1, kind, (4000,)))
        on = []
        for timestamp in range(MS, 400 * MS, MS):
            # Commands and the other kind go on as if nothing had happened.
            other = Kind.COMMAND if timestamp // MS % 2 else Kind.HEAT + Kind.VIBRATE - kind
            device.receive(timestamp, host.line(timestamp, Kind(other), (0,)))
            device.step(timestamp)
            on.append(skin(device, timestamp)[place] > 0)
        assert on == [True] * watchdog + [False] * (399 - watchdog)


@pytest.mark.parametrize("kind, watchdog", [(Kind.VIBRATE, 50), (Kind.HEAT, 250)])
def test_what_waited_longer_than_its_watchdog_does_nothing(firmware, kind, watchdog):  # noqa: F811
    for device in devices(firmware):
        host = greet(device)
        timestamp = 600 * MS
        device.step(timestamp)
        device.receive(timestamp, host.line(timestamp, kind, (4000,), echo=timestamp - watchdog * MS - 1))
        device.step(timestamp)
        assert not any(skin(device, timestamp)[:5]) and skin(device, timestamp)[10] == 0


def test_a_latch_and_a_greeting_silence_both_at_once(firmware):  # noqa: F811
    ends = (
        lambda device, host: device.receive(9 * MS, host.line(9 * MS, Kind.HELLO, (9,))),
        lambda device, host: device.receive(9 * MS, host.line(9 * MS, Kind.STOP)),
        lambda device, host: device.press(True),
    )
    for end in ends:
        for device in devices(firmware):
            host = greet(device)
            device.receive(1, host.line(1, Kind.VIBRATE, (800,)))
            device.receive(2, host.line(2, Kind.HEAT, (4000,)))
            device.step(MS)
            assert skin(device, MS)[0] == 800 and skin(device, MS)[10] == 1
            end(device, host)
            assert skin(device, MS)[0] == 0 and skin(device, MS)[10] == 0
            if device.state == DeviceState.LATCHED:
                assert device.cause == Cause.STOPPED
                device.receive(10 * MS, host.line(10 * MS, Kind.VIBRATE, (800,)))
                device.step(11 * MS)
                assert skin(device, 11 * MS)[0] == 0


def heat_for(device, seconds: float, plant: tuple[float, float], *, has_sensor: bool, target: int = 32_000):
    """Return the temperatures of a skin that heats by ``plant`` (rise [deg C], time constant [s]), one a millisecond.

    A step comes late at times, but no more than the heater's one-shot allows.
    """
    host, rng, temperature, temperatures = greet(device), np.random.default_rng(3), 34.0, []
    rise, constant = plant
    timestamp, is_on = 0, False
    while timestamp < 1e6 * seconds:
        elapsed = int(rng.choice([1, 1, 1, 5, 20])) * MS
        timestamp += elapsed
        # T' = (34 + rise on - T) / constant, exactly.
        temperature += (34.0 + rise * is_on - temperature) * -np.expm1(-1e-6 * elapsed / constant)
        temperatures.append(temperature)
        if has_sensor:
            device.measure_skin(0, int(100 * temperature))
        device.receive(timestamp, host.line(timestamp, Kind.HEAT, (target,)))
        device.step(timestamp)
        is_on = bool(skin(device, timestamp)[10] & 1)
    return np.array(temperatures)


def test_no_host_heats_a_skin_above_the_bound(firmware):  # noqa: F811
    for device in devices(firmware):
        temperatures = heat_for(device, 60.0, (30.0, 8.0), has_sensor=False)
        assert temperatures.max() <= HOTTEST / 100 and temperatures[-1] > 41.5


def test_a_sensor_ends_heat_where_the_heater_is_stronger_than_was_said(firmware):  # noqa: F811
    for device in devices(firmware):
        temperatures = heat_for(device, 40.0, (60.0, 6.0), has_sensor=True)
        # A step of 20 ms adds no more than 60 x 0.02 / 6 deg C.
        assert temperatures.max() <= HOTTEST / 100 + 0.2 + 0.01


def test_a_target_is_reached_and_kept(firmware):  # noqa: F811
    for device in devices(firmware):
        temperatures = heat_for(device, 40.0, (30.0, 8.0), has_sensor=False, target=3800)
        assert np.all(np.abs(temperatures[-200:] - 38.0) < 0.35)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 30_000), st.integers(-(2**15), 2**15 - 1), st.randoms()), max_size=60))
def test_spoilt_frames_change_nothing(events):
    device, timestamp = Device(vibrators=5, heaters=5), 0
    host = greet(device)
    for elapsed, value, rng in events:
        timestamp += elapsed
        line = host.line(timestamp, rng.choice((Kind.VIBRATE, Kind.HEAT)), (value,) * 14)
        sent = bytearray(line)
        sent[rng.randrange(len(sent) - 1)] ^= 1 << rng.randrange(8)
        device.receive(timestamp, bytes(sent) + b"\0")
        device.step(timestamp)
        assert device.amplitudes == [0] * 5 and not any(device.are_heating)


def test_devices_without_the_channels_say_so_as_devices_of_before():
    device = Device()
    host = greet(device)
    assert device.answer(0).values[8:] == (0,) * 6
    device.receive(1, host.line(1, Kind.VIBRATE, (1000,) * 14))
    device.receive(2, host.line(2, Kind.HEAT, (4000,) * 14, Flag(0)))
    device.step(MS)
    assert device.amplitudes == [0] * 5 and not any(device.are_heating) and device.state == DeviceState.IDLE


@pytest.mark.parametrize(
    "options, message",
    [
        ({"vibrators": 6}, "vibrators is 6: expected 0 to 5"),
        ({"heaters": -1}, "heaters is -1: expected 0 to 5"),
        ({"resting": 4201}, "resting is 4201: expected 0 to 4200"),
        ({"heat_rise": 0}, "heat_rise is 0: expected 1 to 20000"),
        ({"heat_time": 0}, "heat_time is 0: expected 1 to 65535"),
    ],
)
def test_numbers_of_no_heater_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Device(**options)
