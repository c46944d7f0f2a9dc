"""DexGraspNet's files: small ones of the same layout, and where it is there the data set's own."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.batch.sources import load_grasps
from jaxgrasp.cli.main import main
from jaxgrasp.interop import hand_from_mujoco, load_mjcf, read_dexgraspnet
from tests.interop.two_fingers import JOINTS, model, written
from tests.interop.two_fingers import SAMPLES as EVERY_SAMPLE

SAMPLES = EVERY_SAMPLE / "dexgraspnet"
HAND = model()


def record(left: float, right: float, place=(0.0, 0.0, 0.0), turns=(0.0, 0.0, 0.0), scale: float = 0.07) -> dict:
    qpos = {"right": right, "left": left}
    qpos |= {f"WRJT{axis}": value for axis, value in zip("xyz", place, strict=True)}
    qpos |= {f"WRJR{axis}": value for axis, value in zip("xyz", turns, strict=True)}
    return {"qpos": qpos, "scale": np.array(scale)}


@pytest.fixture
def files(folder) -> Path:
    """Write a hand of two fingers, a cube of edge 1 and four grasps of it at 70 mm: pinched, turned, away."""
    trimesh = pytest.importorskip("trimesh")
    (folder / "hand.xml").write_text(HAND)
    trimesh.creation.box((1, 1, 1)).export(folder / "cube.stl")
    below, turns = np.array([0.0, 0.0, -0.06]), (0.3, -0.5, 0.7)
    turned = Rotation.from_euler("xyz", turns).as_matrix() @ below
    quarter = Rotation.from_euler("xyz", (np.pi / 2, 0, 0)).as_matrix() @ below
    written(
        folder / "grasps.npy",
        record(0.02, -0.02, below),
        record(0.02, -0.02, quarter, (np.pi / 2, 0.0, 0.0)),
        record(0.02, -0.02, turned, turns),
        record(0.0, 0.0, (0, 0, 1.0)),
    )
    return folder


def test_joints_go_by_name_and_turns_about_fixed_axes(files):
    data_set = read_dexgraspnet("grasps.npy", JOINTS)
    np.testing.assert_array_equal(data_set.angles[:3], [[0.02, -0.02]] * 3)
    np.testing.assert_allclose(
        data_set.transforms[2, :3, :3], Rotation.from_euler("xyz", (0.3, -0.5, 0.7)).as_matrix(), atol=1e-15
    )
    np.testing.assert_allclose(data_set.transforms[0, :3, 3], [0, 0, -0.06])
    assert data_set.scales.tolist() == [0.07] * 4 and data_set.names == ("0", "1", "2", "3")
    turned = read_dexgraspnet("grasps.npy", JOINTS[::-1])
    np.testing.assert_array_equal(turned.angles, data_set.angles[:, ::-1])


@pytest.mark.slow
def test_a_pinch_is_imported_with_contacts_that_face_each_other(files, capsys):
    command = ["import", "dexgraspnet", "grasps.npy", "--hand", "hand.xml", "--object", "cube.stl", "--out", "out.npz"]
    assert main(command) == 0
    assert "left out: 1 that touch nothing" in capsys.readouterr().out
    # The cube does not turn with the last hand, whose fingers run through it.
    with pytest.warns(UserWarning, match=r"normals of 1 of 3 grasps point away .*\('grasps 2'\)"):
        sets = load_grasps("out.npz")
    assert sets.labels["name"].tolist() == ["grasps 0", "grasps 1", "grasps 2"]
    assert set(sets.labels["source"]) == {"DexGraspNet"} and set(sets.labels["hand"]) == {"hand"}
    for grasp in (sets[0], sets[1]):
        assert grasp.points.shape == (2, 3)
        np.testing.assert_allclose(grasp.normals[0], -grasp.normals[1], atol=0.05)
        # The cube's faces are 35 mm from its middle, of which the balls leave out a little.
        np.testing.assert_allclose(np.abs(grasp.points[:, 0]), 0.035, atol=1.5e-3)
        assert (np.sum(grasp.points * grasp.normals, -1) < 0).all()


@pytest.mark.slow
def test_sizes_of_the_object_keep_the_order_of_the_file(files):
    below = (0.0, 0.0, -0.06)
    sizes = [0.07, 0.06, 0.07]
    written(files / "sizes.npy", *(record(a, -a, below, scale=s) for a, s in zip((0.02, 0.09, 0.02), sizes)))
    assert main(["import", "dexgraspnet", "sizes.npy", "--hand", "hand.xml", "--object", "cube.stl"]) == 0
    sets = load_grasps("grasps.npz")
    assert sets.labels["name"].tolist() == ["sizes 0", "sizes 1", "sizes 2"]
    for i, size in enumerate(sizes):
        np.testing.assert_allclose(np.abs(sets[i].points[:, 0]), size / 2, atol=2e-3)


@pytest.mark.parametrize(
    "bad, message",
    [
        ({"qpos": {}}, "record 1: it has no qpos and scale"),
        ("text", "record 1: it has no qpos and scale"),
        (record(np.nan, 0.0), "record 1: left is nan: expected a finite number"),
        (record(0.0, 0.0, scale=-1.0), "record 1: scale is -1: expected a positive number"),
        (record(0.0, np.zeros(3)), "record 1: right is [0. 0. 0.]: expected a finite number"),
        (
            {"qpos": record(0, 0)["qpos"] | {"rihgt": 0.0}, "scale": 1},
            "qpos has 'rihgt', which the hand does not have: did",
        ),
        ({"qpos": {"left": 0.0}, "scale": 1}, "record 1: qpos has no 'right', which the hand has"),
    ],
)
def test_a_bad_record_is_named_and_the_rest_go_on(folder, bad, message):
    written(folder / "some.npy", record(0.1, 0.2), bad, record(0.3, 0.4))
    with pytest.raises(ValueError) as caught:
        read_dexgraspnet("some.npy", JOINTS)
    assert str(caught.value).startswith("some.npy: ") and message in str(caught.value)
    data_set = read_dexgraspnet("some.npy", JOINTS, keep_going=True)
    assert data_set.names == ("0", "2") and len(data_set.left_out) == 1 and message in data_set.left_out[0]


def test_what_is_wrong_with_the_command_is_said_in_one_line(folder, capsys):
    (folder / "hand.xml").write_text(HAND)
    (folder / "broken.xml").write_text("<mujoco><worldbody><body")
    written(folder / "some.npy", record(0.1, 0.2))
    (folder / "cube.stl").write_text("solid nothing\nendsolid nothing\n")
    for hand, mesh, message in (
        ("nowhere.xml", "cube.stl", "nowhere.xml: no such file"),
        ("broken.xml", "cube.stl", "expected an MJCF file, but it is not XML"),
        ("hand.xml", "cube.stl", "cube.stl"),
    ):
        assert main(["import", "dexgraspnet", "some.npy", "--hand", hand, "--object", mesh]) == 1
        error = capsys.readouterr().err
        assert message in error and error.count("\n") == 1


def test_a_models_needless_parts_are_left_out(folder):
    (folder / "hand.xml").write_text(HAND)
    hand = hand_from_mujoco(load_mjcf("hand.xml"), "palm").hand
    assert hand.joints == JOINTS and [link.name for link in hand.links] == ["palm", "left finger", "right finger"]


@pytest.mark.slow
@pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"{SAMPLES.name} is not beside the project: ../shared/samples")
@pytest.mark.filterwarnings("ignore:.*pieces of the mesh overlap or touch", "ignore:.*normals of .* point away")
@pytest.mark.parametrize("name", ["core-mug", "sem-Bottle"])
def test_the_data_sets_grasps_touch_their_object(folder, name, capsys):
    """All hands of the file touch the mesh only if joints, rotations, frames and scales are read correctly."""
    (file,) = SAMPLES.glob(f"{name}*.npy")
    hand = SAMPLES / "mjcf" / "shadow_hand_wrist_free.xml"
    command = ["import", "dexgraspnet", str(file), "--hand", str(hand), "--object", str(file.with_suffix(".obj"))]
    assert main([*command, "--levels", "5", "--out", "out.npz"]) == 0
    sets = load_grasps("out.npz")
    assert len(sets) >= 0.98 * len(np.load(file, allow_pickle=True))
    assert np.mean(sets.sizes) > 5
