"""Contacts of solids: distances against MuJoCo's, patches against known areas."""

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from jaxgrasp.hand import Box, Capsule, Cylinder, Plane, Pose, Sphere, sphere_tree
from jaxgrasp.world.mujoco_model import primitive
from jaxgrasp.world.solids import manifold_between, solid_of, table_manifold

SHAPES = [Box(0.06, 0.05, 0.04), Sphere(0.02), Cylinder(0.02, 0.06), Capsule(0.015, 0.05)]


def distance(shapes, placed) -> float:
    """Return MuJoCo's distance of the shapes."""
    spec = mujoco.MjSpec()
    for k, (shape, pose) in enumerate(zip(shapes, placed, strict=True)):
        quaternion = Rotation.from_matrix(pose.rotation).as_quat()[[3, 0, 1, 2]]
        body = spec.worldbody.add_body(name=str(k), pos=pose.origin, quat=quaternion)
        body.add_freejoint()
        kind, size = primitive(mujoco, shape)
        body.add_geom(type=kind, size=size)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return mujoco.mj_geomDistance(model, data, 0, 1, 1.0, np.zeros(6))


def some_poses(seed: int, apart: float) -> list[Pose]:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    turns = Rotation.random(2, random_state=seed).as_matrix()
    return [Pose(np.zeros(3), turns[0]), Pose(apart * direction / np.linalg.norm(direction), turns[1])]


@pytest.mark.parametrize("second", SHAPES, ids=lambda shape: type(shape).__name__)
@pytest.mark.parametrize("first", SHAPES, ids=lambda shape: type(shape).__name__)
def test_solids_are_as_far_apart_as_mujoco_has_them(first, second):
    """Solids moved until MuJoCo has them 50 micrometres deep are that deep here; a rim is found to 0.2 mm."""
    straight = not any(isinstance(shape, Cylinder) for shape in (first, second))
    for seed in range(12):
        placed = some_poses(seed, 0.055)
        for _ in range(30):
            off = distance((first, second), placed) + 5e-5
            placed[1] = Pose(placed[1].origin * (1 - off / np.linalg.norm(placed[1].origin)), placed[1].rotation)
            if abs(off) < 1e-9:
                break
        patch = manifold_between(solid_of(first, placed[0]), solid_of(second, placed[1]), 1e-3)
        assert patch.gap == pytest.approx(distance((first, second), placed), abs=2e-6 if straight else 2e-4)
        assert np.linalg.norm(patch.normal) == pytest.approx(1) and len(patch.points)
        for shape, pose, sign in ((first, placed[0], 1), (second, placed[1], -1)):
            # No contact is further along the normal than a solid reaches, but for half of its own gap.
            solid = solid_of(shape, pose)
            reach = solid.reach(-sign * patch.normal[None])[0] - 5e-5
            halfway = np.maximum(patch.gaps, 0) / 2
            assert np.all(-sign * (patch.points - pose.origin) @ patch.normal <= reach + halfway + 1e-4)


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, 1.2])
def test_faces_touch_where_they_overlap(angle):
    """The patch of two square faces, one turned on the other: its area against a count of places in both."""
    box, turn = Box(0.06, 0.06, 0.04), Rotation.from_rotvec([0, 0, angle]).as_matrix()
    upper, lower = Pose(np.array([0.01, 0.005, 0.04]), turn), Pose(np.zeros(3), np.eye(3))
    patch = manifold_between(solid_of(box, upper), solid_of(box, lower), 1e-4)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.03, 0.03, 400)] * 2), -1).reshape(-1, 2)
    local = (grid - upper.origin[:2]) @ turn[:2, :2]
    shared = np.all(np.abs(local) <= 0.03, 1).mean() * 0.06**2
    assert ConvexHull(patch.points[:, :2]).volume == pytest.approx(shared, rel=0.03)
    np.testing.assert_allclose(patch.points[:, 2], 0.02, atol=1e-9)
    np.testing.assert_allclose(patch.normal, [0, 0, 1], atol=1e-12)
    assert abs(patch.gap) < 1e-12


def test_a_lying_cylinder_touches_along_a_line_and_a_standing_one_all_around():
    ground, shape = Pose(np.zeros(3), np.eye(3)), Cylinder(0.02, 0.06)
    lying = table_manifold(
        solid_of(shape, Pose(np.array([0, 0, 0.02]), Rotation.from_rotvec([np.pi / 2, 0, 0]).as_matrix())), ground
    )
    standing = table_manifold(solid_of(shape, Pose(np.array([0, 0, 0.03]), np.eye(3))), ground)
    np.testing.assert_allclose(sorted(lying.points.tolist()), [[0, -0.03, 0], [0, 0.03, 0]], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(standing.points[:, :2], axis=1), 0.02)
    assert len(standing.points) == 8 and abs(standing.gap) < 1e-12


@pytest.mark.slow
def test_a_tree_touches_by_its_balls():
    box = Box(0.04, 0.04, 0.04)
    tree = solid_of(sphere_tree(box, 3), Pose(np.array([0, 0, 0.04]), np.eye(3)))
    patch = manifold_between(tree, solid_of(box, Pose(np.zeros(3), np.eye(3))), 1e-2)
    # Its balls lie inside the solid that it stands for.
    assert 0 <= patch.gap < 5e-3 and abs(patch.normal[2]) == pytest.approx(1)


def test_what_has_no_end_is_no_solid():
    with pytest.raises(ValueError, match="a solid is a Plane: expected a Sphere, Box, Cylinder, Capsule or SphereTree"):
        solid_of(Plane(), Pose(np.zeros(3), np.eye(3)))
