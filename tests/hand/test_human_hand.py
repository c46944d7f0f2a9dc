"""The human hand: its measures, its limits, its mirror image, and how rough its skin of spheres is."""

import numpy as np
import pytest

from jaxgrasp.hand import Pose, Posture, human_hand, mirrored, pose_hand
from tests.hand.hands import random_posture

HAND = human_hand(length=0.2, breadth=0.09)
FLAT = Posture(Pose(np.zeros(3), np.eye(3)), np.zeros(19))


def link(name: str) -> int:
    return [link.name for link in HAND.links].index(name)


def skin(hand, frames) -> np.ndarray:
    """Return all spheres' centres in the world ``(..., L, m, 3)``."""
    turned = np.einsum("...lij,lmj->...lmi", frames.links.rotation, hand.skin.centers)
    return turned + np.asarray(frames.links.origin)[..., None, :]


def test_it_has_the_gloves_joints():
    kinds = [name.split()[1] for name in HAND.joints]
    assert len(kinds) == 19 and kinds.count("abduction") == 5
    assert {"MP": 5, "PIP": 4, "DIP": 4, "IP": 1}.items() <= {kind: kinds.count(kind) for kind in kinds}.items()
    assert (np.asarray(HAND.lower) < np.asarray(HAND.upper)).all()
    assert len(HAND.links) == 19 and len({link.name for link in HAND.links}) == 19


def test_a_flat_hand_measures_what_was_asked_for():
    spheres = skin(HAND, pose_hand(HAND, FLAT))
    tips = (spheres[..., 0] + np.asarray(HAND.skin.radii)).max(-1)
    # The published shares of the middle finger add up to 0.99 of the hand's length.
    assert tips[link("middle distal")] == pytest.approx(0.99 * 0.2, rel=1e-12)
    assert tips.argmax() == link("middle distal")
    knuckles = spheres[[link("index palm"), link("little palm")], -1, 1]
    assert np.ptp(knuckles) == pytest.approx((0.251 + 0.402) * 0.09, rel=1e-12)


def test_hands_scale_with_their_length():
    small, large = human_hand(0.1), human_hand(0.2)
    np.testing.assert_allclose(2 * small.origins, large.origins, rtol=1e-15)
    np.testing.assert_allclose(2 * small.skin.centers, large.skin.centers, atol=1e-16)
    np.testing.assert_allclose(2 * small.skin.radii, large.skin.radii, rtol=1e-15)


def test_flexion_bends_all_fingertips_towards_the_palm():
    angles = np.array([0.0 if "abduction" in name else 0.6 for name in HAND.joints])
    bent = pose_hand(HAND, Posture(FLAT.wrist, angles))
    flat = pose_hand(HAND, FLAT)
    tips = [link(f"{finger} distal") for finger in ("index", "middle", "ring", "little")]
    assert (np.asarray(bent.links.origin - flat.links.origin)[tips, 2] < -0.02).all()
    # The thumb faces the fingers: it bends across the palm, to the little finger's side.
    assert (bent.links.origin - flat.links.origin)[link("thumb distal"), 1] < -0.01


def test_abduction_spreads_the_fingers_and_lifts_the_thumb():
    angles = np.array([0.2 if "abduction" in name else 0.0 for name in HAND.joints])
    moved = np.asarray(pose_hand(HAND, Posture(FLAT.wrist, angles)).links.origin - pose_hand(HAND, FLAT).links.origin)
    for finger, sign in (("index", 1), ("middle", 1), ("ring", -1), ("little", -1)):
        assert sign * moved[link(f"{finger} distal"), 1] > 0.005
    assert moved[link("thumb distal"), 2] < -0.005


def test_a_left_hand_is_the_right_ones_mirror_image():
    left, posture = human_hand(0.2, 0.09, side="left"), random_posture(HAND, 20)
    flip = np.array([1.0, -1.0, 1.0])
    wrist = Pose(posture.wrist.origin * flip, flip[:, None] * posture.wrist.rotation * flip)
    right = skin(HAND, pose_hand(HAND, posture))
    np.testing.assert_allclose(skin(left, pose_hand(left, Posture(wrist, posture.angles))), right * flip, atol=1e-15)
    np.testing.assert_allclose(mirrored(left).axes, HAND.axes, atol=0)


def test_the_skin_is_scalloped_by_less_than_half_a_millimetre():
    hand = human_hand()
    gap = np.linalg.norm(np.diff(hand.skin.centers, axis=1), axis=-1)
    radius = np.minimum(hand.skin.radii[:, 1:], hand.skin.radii[:, :-1])
    assert (radius - np.sqrt(radius**2 - gap**2 / 4)).max() < 0.5e-3


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"length": 0.0}, "length is 0.0: expected a positive number of metres"),
        ({"length": float("nan")}, "length is nan"),
        ({"breadth": -0.1}, "breadth is -0.1"),
        ({"side": "both"}, "side is 'both': expected 'right' or 'left'"),
    ],
)
def test_bad_measures_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        human_hand(**arguments)
