"""The first picture of a file's grasps contains contacts and arrows, whatever their size, beside the panel."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.view.drawing import Drawing, arrows, cones, dots, drawn_points
from jaxgrasp.view.viewer import EYE, Viewer

WIDTH, HEIGHT, PANEL = 1280, 820, 404
"""Of the window and of the words beside the scene [pixels]."""


def fitted_camera(points: np.ndarray) -> SimpleNamespace:
    viewer = Viewer.__new__(Viewer)
    viewer.server = SimpleNamespace(initial_camera=SimpleNamespace())
    viewer.fit(points)
    return viewer.server.initial_camera


def pixels_of(points: np.ndarray, camera: SimpleNamespace) -> tuple[np.ndarray, np.ndarray]:
    """Project points by a pinhole camera: pixels ``(P, 2)`` from the upper left, and depths ``(P,)``."""
    eye, at = np.array(camera.position), np.array(camera.look_at)
    forward = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(forward, camera.up)
    right /= np.linalg.norm(right)
    x, y, depth = np.stack([right, np.cross(right, forward), forward]) @ (points - eye).T
    focal = HEIGHT / 2 / np.tan(camera.fov / 2)
    return np.stack([WIDTH / 2 + focal * x / depth, HEIGHT / 2 - focal * y / depth], 1), depth


@pytest.mark.parametrize("size", [1e-3, 0.05, 1.0, 300.0])
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 0.1, 0), (0, 0, 1), (0.02, 1, 1)])
def test_all_points_are_in_the_picture_and_fill_it(size, shape):
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn = Rotation.random(random_state=rng)
        points = size * (turn.apply(rng.uniform(-1, 1, (9, 3)) * shape) + rng.normal(size=3))
        camera = fitted_camera(points)
        pixels, depths = pixels_of(points, camera)
        assert (depths > camera.near).all() and (depths < camera.far).all()
        assert (pixels > 0).all() and (pixels < [WIDTH - PANEL, HEIGHT]).all()
        # Seen from its longer side, the cloud takes a third of the picture's height or more.
        reach = np.linalg.norm(points - (points.min(0) + points.max(0)) / 2, axis=1).max()
        assert HEIGHT / 2.5 < 2 * reach / np.median(depths) * HEIGHT / 2 / np.tan(camera.fov / 2) < 1.1 * HEIGHT
        assert np.allclose(np.cross(np.array(camera.position) - camera.look_at, EYE), 0, atol=1e-9 * size * 1e3)


def test_a_lone_point_leaves_the_camera():
    assert fitted_camera(np.zeros((1, 3))) == fitted_camera(np.zeros((0, 3))) == SimpleNamespace()


def test_contacts_and_both_ends_of_visible_arrows_count():
    """An absent contact, an arrow of length zero and its head do not."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [50, 50, 50]])
    mask = np.array([True, True, False])
    vectors = np.array([[0, 0, 2.0], [0, -3.0, 0], [0, 0, 0]])
    grey = np.zeros((3, 3), np.uint8)
    drawn = Drawing(
        links=None,
        object_pose=np.eye(3, 4),
        moving=np.zeros((0, 3, 4)),
        contacts=dots(points, mask, 0.1, grey),
        cones=cones(points, np.tile([1.0, 0, 0], (3, 1)), np.zeros(3), mask, 0.5, grey),
        forces={"B": arrows(points, vectors, "#000000")},
        load=arrows(np.array([[0.5, 0, 0]]), np.array([[0, 4.0, 0]]), "#000000"),
        scale=None,
        origin=np.zeros(3),
    )
    found = drawn_points(drawn)
    for expected in ([0, 0, 0], [1, 0, 0], [0, 0, 2], [1, -3, 0], [0.5, 0, 0], [0.5, 4, 0], [1.5, 0, 0]):
        assert np.abs(found - expected).sum(1).min() < 1e-6, expected
    assert found.max() < 5
