"""Several hands on one object: their forces sum to the load, and a hand that is lost leaves without a jump."""

import numpy as np
import pytest

from jaxgrasp.glove.model import lrp_hand_master
from jaxgrasp.hand import human_hand
from jaxgrasp.teleop.cooperation import FADING_TIME, LOWERING_SPEED, Team
from jaxgrasp.teleop.feedback import ForceFeedback
from jaxgrasp.teleop.follower import FollowerContacts, FollowerState, PalmPose

LOAD = np.array([0.5, -1.0, 8.0, 0.05, 0.1, -0.02])
PERSON = human_hand()
STEP = 0.004


def hand_state(at, side, centre=(0.2, 0.1, 0.3), cause=""):
    """Return a hand that presses with thumb and three fingers on the side of a box at +-x."""
    names = [link.name for link in PERSON.links]
    links = np.array([names.index(f"{finger} distal") for finger in ("thumb", "index", "middle", "ring")])
    spots = np.array([[0.0, 0, -0.03], [0, 0.02, 0.03], [0, 0, 0.03], [0, -0.02, 0.03]])
    normals = np.array([[0, 0, 1.0], [0, 0, -1], [0, 0, -1], [0, 0, -1]])
    squeeze = np.array([6.0, 2, 2, 2])
    points = np.asarray(centre) + spots + [side * 0.1, 0, 0]
    contacts = FollowerContacts(points, normals, squeeze[:, None] * normals, links)
    palm = PalmPose(points.mean(0), np.eye(3))
    return FollowerState(at, np.zeros(1), palm, contacts, np.asarray(centre), cause)


def total(step, states):
    centre = states[0].object_centre
    arms = np.concatenate([s.contacts.points - centre for s in states])
    forces = np.concatenate([share.forces for share in step.shares])
    return np.concatenate([forces.sum(0), np.cross(arms, forces).sum(0)])


@pytest.mark.parametrize("sharing", ["closed-form", "optimum"])
@pytest.mark.parametrize("hands", [1, 2, 3])
def test_forces_sum_to_the_load(sharing, hands):
    states = [hand_state(0.0, side) for side in (1, -1, 0.3)[:hands]]
    step = Team([f"hand {k}" for k in range(hands)], sharing, friction=2.0).step(0.0, states, LOAD)
    assert step.is_balanced and not step.notices
    assert total(step, states) == pytest.approx(LOAD, abs=1e-9)
    assert sum(share.wrench for share in step.shares) == pytest.approx(LOAD, abs=1e-9)


def test_the_optimum_stays_within_the_friction_cones():
    states = [hand_state(0.0, side) for side in (1, -1)]
    step = Team(["left", "right"], "optimum", friction=0.8).step(0.0, states, LOAD)
    for state, share in zip(states, step.shares, strict=True):
        normal = np.sum(share.forces * state.contacts.normals, -1)
        tangential = np.linalg.norm(share.forces - normal[:, None] * state.contacts.normals, axis=-1)
        assert np.all(tangential <= 0.8 * normal + 1e-6)


@pytest.mark.parametrize("how", ["silent", "stopped"])
def test_a_lost_hand_leaves_without_a_jump_at_the_person_and_says_so(how):
    team, feedback = Team(["left", "right"]), ForceFeedback(PERSON, lrp_hand_master(), PERSON, np.eye(3), 0.4)
    angles = np.array([0.4 if "abduction" not in joint else 0.2 for joint in PERSON.joints])
    torques, notices, ends = [], [], []
    for k in range(1500):
        now, lost = k * STEP, k >= 100
        at, cause = (0.4, "") if lost and how == "silent" else (now, "button" if lost else "")
        states = [hand_state(now, 1), hand_state(at, -1, cause=cause)]
        step = team.step(now, states, LOAD)
        assert step.is_balanced and total(step, states) == pytest.approx(LOAD, abs=1e-9)
        torques.append(feedback.torques(states[0], angles, step.shares[0].wrench))
        notices += step.notices
        ends.append(step)
    jumps = np.abs(np.diff(torques, axis=0)).max()
    assert 0 < jumps < 0.01
    assert np.abs(torques[-1] - torques[0]).max() > 0.01
    assert (
        len(notices) == 1
        and notices[0].startswith("right")
        and how[:4] in notices[0].replace("emergency stop", "stopped")
    )
    # At the end the other hand bears it all, and the object was lowered all the while.
    assert ends[-1].shares[0].wrench == pytest.approx(LOAD, abs=5e-3)
    assert ends[-1].shares[1].part == pytest.approx(np.exp(-1400 * STEP / FADING_TIME), rel=0.1)
    assert ends[-1].lowering == pytest.approx(LOWERING_SPEED * 1400 * STEP, rel=0.02)
    assert ends[99].lowering == 0 and 1500 * STEP > 5 * FADING_TIME


def test_a_hand_that_comes_back_is_named():
    team = Team(["left", "right"])
    team.step(0.0, [hand_state(0.0, 1), hand_state(0.0, -1)], LOAD)
    team.step(0.1, [hand_state(0.1, 1), hand_state(0.0, -1)], LOAD)
    assert team.step(0.2, [hand_state(0.2, 1), hand_state(0.2, -1)], LOAD).notices == ("right is back",)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"names": []}, "names is"),
        ({"names": ["a", "a"]}, "each once"),
        ({"names": ["a"], "friction": 0.0}, "friction is"),
        ({"names": ["a"], "max_silence": np.nan}, "max_silence is"),
    ],
)
def test_bad_teams_are_refused_by_name(arguments, message):
    with pytest.raises(ValueError, match=message):
        Team(**arguments)
