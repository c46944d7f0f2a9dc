"""Retargeting: fingertips go where the person's are, a touch is a touch, limits hold, and the derivative is that."""

import jax
import numpy as np
import pytest

from jaxgrasp.teleop.retarget import Retargeting, find_fingertips
from jaxgrasp.teleop.trial import FINGERS


def settled(retargeting, angles, calls=60):
    retargeting.reset()
    for _ in range(calls):
        posture = retargeting(angles)
    return posture


@pytest.mark.parametrize("closure", [0.15, 0.3, 0.45])
def test_fingertips_come_near_their_targets_within_the_limits(workplace, closure):
    retargeting, robot = workplace.retargeting, workplace.retargeting.robot
    angles = workplace.open + closure * (workplace.closed - workplace.open)
    posture = settled(retargeting, angles)
    targets = np.asarray(retargeting.calibration.targets(retargeting.person_tips(angles)))
    assert np.linalg.norm(retargeting.robot_tips(posture) - targets, axis=-1).max() < 8e-3
    assert np.all(posture >= np.asarray(robot.lower) - 1e-9) and np.all(posture <= np.asarray(robot.upper) + 1e-9)
    assert robot.coupling.angles(posture) == pytest.approx(posture)


def pinch(workplace, finger):
    """Return the person's angles of a pinch of thumb and finger, by search over both closures."""
    retargeting, joints = workplace.retargeting, workplace.person.joints
    best, best_gap = None, np.inf
    k = FINGERS.index(finger)
    for thumb in np.linspace(0.1, 0.9, 9):
        for other in np.linspace(0.2, 0.8, 13):
            share = np.array([thumb if "thumb" in name else other if finger in name else 0.1 for name in joints])
            angles = workplace.open + share * (workplace.closed - workplace.open)
            tips = retargeting.person_tips(angles)
            gap = np.linalg.norm(tips[0] - tips[k])
            if gap < best_gap:
                best, best_gap = angles, gap
    return best, best_gap


@pytest.mark.parametrize("finger", ["index", "middle"])
def test_after_calibration_the_robot_touches_where_the_person_does(workplace, finger):
    retargeting = Retargeting(workplace.person, workplace.follower.hand, FINGERS)
    angles, gap = pinch(workplace, finger)
    k = FINGERS.index(finger)

    def robot_gap():
        tips = retargeting.robot_tips(settled(retargeting, angles))
        return np.linalg.norm(tips[0] - tips[k]) - retargeting.calibration.robot_touch_gaps[k]

    before = robot_gap()
    retargeting.calibrate({finger: angles})
    assert retargeting.calibration.touch_gaps[k] == pytest.approx(gap)
    after = robot_gap()
    assert abs(after) <= abs(before) + 1e-6 and abs(after) < 5e-3


def test_its_derivative_is_that_of_differences(workplace):
    retargeting = workplace.retargeting
    angles = workplace.open + 0.3 * (workplace.closed - workplace.open)
    last = settled(retargeting, angles)
    direction = np.random.default_rng(0).normal(size=len(angles))
    _, exact = jax.jvp(lambda a: retargeting.solve(a, last), (angles,), (direction,))
    step = 1e-6
    ahead, behind = (np.asarray(retargeting.solve(angles + s * step * direction, last)) for s in (1, -1))
    assert np.asarray(exact) == pytest.approx((ahead - behind) / (2 * step), abs=1e-6)


def test_bad_fingers_and_touches_are_refused_by_name(workplace):
    person, robot = workplace.person, workplace.follower.hand
    with pytest.raises(ValueError, match="thumb first"):
        Retargeting(person, robot, ("index", "thumb"))
    with pytest.raises(ValueError, match="no link 'tail' distal"):
        find_fingertips(person, ("tail",))
    with pytest.raises(ValueError, match=r"touches has 'thumb'"):
        workplace.retargeting.calibrate({"thumb": workplace.open})
    with pytest.raises(ValueError, match=r"touches\['index'\]"):
        workplace.retargeting.calibrate({"index": workplace.open[:3]})
