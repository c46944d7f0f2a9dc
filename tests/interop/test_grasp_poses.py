"""Files named by grasp files, found relative to these, and hands that touch with their meshes."""

import numpy as np
import pytest

from jaxgrasp.interop import GraspPoses, hand_from_mujoco, load_mjcf
from jaxgrasp.interop.file_records import find_named


def test_a_mesh_is_looked_for_beside_and_above_by_as_much_of_its_path_as_there_is(folder):
    for place in ("data/meshes/mug/thing.obj", "data/thing.obj", "other/mug/thing.obj"):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).touch()
    (folder / "data/grasps").mkdir()
    beside = folder / "data/grasps/some.npy"
    assert find_named("/far/meshes/mug/thing.obj", 1, beside) == folder / "data/meshes/mug/thing.obj"
    assert find_named("/far/away/mug/thing.obj", 1, beside) == folder / "data/thing.obj"
    assert find_named("/far/away/mug/thing.obj", 3, beside) is None
    assert find_named("/far/away/mug/thing.obj", 2, beside, folder / "other") == folder / "other/mug/thing.obj"
    for name in ("", "nothing.obj", "a/" * 10_000, "a" * 4000, "\0", "../../../../nothing"):
        assert find_named(name, 1, beside) is None


def test_rows_take_everything_that_belongs_to_a_grasp(folder):
    poses = GraspPoses(
        folder / "some.npy",
        ("a", "b", "c"),
        np.arange(48.0).reshape(3, 4, 4),
        np.arange(6.0).reshape(3, 2),
        np.arange(3.0),
        mesh="thing.obj",
        succeeded=np.array([True, False, True]),
    )
    chosen = poses.rows(np.array([2, 0]))
    assert chosen.names == ("c", "a") and chosen.scales.tolist() == [2, 0] and chosen.succeeded.all()
    np.testing.assert_array_equal(chosen.transforms, poses.transforms[[2, 0]])
    np.testing.assert_array_equal(chosen.angles, poses.angles[[2, 0]])
    assert chosen.mesh == "thing.obj" and chosen.objects is None


def test_meshes_touch_as_capsules(folder):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.capsule(0.08, 0.01).export(folder / "finger.stl")
    (folder / "hand.xml").write_text(
        """<mujoco><asset><mesh name="finger" file="finger.stl"/></asset><worldbody><body name="palm">
        <geom size="0.01"/><body name="finger"><joint name="bend" axis="0 1 0"/><geom type="mesh" mesh="finger"/></body>
        </body></worldbody></mujoco>"""
    )
    plain = hand_from_mujoco(load_mjcf("hand.xml"), "palm")
    assert [link.name for link in plain.hand.links] == ["palm"] and len(plain.left_out) == 1
    touching = hand_from_mujoco(load_mjcf("hand.xml", capsules=True), "palm")
    assert [link.name for link in touching.hand.links] == ["palm", "finger"] and touching.left_out == ()
    centers, radii = np.asarray(touching.hand.skin.centers)[1], np.asarray(touching.hand.skin.radii)[1]
    ends = np.array([centers - radii[:, None], centers + radii[:, None]])
    # The mesh is a capsule itself.
    np.testing.assert_allclose([ends[..., 2].min(), ends[..., 2].max()], [-0.05, 0.05], atol=2e-3)
    np.testing.assert_allclose(radii[radii > 0], 0.01, atol=5e-4)
