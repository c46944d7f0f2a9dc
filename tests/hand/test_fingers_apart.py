"""Fingers that close do not pass through one another, where that is asked for."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.hand import Cylinder, Pose, Posture, close_hand, human_hand, pose_hand
from jaxgrasp.hand.human_hand import open_angles

HAND, WORLD = human_hand(), Pose(jnp.zeros(3), jnp.eye(3))
ROD = Cylinder(0.02, 0.12)


def deepest_overlap(posture: Posture) -> float:
    """Return the deepest overlap of two spheres of different fingers [m], by looping over links."""
    links = pose_hand(HAND, posture).links
    spheres = [
        (np.asarray(HAND.skin.centers[k]) @ np.asarray(links.rotation[k]).T + np.asarray(links.origin[k]), radii)
        for k, radii in enumerate(np.asarray(HAND.skin.radii))
    ]
    deepest = -np.inf
    for i, link in enumerate(HAND.links):
        for j, other_link in enumerate(HAND.links[:i]):
            if link.joint >= 0 and other_link.joint >= 0 and link.finger != other_link.finger:
                apart = np.linalg.norm(spheres[i][0][:, None] - spheres[j][0], axis=-1)
                is_sphere = (spheres[i][1][:, None] > 0) & (spheres[j][1] > 0)
                overlap = spheres[i][1][:, None] + spheres[j][1] - apart
                deepest = max(deepest, overlap[is_sphere].max())
    return deepest


def test_fingers_stop_where_they_meet():
    """On the way to angles at which they would be in one another; no deeper than a step goes."""
    steps = 100
    posture, far = Posture(WORLD, jnp.asarray(open_angles(HAND))), Pose(jnp.array([0.0, 0.0, -1.0]), jnp.eye(3))
    through, _ = close_hand(HAND, posture, ROD, far, towards=HAND.upper, steps=steps)
    stopped, _ = close_hand(HAND, posture, ROD, far, towards=HAND.upper, steps=steps, fingers_apart=True)
    np.testing.assert_allclose(through.angles, HAND.upper, rtol=1e-12)
    assert deepest_overlap(through) > 0.01
    # A fingertip is no further from any of its joints than the hand is long; three of them turn at most.
    step = 3 * 0.19 * float(jnp.max(HAND.upper - posture.angles)) / steps
    assert deepest_overlap(stopped) < step
    assert (np.asarray(stopped.angles) <= np.asarray(through.angles) + 1e-12).all()


@pytest.mark.slow
def test_fingers_that_do_not_meet_close_as_before():
    posture, below = (
        Posture(WORLD, jnp.asarray(open_angles(HAND))),
        Pose(jnp.array([0.09, 0.0, -0.045]), jnp.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])),
    )
    alone, together = (close_hand(HAND, posture, ROD, below, fingers_apart=apart)[0] for apart in (False, True))
    assert deepest_overlap(alone) < 0
    np.testing.assert_array_equal(alone.angles, together.angles)
