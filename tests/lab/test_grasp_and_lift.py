"""The whole system in virtual time: contacts, forces, torques, a slow line, a cut cable, a person who arms it again."""

import jax
import numpy as np
import pytest

from jaxgrasp.cli.glove_run import trembling
from jaxgrasp.glove.model import GloveModel, lrp_hand_master
from jaxgrasp.grip import observe
from jaxgrasp.grip.scene_file import load_scene, scene_path
from jaxgrasp.hand import Posture, human_hand, joint_torques, pose_hand
from jaxgrasp.lab.glove_hand import felt_instant, glove_hand, resistance, resistance_of
from jaxgrasp.lab.grasp_and_lift import cylinder_scene, grasp_and_lift
from jaxgrasp.lab.haptic_loop import Haptics, pose_at
from jaxgrasp.lab.loaded_scene import loaded_scene
from jaxgrasp.report.glove_picture import write_glove_picture

MODEL = lrp_hand_master()


@pytest.fixture(scope="module")
def story():
    return grasp_and_lift()


@pytest.fixture(scope="module")
def scene():
    return cylinder_scene()


@pytest.mark.slow
def test_the_story(story, folder):
    closes, lifts, cut, again = (story.marks[name] for name in ("armed, closes", "lifts", "cable cut", "armed again"))
    during = lambda low, high: (story.times >= low) & (story.times < high)  # noqa: E731
    limits = np.array(MODEL.limits)
    assert np.all((story.torques >= 0) & (story.torques <= limits))
    assert not story.torques[during(0, closes)].any()
    assert story.torques[during(lifts, cut)].max() > 0.04
    # Rising no faster than its rate, at every millisecond; falling at once only when the cable is cut.
    steps = np.diff(story.torques, axis=0)
    assert steps.max() <= MODEL.rate * 0.001 + 1.01 * MODEL.quantum
    falls = story.times[1:][steps.min(1) < -MODEL.rate * 0.001 - 1.01 * MODEL.quantum]
    assert len(falls) == 1 and cut < falls[0] <= cut + 0.055
    assert not story.torques[during(cut + 0.055, again)].any()
    assert story.torques[during(again + 1.9, np.inf)].max() > 0.04
    heights = np.interp([lifts, cut], story.ticks, story.heights)
    assert abs(heights[0]) < 2e-3 and abs(heights[1] - 0.1) < 5e-3
    # What leaves is what was computed a moment ago, once the ramp is over.
    late = during(cut - 0.5, cut)
    requested = np.stack([np.interp(story.times[late], story.ticks, column) for column in story.requested.T], 1)
    np.testing.assert_allclose(story.torques[late], np.clip(requested, 0, limits), atol=3e-3)
    curves = (story.times, story.torques, story.angles, story.ticks, story.heights, story.marks)
    write_glove_picture(folder / "glove.png", MODEL.joints, *curves)
    assert (folder / "glove.png").stat().st_size > 20_000


@pytest.mark.slow
@pytest.mark.parametrize(("name", "baud", "trembles"), [("cylinder", 115_200, False), ("box", 115_200, True)])
def test_a_warning_says_where_an_object_feels_stiffer_than_the_line_renders(name, baud, trembles):
    """The warned of scene trembles in virtual time, the other does not."""
    gripped = loaded_scene(load_scene(scene_path(name)))
    haptics = Haptics(gripped.scene, MODEL, np.asarray(gripped.closed.angles), gripped.placed, gripped.law)
    warnings = trembling(haptics, baud, 100.0)
    assert bool(warnings) == trembles
    assert not trembles or f"a line of {baud} baud" in warnings[0]
    story = grasp_and_lift(scene=gripped, haptics=haptics)
    lifted = (story.times > story.marks["cable cut"] - 0.4) & (story.times < story.marks["cable cut"])
    spread = story.angles[lifted].std(0).max()
    assert spread > 3e-3 if trembles else spread < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("law", ["closed-form", "optimum"])
def test_the_slope_is_that_of_the_torques(scene, law):
    scene, closed, placed = scene
    gloved_hand = glove_hand(scene.hand, MODEL, np.asarray(closed.angles))
    angles = np.asarray(closed.angles)[list(gloved_hand.joint_indices)]
    at_rest = np.zeros(6)

    @jax.jit
    def felt(scene, angles):
        instant, touching = felt_instant(scene, gloved_hand, angles, closed.wrist, placed, at_rest, None)
        return resistance_of(gloved_hand, instant, touching, *instant.assess(law), law)

    torques, slope, *_ = jax.device_get(felt(scene, angles))
    observation = observe(scene, Posture(closed.wrist, closed.angles), placed, law=law)
    frames = pose_hand(scene.hand, closed)
    np.testing.assert_allclose(torques, -np.asarray(observation.torques)[list(gloved_hand.joint_indices)], atol=1e-12)
    by_force = joint_torques(scene.hand, frames, observation.contacts.points, observation.exerted)
    np.testing.assert_allclose(torques, MODEL.resisting(scene.hand.joints, np.asarray(by_force)), atol=1e-12)
    for k in range(14):
        # Of sixth order: within the step no finger may come to touch.
        moved = lambda m, k=k: np.asarray(  # noqa: E731
            resistance(scene, gloved_hand, angles + 2e-6 * m * np.eye(14)[k], closed.wrist, placed, law=law)
        )
        differences = sum(c * (moved(m) - moved(-m)) for m, c in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))) / 2e-6
        np.testing.assert_allclose(slope[:, k], differences, atol=1e-6 * np.abs(slope).max())


@pytest.mark.slow
def test_what_no_hand_can_be_is_not_valid(scene):
    scene, closed, placed = scene
    haptics = Haptics(scene, MODEL, np.asarray(closed.angles), placed)
    angles = np.asarray(closed.angles)[[scene.hand.joints.index(joint) for joint in MODEL.joints]]
    assert haptics.tick(0.0, angles, pose_at(np.zeros(3))).is_valid
    assert not haptics.tick(0.01, angles * np.nan, pose_at(np.zeros(3))).is_valid


def test_a_hand_that_is_not_the_gloves(unchecked):
    hand = human_hand()
    with pytest.raises(ValueError, match=r"fixed_angles has shape \(3,\): expected \(19,\)"):
        glove_hand(hand, MODEL, np.zeros(3))
    other_glove = GloveModel("other", ("index MPP",), (0.1,))
    with pytest.raises(ValueError, match="no joint 'index MPP', which other pulls on: did you mean 'index MP'"):
        glove_hand(hand, other_glove, np.zeros(19))
    assert glove_hand(hand, MODEL, np.zeros(19)).posture(np.ones(14), pose_at(np.zeros(3))).angles.sum() == 14
