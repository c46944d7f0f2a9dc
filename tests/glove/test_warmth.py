"""Torques for moments and torques for ever, against the integral of the motors' warmth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from jaxgrasp.glove.guard import Guard, holding_time
from jaxgrasp.glove.model import GloveModel, load_glove

MODEL = GloveModel("warm", ("a", "b"), (0.2, 0.3), rate=20.0, continuous=(0.1, 0.25), heating=2.0)
TURN = 0.005


def played(requests, model: GloveModel = MODEL) -> np.ndarray:
    """Return the torques ``(turns, 2)`` that leave the guard, of those requested at each turn."""
    guard = Guard(model, ramp=1e-3)
    guard.arm(0.0)
    return np.array([guard.step(TURN * k, request, TURN * k).torques for k, request in enumerate(requests, 1)])


def warmth(torques: np.ndarray) -> np.ndarray:
    """Integrate T s' = torque^2 - s by SciPy for torques that are held for one turn each."""
    states = [np.zeros(2)]
    for torque in torques:
        rate = lambda _, squares, torque=torque: (torque**2 - squares) / MODEL.heating  # noqa: E731
        states.append(solve_ivp(rate, (0, TURN), states[-1], rtol=1e-8, atol=1e-12).y[:, -1])
    return np.array(states)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 200), st.floats(0, 0.5), st.floats(0, 0.5)), min_size=2, max_size=5))
def test_no_motor_gets_warmer_than_what_it_bears_for_ever(parts):
    torques = played([torque for count, *torque in parts for _ in range(count)])
    most = np.array(MODEL.continuous) ** 2
    assert np.all(warmth(torques) <= most * (1 + 1e-3))


def test_a_limit_is_for_moments_and_fades_without_a_jump():
    torques = played(np.full((4000, 2), 0.3))
    assert torques[:20].max(0) == pytest.approx([0.2, 0.3], abs=1e-4)
    assert torques[-1] == pytest.approx(MODEL.continuous, abs=1e-3)
    # As gradually as it warms: what fades, by the fifth of the warmth over which it does, and the time constant.
    assert np.abs(np.diff(torques[20:], axis=0)).max() < TURN * (0.1 / 0.2) * (0.2 / 0.1) ** 2 / MODEL.heating
    is_full = (np.abs(torques - MODEL.limits) < 2e-5).all(1)
    seconds = TURN * np.flatnonzero(is_full)[-1]
    assert seconds == pytest.approx(float(holding_time(MODEL, np.full(2, 0.3))), abs=0.05)


def test_what_is_borne_for_ever_stays():
    torques = played(np.full((4000, 2), MODEL.continuous))
    np.testing.assert_allclose(torques[50:], np.broadcast_to(MODEL.continuous, torques[50:].shape), atol=1e-5)
    assert holding_time(MODEL, np.array(MODEL.continuous)) == np.inf


def test_rest_cools():
    rests = np.zeros((2000, 2))
    torques = played(np.concatenate([np.full((2000, 2), 0.3), rests, np.full((20, 2), 0.3)]))
    assert torques[-1] == pytest.approx([0.2, 0.3], abs=1e-4)
    guard = Guard(MODEL, ramp=1e-3)
    for begins in (0.0, 100.0):
        guard.arm(begins)
        for k in range(1, 1000):
            output = guard.step(begins + TURN * k, np.full(2, 0.3), begins + TURN * k)
            first = output.torques if k == 10 else first if k > 10 else None
        assert first == pytest.approx([0.2, 0.3], abs=1e-4) and output.torques[0] < 0.15
        guard.disarm()


def test_times_follow_torques():
    torques = np.array([[0.2, 0], [0.15, 0], [0.1, 0], [0, 0.3], [0.5, 0.26]])
    times = holding_time(MODEL, torques)
    # T ln(1 / (1 - bearable / torque^2)), of which a fifth fades.
    expected = [
        -2 * np.log1p(-0.01 * 0.8 / 0.04),
        -2 * np.log1p(-0.01 * 0.9 / 0.0225),
        np.inf,
        -2 * np.log1p(-0.0625 * 0.8 / 0.09),
        -2 * np.log1p(-0.01 * 0.8 / 0.04),
    ]
    np.testing.assert_allclose(times, expected)
    assert (holding_time(replace(MODEL, continuous=None), torques) == np.inf).all()
    assert (holding_time(replace(MODEL, continuous=MODEL.limits), torques) == np.inf).all()


def test_bad_entries(tmp_path):
    path = tmp_path / "glove.toml"
    head = 'name = "warm"\njoints = ["a", "b"]\nlimits = [0.2, 0.3]\n'
    path.write_text(head + "continuous = [0.1, 0.25]\nheating = 2\nrate = 20\n")
    assert load_glove(path) == MODEL
    for more, message in (
        ("continuous = [0.1]", "continuous has 1 entries: expected one for each of 2 joints"),
        ("continuous = 0.25", r"continuous\[0\] is 0.25: expected at most its limit, 0.2"),
        ("continuous = 0", r"continuous\[0\] is 0.0: expected a positive number"),
        ("continuous = 0.1\nheating = -1", "heating is -1.0: expected a positive number"),
    ):
        path.write_text(head + more)
        with pytest.raises(ValueError, match=message):
            load_glove(path)
