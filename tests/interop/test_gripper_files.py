"""Files of grippers with two jaws: Isaac Sim's, GraspGen's and ACRONYM's, each with the same grasps of a box."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.batch.sources import load_grasps
from jaxgrasp.cli.main import main
from jaxgrasp.interop import GraspPoses, read_acronym, read_graspgen, read_isaac_grasp
from tests.interop.two_fingers import SAMPLES, matrix

WIDE = 0.04
TURN = Rotation.from_euler("xyz", (0.3, -0.5, 0.7))


def grasps() -> np.ndarray:
    """Return poses of a Franka hand about a cube at the origin: from below, from a turned side, and far away."""
    below = np.array([0, 0, -0.103])
    quarter = Rotation.from_euler("x", 90, degrees=True)
    return np.stack(
        [matrix(below, Rotation.identity()), matrix(quarter.apply(below), quarter), matrix([0, 0, 9], TURN)]
    )


def isaac(path: Path, poses: np.ndarray, **changed: object) -> None:
    lines = ["format: isaac_grasp", "format_version: 1.0", "object_frame: /box", "gripper_frame: /hand", "grasps:"]
    for i, pose in enumerate(poses):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        entry = {
            "confidence": 1.0,
            "position": pose[:3, 3].tolist(),
            "orientation": {"w": w, "xyz": [x, y, z]},
            "cspace_position": {"right": 0.5, "left": 0.25},
        } | (changed if i == 1 else {})
        lines.append(f"  grasp_{i}: {json.dumps({k: v for k, v in entry.items() if v is not None})}")
    path.write_text("\n".join(lines))


def graspgen(path: Path, poses: np.ndarray, held: object = (True, False, True)) -> None:
    content = {
        "object": {"file": "meshes/box.stl", "scale": WIDE},
        "grasps": {"transforms": poses.tolist(), "object_in_gripper": held if held is None else list(held)},
    }
    path.write_text(json.dumps(content))


def acronym(path: Path, poses: np.ndarray) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["grasps/transforms"] = poses
        file["grasps/qualities/flex/object_in_gripper"] = [1, 0, 1]
        file["object/file"], file["object/scale"] = "meshes/box.stl", WIDE
        file["object/mass"], file["object/friction"], file["object/com"] = 0.2, 0.7, [0.0, 0.0, 0.004]


FORMATS: dict[str, tuple[str, Callable[[Path, np.ndarray], None], Callable[..., GraspPoses]]] = {
    "isaac-grasp": ("some.yaml", isaac, read_isaac_grasp),
    "graspgen": ("some.json", graspgen, read_graspgen),
    "acronym": ("some.h5", acronym, read_acronym),
}
EACH_FORMAT = pytest.mark.parametrize("name", FORMATS)


def file_of(folder: Path, name: str, poses: np.ndarray) -> str:
    if name == "isaac-grasp":
        pytest.importorskip("yaml")
    file, write, _ = FORMATS[name]
    write(folder / file, poses)
    return file


@EACH_FORMAT
def test_a_file_comes_back_as_it_was_written(folder, name):
    poses = FORMATS[name][2](file_of(folder, name, grasps()))
    np.testing.assert_allclose(poses.transforms, grasps(), atol=1e-12)
    assert poses.angles is None and poses.left_out == ()
    if name == "isaac-grasp":
        assert poses.names == ("grasp_0", "grasp_1", "grasp_2") and poses.scales is None and poses.mesh is None
    else:
        assert poses.scales.tolist() == [WIDE] * 3 and poses.mesh == "meshes/box.stl"
        assert poses.succeeded.tolist() == [True, False, True]


@EACH_FORMAT
def test_a_bad_pose_is_named_and_the_rest_go_on(folder, name):
    bad = grasps()
    bad[1, :3, 3] = np.nan
    if name == "isaac-grasp":
        pytest.importorskip("yaml")
        isaac(folder / "some.yaml", grasps(), position=[0, ".nan", 0])
        file = "some.yaml"
    else:
        file = file_of(folder, name, bad)
    read = FORMATS[name][2]
    with pytest.raises(ValueError, match="position|transforms") as caught:
        read(file)
    assert str(caught.value).startswith(file) and "1" in str(caught.value) and "\n" not in str(caught.value)
    poses = read(file, keep_going=True)
    assert [name[-1] for name in poses.names] == ["0", "2"] and len(poses.left_out) == 1


@pytest.mark.slow
@EACH_FORMAT
def test_jaws_close_on_opposite_faces(folder, name, capsys):
    trimesh = pytest.importorskip("trimesh")
    (folder / "meshes").mkdir()
    trimesh.creation.box((1, 1, 1)).export("meshes/box.stl")
    file = file_of(folder, name, grasps())
    words = ["--object", "meshes/box.stl", "--scale", str(WIDE)] if name == "isaac-grasp" else []
    assert main(["import", name, file, *words, "--levels", "4", "--friction", "0.3"]) == 0
    assert "left out: 1 that touch nothing (the first: 2)" in capsys.readouterr().out
    sets = load_grasps("grasps.npz")
    assert len(sets) == 2 and (sets.sizes == 8).all() and set(sets.friction) == {0.3}
    np.testing.assert_allclose(np.abs(sets.points[:, 0]), WIDE / 2, atol=1e-3)
    np.testing.assert_allclose(-sets.normals[:, 0], np.sign(sets.points[:, 0]), atol=0.05)
    weight, arm = (0.2, 0.004) if name == "acronym" else (0.1, 0)
    np.testing.assert_allclose(sets.wrench[0, 0], [0, 0, weight * 9.81, 0, 0, 0], atol=1e-9)
    if name != "isaac-grasp":
        assert main(["import", name, file, "--levels", "4", "--successful", "--out", "held.npz"]) == 0
        assert load_grasps("held.npz").labels["name"].tolist() == ["some 0"]
    if name == "graspgen":
        sideways = grasps() @ matrix(np.zeros(3), Rotation.from_euler("z", -90, degrees=True))
        graspgen(folder / "y.json", sideways)
        command = ["import", name, "y.json", "--closes-along", "y", "--levels", "4", "--out", "y.npz"]
        assert main(command) == 0
        np.testing.assert_allclose(load_grasps("y.npz").points, sets.points, atol=1e-9)


def test_joints_of_isaac_grasp_go_by_name(folder):
    pytest.importorskip("yaml")
    isaac(folder / "some.yaml", grasps())
    assert read_isaac_grasp("some.yaml", ("left", "right")).angles.tolist() == [[0.25, 0.5]] * 3
    with pytest.raises(
        ValueError, match="cspace_position has 'left', which the hand does not have.*; .* has no 'lefty'.*'left'"
    ):
        read_isaac_grasp("some.yaml", ("lefty", "right"))


@pytest.mark.parametrize(
    "text, message",
    [
        ("format: other", "some.yaml has the format 'other': expected 'isaac_grasp'"),
        ("format: isaac_grasp", "has no grasps: expected them by their names"),
        ("a: [", "some.yaml is not readable YAML: "),
        (
            "!!python/object/apply:os.system ['touch ran']",
            "is not readable YAML: could not determine a constructor",
        ),
        ("[" * 20_000, "some.yaml is not readable YAML: it is nested too deeply"),
        ("a: &a [1]\nb: [*a, *a]", "some.yaml is not readable YAML: it refers to parts of itself"),
        (
            "format: isaac_grasp\ngrasps: {a: {position: [0, 0, 0], orientation: {w: 2, xyz: [0, 0, 0]}}}",
            "the length 2",
        ),
        ("format: isaac_grasp\ngrasps: {a: {position: [0, 0, 0]}}", "grasp a: it has no 'orientation'"),
        ("format: isaac_grasp\ngrasps: {a: 3}", "grasp a: it is 3: expected fields by their names"),
    ],
)
def test_other_yaml_is_refused(folder, text, message):
    pytest.importorskip("yaml")
    (folder / "some.yaml").write_text(text)
    with pytest.raises(ValueError) as caught:
        read_isaac_grasp("some.yaml")
    assert message in str(caught.value) and "\n" not in str(caught.value) and not Path("ran").exists()


@pytest.mark.parametrize(
    "text, message",
    [
        ("{", "some.json is not JSON: "),
        ("[" * 100_000, "is nested too deeply: expected the JSON of"),
        ("3", "not a GraspGen file: it is 3: expected fields by their names"),
        ('{"object": {"file": "a", "scale": 0}, "grasps": {}}', "object.scale is 0: expected a positive number"),
        ('{"object": {"file": "a", "scale": 1}, "grasps": {"transforms": []}}', "expected a list of poses"),
        (
            '{"object": {"file": "a", "scale": 1}, "grasps": {"transforms": [1], "object_in_gripper": [2]}}',
            "object_in_gripper is [2]: expected 1 of true or false",
        ),
        ('{"object": {"file": "a", "scale": 1}, "grasps": {"transforms": [[[1], [2, 3]]]}}', "grasp 0: transforms is"),
    ],
)
def test_other_json_is_refused(folder, text, message):
    (folder / "some.json").write_text(text)
    with pytest.raises(ValueError) as caught:
        read_graspgen("some.json")
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"{SAMPLES.name} is not beside the project: ../shared/samples")
def test_the_projects_own_files_are_read():
    pytest.importorskip("h5py")
    (file,) = (SAMPLES / "acronym").glob("*.h5")
    poses = read_acronym(file)
    assert len(poses) == 2000 and poses.friction == 1.0 and poses.scales[0] == pytest.approx(2.6825e-4, rel=1e-4)
    # Every gripper looks at the mug: its way along z comes within the mug's size of the centre of mass.
    approach = poses.transforms[:, :3, 2]
    to_middle = poses.center_of_mass - poses.transforms[:, :3, 3]
    distance = np.linalg.norm(to_middle - np.sum(approach * to_middle, 1, keepdims=True) * approach, axis=1)
    assert distance.max() < 0.1 and (np.sum(approach * to_middle, 1) > 0).all()


@pytest.mark.slow
@pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"{SAMPLES.name} is not beside the project: ../shared/samples")
def test_a_robotiq_closes_along_x_on_a_can(folder):
    """Side grasps of a can 66 mm wide and 101 mm high: a gripper that opens by 85 mm cannot hold it the other way."""
    pytest.importorskip("yaml")
    trimesh = pytest.importorskip("trimesh")
    can = trimesh.creation.cylinder(radius=0.033, height=0.101)
    can.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    can.export("can.stl")
    file = str(SAMPLES / "isaac_grasp" / "robotiq_2f_85_grasps_soup_can.yaml")
    command = ["import", "isaac-grasp", file, "--object", "can.stl", "--gripper", "robotiq-2f-85", "--levels", "5"]
    sizes = {}
    for axis in "xy":
        assert main([*command, "--closes-along", axis, "--out", f"{axis}.npz"]) == 0
        sizes[axis] = load_grasps(f"{axis}.npz").sizes.tolist()
    assert sizes["x"] == [8] * 15 and len(sizes["y"]) < 15


def test_isaac_grasp_has_mesh_unit_and_success(folder):
    """Files as GraspDataGen writes them are read; a grasp whose confidence is 0 failed in simulation."""
    pytest.importorskip("yaml")
    isaac(folder / "some.yaml", grasps(), confidence=0.0)
    text = (folder / "some.yaml").read_text()
    (folder / "some.yaml").write_text(
        text.replace("grasps:", "object_file: meshes/box.stl\nobject_scale: 0.5\ngrasps:")
    )
    poses = read_isaac_grasp("some.yaml")
    assert poses.mesh == "meshes/box.stl" and poses.scales.tolist() == [0.5] * 3
    assert poses.succeeded.tolist() == [True, False, True]
    for scale, message in (("0", "positive"), ("[1, 1, 2]", "one scale for all three axes"), ("wide", "finite number")):
        (folder / "bad.yaml").write_text(text.replace("grasps:", f"object_scale: {scale}\ngrasps:"))
        with pytest.raises(ValueError, match=f"bad.yaml: object_scale .*{message}"):
            read_isaac_grasp("bad.yaml")


@pytest.mark.parametrize("number", ["1e-05", "-2E3", "+.5e-7", "1.e2"])
def test_numbers_of_yaml_1_2_are_read(number, folder):
    pytest.importorskip("yaml")
    isaac(folder / "some.yaml", grasps()[:1])
    text = (folder / "some.yaml").read_text()
    (folder / "some.yaml").write_text(text.replace("-0.103", number))
    assert read_isaac_grasp("some.yaml").transforms[0, 2, 3] == float(number)


def test_fields_of_isaac_grasp_that_are_not_used_are_named(folder):
    pytest.importorskip("yaml")
    isaac(folder / "some.yaml", grasps(), suction=3)
    with pytest.warns(UserWarning, match=r"some.yaml: fields that are not used: suction$"):
        read_isaac_grasp("some.yaml")
