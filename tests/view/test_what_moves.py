"""Further objects, and obstacles that move, are drawn where they are, not where they began."""

import numpy as np
import pytest

from jaxgrasp.grip.motion import Body
from jaxgrasp.grip.scene import Obstacle, ObstaclePath, Scene
from jaxgrasp.hand import Box, Pose, parallel_jaw, rigid_body, sphere_tree
from jaxgrasp.report.surfaces import shape_surface
from jaxgrasp.view.drawing import drawing
from jaxgrasp.view.live_scene import moving_poses, moving_surfaces, standing_surfaces
from jaxgrasp.view.viewer import Viewer
from jaxgrasp.view.viewer_server import serving
from tests.view.test_drawing import solved_grasp

SHAPE = Box(0.06, 0.08, 0.05)


def scene() -> Scene:
    """Return a scene with a fixed wall and a board that rises and turns for two seconds."""
    path = ObstaclePath(
        np.array([1.0, 3.0]), np.array([[0.0, 0, 0], [0, 0, 0.2]]), np.array([[0.0, 0, 0], [0, 0, 1.0]])
    )
    at = Pose(np.array([0.3, 0.0, 0.0]), np.eye(3))
    obstacles = (Obstacle(SHAPE, at, 2e3), Obstacle(SHAPE, at, 2e3, path=path))
    table, hand = Pose(np.array([0.0, 0.0, -0.6]), np.eye(3)), parallel_jaw()
    links, gravity = np.ones(len(hand.links)), np.array([0.0, 0.0, -9.81])
    outline = rigid_body(sphere_tree(SHAPE, 1))
    return Scene(hand, Body(SHAPE, 0.1), table, 0.5, 2e3, links, gravity, obstacles=obstacles, outline=outline)


def test_what_moves_is_where_its_path_has_it_and_stands_nowhere():
    made = scene()
    assert len(standing_surfaces(made, Pose(np.zeros(3), np.eye(3)))) == 1 and len(moving_surfaces(made)) == 1
    for time, share in ((0.0, 0.0), (1.0, 0.0), (2.0, 0.5), (9.0, 1.0)):
        (pose,) = moving_poses(made, time)
        turn = [[np.cos(share), -np.sin(share), 0], [np.sin(share), np.cos(share), 0], [0, 0, 1]]
        np.testing.assert_allclose(pose, np.c_[turn, [0.3, 0, 0.2 * share]], atol=1e-12)


def test_the_viewer_draws_each_of_them_there():
    pytest.importorskip("viser", reason="the live scene needs viser")
    poses = np.stack([np.c_[np.eye(3), [0.1, 0.2, 0.3]], np.c_[np.diag([1.0, -1, -1]), [0.4, 0.5, 0.6]]])
    surface = shape_surface(SHAPE)
    with serving(port=0) as server:
        viewer = Viewer(server, object_surface=surface, other_surfaces=[surface], moving=[surface])
        viewer.show(drawing(solved_grasp(moving=poses)))
        for handle, pose in zip(viewer._moving, poses, strict=True):
            np.testing.assert_allclose(handle.position, pose[:, 3])
        np.testing.assert_allclose(np.abs(viewer._moving[1].wxyz), [0, 1, 0, 0], atol=1e-12)
