"""The way of an object that escapes: along its twist, as far as is shown, and back at its start."""

import numpy as np

from jaxgrasp.view.drawing import PERIOD, TRAVEL, TURN, escaped, scaled_twist, share_at

RNG = np.random.default_rng(1)


def test_the_farthest_corner_goes_the_whole_way_or_the_object_turns_by_its_most():
    for _ in range(50):
        twist, origin, corners = RNG.normal(size=6), RNG.normal(size=3), 0.05 * RNG.normal(size=(30, 3))
        scaled = scaled_twist(twist, origin, corners, 2.0)
        np.testing.assert_allclose(np.cross(scaled[:3], twist[:3]), 0, atol=1e-12)
        assert scaled @ twist > 0
        speeds = np.linalg.norm(scaled[:3] + np.cross(scaled[3:], corners - origin), axis=1)
        turn = np.linalg.norm(scaled[3:])
        assert speeds.max() <= 2 * TRAVEL * (1 + 1e-9) and turn <= TURN * (1 + 1e-9)
        assert np.isclose(speeds.max(), 2 * TRAVEL) or np.isclose(turn, TURN)


def test_no_twist_moves_nothing():
    assert not scaled_twist(np.zeros(6), np.zeros(3), RNG.normal(size=(4, 3))).any()


def test_a_pose_begins_where_it_is_and_goes_along_the_twist():
    pose, origin, twist = np.eye(3, 4), np.array([0.1, 0.2, 0.3]), 0.3 * RNG.normal(size=6)
    pose[:, 3] = RNG.normal(size=3)
    np.testing.assert_allclose(escaped(pose, twist, origin, 0.0), pose, atol=1e-12)
    # By finite differences a point of the body moves as a twist moves it.
    small, point = 1e-6, RNG.normal(size=3)
    before, after = (at[:, :3] @ point + at[:, 3] for at in (pose, escaped(pose, twist, origin, small)))
    np.testing.assert_allclose((after - before) / small, twist[:3] + np.cross(twist[3:], before - origin), atol=1e-5)
    moved = escaped(pose, twist, origin, 1.0)
    np.testing.assert_allclose(moved[:, :3] @ moved[:, :3].T, np.eye(3), atol=1e-12)


def test_the_way_is_smooth_and_begins_again():
    shares = np.array([share_at(t) for t in np.linspace(0, PERIOD * 0.999, 200)])
    assert shares[0] == 0 and shares[-1] == 1 and (np.diff(shares) >= 0).all()
    assert share_at(PERIOD) == 0
