"""Ranks of joints over trials: shares are those of squared torques, and the order's stability is that of Kendall."""

import numpy as np
import pytest

from jaxgrasp.teleop.importance import rank_joints

JOINTS = ("a", "b", "c", "d")


def trials_of(scales, count=20, noise=0.1, seed=0):
    rng = np.random.default_rng(seed)
    return [
        np.asarray(scales) * np.exp(noise * rng.normal(size=4)) * np.abs(np.sin(np.arange(1, 50)))[:, None]
        for _ in range(count)
    ]


def test_shares_and_order_are_those_of_the_torques():
    ranking = rank_joints(JOINTS, trials_of([1.0, 4.0, 2.0, 0.0], noise=0.0))
    assert ranking.joints == ("b", "c", "a", "d")
    assert ranking.shares == pytest.approx(np.array([16, 4, 1, 0]) / 21)
    assert ranking.tau == ranking.tau_low == ranking.tau_high == pytest.approx(1)


def test_an_order_that_is_chance_is_told_from_a_stable_one():
    stable, chance = rank_joints(JOINTS, trials_of([1, 2, 4, 8])), rank_joints(JOINTS, trials_of([1, 1, 1, 1], noise=1))
    assert stable.tau_low > 0.9 and chance.tau_high < 0.6
    assert np.all(stable.low <= stable.shares) and np.all(stable.shares <= stable.high)


@pytest.mark.parametrize(
    ("trials", "message"),
    [
        ([np.ones((5, 4))] * 2, "trials has 2 entries"),
        ([np.ones((5, 4)), np.ones((5, 3)), np.ones((5, 4))], r"trials\[1\] has shape \(5, 3\)"),
        ([np.ones((5, 4)), np.ones((5, 4)), np.zeros((5, 4))], r"trials\[2\] has no torque"),
    ],
)
def test_bad_trials_are_refused_by_name(trials, message):
    with pytest.raises(ValueError, match=message):
        rank_joints(JOINTS, trials)
