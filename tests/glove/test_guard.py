"""Whatever is asked of a guard, what leaves it is bounded, resists flexion only, is slow, and is zero after a fault."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrasp.glove.guard import Guard, GuardState
from jaxgrasp.glove.model import GloveModel, lrp_hand_master

MODEL = GloveModel("three", ("a", "b", "c"), (0.12, 0.12, 0.05))
NUMBERS = st.one_of(st.floats(-1, 1), st.floats(allow_nan=True, allow_infinity=True))
STEPS = st.lists(
    st.tuples(st.floats(1e-4, 0.1), st.lists(NUMBERS, min_size=3, max_size=3), st.floats(-0.01, 0.08)), max_size=40
)


def armed(model: GloveModel = MODEL, **options) -> Guard:
    guard = Guard(model, **options)
    guard.arm(0.0)
    return guard


def settle(guard: Guard, requested, start: float = 0.0, seconds: float = 4.0):
    for k in range(1, int(seconds / 0.005)):
        output = guard.step(start + 0.005 * k, requested, start + 0.005 * k)
    return output


@settings(max_examples=300, deadline=None)
@given(STEPS, st.sampled_from(["clip", "scale"]), st.floats(0, 1))
def test_bounds_hold_whatever_is_asked(steps, projection, scale):
    guard = armed(projection=projection, scale=scale)
    timestamp, before, latched = 0.0, np.zeros(3), False
    for elapsed, requested, age in steps:
        timestamp += elapsed
        output = guard.step(timestamp, requested, timestamp - age)
        assert output.counts.dtype == np.int16
        np.testing.assert_array_equal(output.torques, output.counts * MODEL.quantum)
        assert np.all(output.torques >= 0) and np.all(output.torques <= MODEL.limits)
        bad = not np.all(np.isfinite(requested)) or not 0 <= timestamp - (timestamp - age) <= 0.05
        latched |= bad
        if latched:
            assert guard.state == output.state == GuardState.LATCHED and guard.cause
            assert not np.any(output.torques)
        else:
            assert np.all(np.abs(output.torques - before) <= MODEL.rate * elapsed + 1.001 * MODEL.quantum)
            assert np.all(output.torques[np.array(requested) <= 0] <= before[np.array(requested) <= 0])
        before = output.torques


def test_it_comes_to_what_is_asked_and_says_what_it_cuts():
    output = settle(armed(), [0.06, 0.2, -0.03])
    np.testing.assert_allclose(output.torques, [0.06, 0.12, 0], atol=MODEL.quantum)
    np.testing.assert_allclose(output.beyond, [0, 0.08, 0], atol=1e-12)
    np.testing.assert_allclose(output.assisting, [0, 0, 0.03], atol=1e-12)
    np.testing.assert_allclose(output.held_back, 0, atol=1e-9)
    assert output.is_clipped
    assert not settle(armed(), [0.06, 0.1, 0.0]).is_clipped


def test_scaling_together_keeps_the_direction():
    output = settle(armed(projection="scale"), [0.06, 0.24, 0.02])
    np.testing.assert_allclose(output.torques, [0.03, 0.12, 0.01], atol=MODEL.quantum)
    np.testing.assert_allclose(output.beyond, [0.03, 0.12, 0.01], atol=1e-12)
    settle(armed(projection="scale"), [1.7e308, 0, 1.0])


def test_it_ramps_from_zero_after_arming():
    guard = Guard(MODEL, ramp=2.0)
    assert not np.any(settle(guard, [0.1] * 3).torques) and guard.state == GuardState.DISARMED
    guard.arm(10.0)
    torques = [guard.step(10 + t, [0.1, 0.1, 0.01], 10 + t).torques for t in np.arange(0.01, 2.5, 0.01)]
    np.testing.assert_allclose([torque[0] for torque in torques[:200:40]], 0.1 * np.arange(0.01, 2, 0.4) / 2, atol=2e-5)
    np.testing.assert_allclose(torques[-1], [0.1, 0.1, 0.01], atol=2e-5)


def test_the_first_power_on_gives_a_twentieth():
    np.testing.assert_allclose(settle(armed(scale=0.05), [0.12] * 3).torques, [0.006, 0.006, 0.0025], atol=2e-5)


def test_a_pause_allows_no_jump():
    guard = armed(ramp=0.01)
    guard.step(0.01, [0.0] * 3, 0.01)
    output = guard.step(5.0, [0.12, 0.12, 0.05], 5.0)
    assert output.torques.max() <= MODEL.rate * 0.02 + MODEL.quantum


@pytest.mark.parametrize(
    "timestamp, requested, measured_at, cause",
    [
        (1.0, [np.nan, 0, 0], 1.0, "not finite"),
        (1.0, [0, np.inf, 0], 1.0, "not finite"),
        (1.0, [0, 0], 1.0, "shape"),
        (1.0, "torque", 1.0, "not an array of numbers"),
        (1.0, None, 1.0, "not an array of numbers"),
        (1.0, [1j, 0, 0], 1.0, "not an array of numbers"),
        (1.0, [[0], [0, 0]], 1.0, "not an array of numbers"),
        (-1.0, [0, 0, 0], -1.0, "ran backwards"),
        (np.nan, [0, 0, 0], 0.0, "ran backwards"),
        (1.0, [0, 0, 0], 0.9, "read 0.1 s ago"),
        (1.0, [0, 0, 0], 1.1, "read -0.1 s ago"),
        (1.0, [0, 0, 0], np.nan, "read nan s ago"),
    ],
)
def test_faults_latch_until_armed_again(timestamp, requested, measured_at, cause):
    guard = armed()
    settle(guard, [0.1] * 3, seconds=0.5)
    guard = armed()
    assert guard.step(0.01, [0.1] * 3, 0.01).state == GuardState.ARMED
    assert not np.any(guard.step(timestamp, requested, measured_at).torques)
    assert guard.state == GuardState.LATCHED and cause in guard.cause
    guard.trip("another")
    guard.disarm()
    assert guard.state == GuardState.LATCHED and cause in guard.cause
    assert not np.any(settle(guard, [0.1] * 3, start=1.0).torques)
    guard.arm(10.0)
    assert guard.cause == ""
    assert not np.any(guard.step(10.0, [0.1] * 3, 10.0).torques)
    np.testing.assert_allclose(settle(guard, [0.1, 0.1, 0.01], start=10.0).torques, [0.1, 0.1, 0.01], atol=2e-5)


def test_disarming_is_no_fault():
    guard = armed()
    settle(guard, [0.1] * 3, seconds=1.0)
    guard.disarm()
    output = guard.step(1.0, [0.1] * 3, 1.0)
    assert output.state == GuardState.DISARMED and not np.any(output.torques)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"projection": "clamp"}, "expected 'clip' or 'scale'"),
        ({"scale": 1.1}, "scale is 1.1: expected 0 to 1"),
        ({"scale": np.nan}, "scale is nan"),
        ({"ramp": 0.0}, "ramp is 0.0: expected a positive time"),
        ({"oldest": np.inf}, "oldest is inf"),
        ({"scale": "a"}, "scale is a"),
        ({"ramp": None}, "ramp is None"),
    ],
)
def test_bad_settings(unchecked, options, message):
    with pytest.raises(ValueError, match=message):
        Guard(MODEL, **options)


def test_the_papers_glove_never_exceeds_its_limit_in_any_rounding():
    model = lrp_hand_master()
    output = settle(armed(model), np.full(14, 0.12))
    assert np.all(output.torques <= 0.12) and np.all(output.torques > 0.12 - 2 * model.quantum)
