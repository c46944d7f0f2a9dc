"""Contacts of the hands and grippers of grasp files, by the public function that the commands use."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxgrasp.hand import find_contacts, load_mesh, sphere_tree
from jaxgrasp.interop import GraspPoses, contacts_of_poses, gripper_by_name
from jaxgrasp.interop import posed_contacts as module
from jaxgrasp.model.hand import Pose, Posture

SIDE = 0.04
"""Side of the cube between the jaws [m]."""


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "cube.stl"
    trimesh.creation.box([SIDE] * 3).export(path)
    return sphere_tree(load_mesh(path), 5)


def poses(count: int, **columns) -> GraspPoses:
    """Return jaws above the cube, whose pads are about its middle."""
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, 2, 3] = -0.103
    return GraspPoses(Path("made.json"), tuple(map(str, range(count))), transforms, **columns)


def test_jaws_close_on_the_faces_of_a_cube_of_each_scale(tree, monkeypatch):
    monkeypatch.setattr(module, "CHUNK", 2)
    scales = np.array([1.0, 1.5, 1.0, 0.5, 1.5, 1.0])
    posed_contacts = contacts_of_poses(
        poses(6, scales=scales), gripper_by_name("franka").hand, tree, friction=np.arange(6) / 10, depth=1e-3
    )
    touching = posed_contacts.grasp.present > 0
    assert (
        posed_contacts.grasp.points.shape == (6, 8, 3)
        and not posed_contacts.is_inside.any()
        and posed_contacts.dropped == 0
    )
    assert touching.any(1).all()
    expected = np.broadcast_to(scales[:, None] * SIDE / 2, touching.shape)
    np.testing.assert_allclose(np.abs(posed_contacts.grasp.points[..., 0])[touching], expected[touching], atol=1.5e-3)
    inwards = -np.sign(posed_contacts.grasp.points[..., 0])
    np.testing.assert_allclose(posed_contacts.grasp.normals[..., 0][touching], inwards[touching], atol=0.05)
    np.testing.assert_allclose(
        posed_contacts.grasp.friction[touching], np.where(touching, np.arange(6)[:, None] / 10, 0)[touching]
    )


def test_posed_hands_touch_where_they_stand(tree):
    jaws = gripper_by_name("franka").hand
    angles = np.array([[0.02, 0.02], [0.0205, 0.0205], [0.0, 0.0]])
    posed_contacts = contacts_of_poses(poses(3, angles=angles), jaws, tree, max_contacts=4, stiffness=500.0)
    wrists = Pose(jnp.tile(jnp.array([0, 0, -0.103]), (3, 1)), jnp.tile(jnp.eye(3), (3, 1, 1)))
    direct = jax.device_get(
        find_contacts(jaws, Posture(wrists, jnp.array(angles)), tree, Pose(jnp.zeros(3), jnp.eye(3)))
    )
    count = (direct.present > 0).sum(1)
    assert count[1] > 4 and count[2] == 0
    np.testing.assert_array_equal((posed_contacts.grasp.present > 0).sum(1), np.minimum(count, 4))
    assert posed_contacts.dropped == np.maximum(count - 4, 0).sum()
    deepest = np.sort(np.where(direct.present > 0, direct.depths, 0), 1)[:, :-5:-1]
    np.testing.assert_allclose(
        np.sort(posed_contacts.grasp.squeeze * posed_contacts.grasp.present, 1)[:, ::-1], 500 * deepest, atol=1e-9
    )


@pytest.mark.slow
def test_objects_move_contacts_along(tree):
    jaws = gripper_by_name("franka").hand
    still = contacts_of_poses(poses(1), jaws, tree)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.3, -0.2, 0.1]
    with_objects = poses(1, objects=moved[None])
    carried = contacts_of_poses(replace(with_objects, transforms=moved @ with_objects.transforms), jaws, tree)
    expected = still.grasp.points @ moved[:3, :3].T + moved[:3, 3]
    touching = still.grasp.present > 0
    np.testing.assert_allclose(carried.grasp.points[touching], expected[touching], atol=1e-9)


def test_the_frame_of_a_gripper_that_closes_along_y_turns_its_jaws(tree):
    gripper = gripper_by_name("robotiq-2f-85", opening=0.06, pads=(0.0941, 0.1122), closes_along="y")
    made = poses(1)
    posed_contacts = contacts_of_poses(replace(made, transforms=made.transforms @ gripper.frame), gripper.hand, tree)
    touching = posed_contacts.grasp.present > 0
    np.testing.assert_allclose(np.abs(posed_contacts.grasp.normals[..., 1])[touching], 1, atol=0.05)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"stiffness": 0.0}, "stiffness is 0.0: expected a positive number"),
        ({"depth": -1.0}, "depth is -1.0: expected a positive number"),
        ({"max_contacts": 0}, "max_contacts is 0: expected at least 1"),
        ({"friction": np.ones(3)}, "friction has 3 entries: expected one, or 2"),
        ({"poses": poses(2, angles=np.zeros((2, 3)))}, "angles has 3 columns: expected 2"),
        ({"poses": poses(0)}, "poses is empty: expected at least one grasp"),
    ],
)
def test_bad_input_is_named(tree, change, message):
    arguments = {"poses": poses(2), "hand": gripper_by_name("franka").hand, "tree": tree} | change
    with pytest.raises(ValueError, match=message):
        contacts_of_poses(**arguments)


def test_an_unknown_gripper_is_named():
    with pytest.raises(ValueError, match="schunk"):
        gripper_by_name("schunk")
