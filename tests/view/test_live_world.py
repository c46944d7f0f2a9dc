"""Several objects followed by sliders: what is seen is what table and objects leave to the hand, and time goes on."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip.monitor import Hold
from jaxgrasp.grip.scene_file import gripped_scene, load_scene, ready_scenes
from jaxgrasp.view.live_page import LivePage
from jaxgrasp.view.live_world import LiveWorld
from jaxgrasp.view.viewer_server import serving
from jaxgrasp.world import world_of

pytestmark = pytest.mark.slow
G = 9.81


@pytest.fixture(scope="module")
def hand() -> LiveWorld:
    file = load_scene(ready_scenes()["stack"])
    made = gripped_scene(file)
    return LiveWorld(made, *world_of(file, made), "optimum")


def test_at_rest_the_blocks_bear_the_ball_and_heavier_ones_too(hand):
    first, opened = hand.initial_controls(), np.asarray(hand.gripped.open)
    for mass in (first.mass, 3 * first.mass):
        picture = hand.look(first._replace(mass=mass, angles=opened))
        np.testing.assert_allclose(picture.wrench, 0, atol=1e-4 * mass * G)
        assert not picture.touching.any() and len(picture.moving) == 2


def test_time_goes_on_the_ball_goes_with_the_hand_and_the_blocks_stay(hand):
    first = hand.initial_controls()
    hand.reset()
    for k in range(30):
        picture = hand.step(first._replace(lift=np.array([0, 0, 0.001 * k])), 1 / 30)
    assert int(picture.assessment.hold) == Hold.STABLE
    rise = picture.object_pose[2, 3] - float(hand.gripped.placed.origin[2])
    assert rise == pytest.approx(0.028, abs=2e-3)
    start = hand.initial_followed.placed
    np.testing.assert_allclose(picture.moving[:, :, 3], start.origin[1:], atol=1e-4)
    opened = first._replace(lift=np.array([0, 0, 0.03]), angles=np.asarray(hand.gripped.open))
    for _ in range(20):
        picture = hand.step(opened, 1 / 30)
    assert not picture.touching.any()
    # It lies on the blocks again, or has rolled off them: nothing holds it up there.
    assert picture.object_pose[2, 3] < float(hand.gripped.placed.origin[2]) + 0.01
    hand.reset()
    picture = hand.step(first, 1 / 30)
    np.testing.assert_allclose(picture.object_pose[:, 3], jnp.asarray(hand.gripped.placed.origin), atol=1e-9)
    np.testing.assert_allclose(picture.moving[:, :, 3], start.origin[1:], atol=1e-9)


def test_the_page_draws_all_of_them_and_moves_them_with_its_sliders(hand):
    pytest.importorskip("viser", reason="the live scene needs viser")
    hand.reset()
    with serving(port=0) as server:
        page = LivePage(server, hand, runs=True)
        page.frame()
        assert len(page.viewer._moving) == 2
        for _ in range(5):
            page.set(lift=5.0)
            page.frame(1 / 30)
        for handle, origin in zip(page.viewer._moving, hand.initial_followed.placed.origin[1:], strict=True):
            np.testing.assert_allclose(handle.position, origin, atol=1e-4)
