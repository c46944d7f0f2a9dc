"""Sensors: counts to angles, tensions and torques and back; calibration finds what made the pairs."""

import json

import numpy as np
import pytest

from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.glove.sensors import (
    Encoders,
    Gauges,
    Sensors,
    fit_encoders,
    fit_gauges,
    fit_line,
    load_sensors,
    nominal_sensors,
    save_sensors,
)

MODEL = lrp_hand_master()


def made(seed: int = 0) -> Sensors:
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1, 1], 14)
    encoders = Encoders(rng.uniform(-0.3, 0.3, 14), signs * rng.uniform(2e-4, 6e-4, 14))
    return Sensors(encoders, Gauges(rng.uniform(-50, 50, 14), rng.uniform(8e-4, 2e-3, 14), np.full(14, 0.12 / 4.5)))


@pytest.mark.parametrize("sensors", [nominal_sensors(MODEL), made()], ids=["nominal", "made"])
def test_counts_and_back(sensors):
    rng = np.random.default_rng(1)
    angles, tensions = rng.uniform(-0.2, 1.8, (50, 14)), rng.uniform(0, 4.4, (50, 14))
    back = sensors.encoders.angles(sensors.encoders.counts(angles))
    assert np.all(np.abs(back - angles) <= np.abs(sensors.encoders.per_count) / 2 * (1 + 1e-9))
    read_tensions, saturated = sensors.gauges.tensions(sensors.gauges.counts(tensions))
    assert np.all(np.abs(read_tensions - tensions) <= sensors.gauges.per_count) and not saturated.any()


@pytest.mark.parametrize("sensors", [nominal_sensors(MODEL), made()], ids=["nominal", "made"])
def test_gauges_say_when_they_are_at_their_end(sensors):
    counts = sensors.gauges.counts(np.full(14, 9.0))
    torques, saturated = sensors.gauges.torques(counts)
    assert (
        saturated.all() and np.all(torques <= 4.5 * sensors.gauges.arm) and np.all(torques > 4.49 * sensors.gauges.arm)
    )
    slack, none = sensors.gauges.tensions(counts * 0 - 3000)
    assert not slack.any() and not none.any()


def test_the_nominal_gauge_and_the_largest_torque_end_together():
    torques, _ = nominal_sensors(MODEL).gauges.torques(np.full(14, 4095, np.int16))
    np.testing.assert_allclose(torques, MODEL.limits)


@pytest.mark.parametrize("seed", range(5))
def test_calibration_recovers_what_made_the_pairs(seed):
    """Within four of its own standard errors, from readings that are rounded and noisy."""
    rng, sensors = np.random.default_rng(seed), made(seed)
    angles = rng.uniform(0, 1.6, (60, 14))
    encoders, line = fit_encoders(sensors.encoders.counts(angles), angles + rng.normal(0, 0.01, angles.shape))
    for estimate, true, error in (
        (encoders.zero, sensors.encoders.zero, line.error_at_zero),
        (encoders.per_count, sensors.encoders.per_count, line.error_per_count),
    ):
        assert np.all(np.abs(estimate - true) <= 4.5 * error)
    np.testing.assert_allclose(line.rms, 0.01, rtol=0.4)
    tensions = rng.uniform(0, 6, (60, 14))
    gauges, line = fit_gauges(sensors.gauges.counts(tensions), tensions, sensors.gauges.arm, 4.5)
    np.testing.assert_allclose(gauges.per_count, sensors.gauges.per_count, rtol=1e-3)
    np.testing.assert_allclose(gauges.zero, sensors.gauges.zero, atol=1.5)
    np.testing.assert_array_equal(np.isnan(line.residuals), tensions >= 4.5)


def test_the_line_is_that_of_a_library():
    rng = np.random.default_rng(3)
    counts, values = rng.integers(-900, 900, (20, 2)), rng.normal(size=(20, 2))
    values[4, 1] = np.nan
    line = fit_line(counts, values)
    for k in range(2):
        use = ~np.isnan(values[:, k])
        (slope, at_zero), covariance = np.polyfit(counts[use, k], values[use, k], 1, cov=True)
        np.testing.assert_allclose([line.per_count[k], line.at_zero[k]], [slope, at_zero], rtol=1e-9)
        errors = [line.error_per_count[k], line.error_at_zero[k]]
        np.testing.assert_allclose(errors, np.sqrt(np.diag(covariance)), rtol=1e-9)


@pytest.mark.parametrize(
    "counts, values, message",
    [
        (np.zeros((4, 2), int), np.zeros((4, 3)), "expected the same shape"),
        (np.arange(8).reshape(4, 2), np.full((4, 2), np.inf), r"values\[0, 0\] is inf"),
        (np.arange(4).reshape(2, 2), np.zeros((2, 2)), "channel 0 has 2 pairs of 2 different counts"),
        (np.ones((4, 1), int), np.zeros((4, 1)), "channel 0 has 4 pairs of 1 different"),
        (np.arange(4)[:, None], np.full((4, 1), np.nan), "channel 0 has 0 pairs"),
        (np.arange(4)[:, None], np.ones((4, 1)), "channel 0 does not change with its counts"),
    ],
)
def test_pairs_that_calibrate_nothing(unchecked, counts, values, message):
    with pytest.raises(ValueError, match=message):
        fit_encoders(counts, values)


def test_files(folder):
    sensors, path = made(), folder / "calibration.json"
    save_sensors(sensors, path)
    back = load_sensors(path, 14)
    for part in ("encoders", "gauges"):
        for name, value in vars(getattr(sensors, part)).items():
            np.testing.assert_array_equal(getattr(getattr(back, part), name), value)
    with pytest.raises(ValueError, match="encoders.zero has 14 numbers: expected 5"):
        load_sensors(path, 5)
    content = json.loads(path.read_text())
    for change, message in (
        (lambda c: c.pop("gauges"), "no list of numbers gauges.zero"),
        (lambda c: c["gauges"].update(full=-1), "gauges.full is -1: expected a positive tension"),
        (lambda c: c["encoders"]["per_count"].__setitem__(2, 0), "encoders has a zero at channel 2"),
        (lambda c: c["encoders"]["zero"].__setitem__(2, "x"), "no list of numbers encoders.zero"),
        (lambda c: c["encoders"]["zero"].__setitem__(2, True), "no list of numbers encoders.zero"),
        (lambda c: c["encoders"]["zero"].__setitem__(2, 10**400), "no list of numbers encoders.zero"),
        (lambda c: c["gauges"]["arm"].__setitem__(3, -1.0), "arm of gauges is negative at channel 3"),
        (lambda c: c["gauges"].update(full=10**400), "gauges.full is 1000"),
    ):
        bad = json.loads(json.dumps(content))
        change(bad)
        path.write_text(json.dumps(bad))
        with pytest.raises(ValueError, match=message):
            load_sensors(path, 14)
    for text in ("{", "[" * 100_000):
        path.write_text(text)
        with pytest.raises(ValueError, match="is not JSON"):
            load_sensors(path, 14)
