"""DexGraspBench's files: small ones of the same layout, and where they are there the benchmark's own."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.batch.sources import load_grasps
from jaxgrasp.cli.main import main
from jaxgrasp.interop import hand_from_mujoco, load_mjcf, read_dexgraspbench
from jaxgrasp.model.hand import Hand
from tests.interop.two_fingers import (
    BELOW,
    PALM,
    PINCH,
    SAMPLES,
    SIZE,
    matrix,
    model,
    on_opposite_faces,
    pickled,
    seven,
)

OBJECT = (np.array([0.3, -0.2, 0.1]), Rotation.from_euler("xyz", (0.4, -0.3, 0.9)))


@pytest.fixture
def hand(folder) -> Hand:
    (folder / "hand.xml").write_text(model(PALM))
    return hand_from_mujoco(load_mjcf("hand.xml", capsules=True), "world").hand


def grasp(angles=PINCH, **changes: object) -> dict:
    """Return a pinch from below of the cube where it stands in the world; the file's root is the model's world."""
    place, turn = OBJECT
    root = seven(place + turn.apply(BELOW - [0, 0, PALM]), turn)
    qpos = np.concatenate([root, angles]).astype(np.float32)
    return {
        "obj_pose": seven(place, turn),
        "obj_scale": SIZE,
        "obj_path": "assets/cube",
        **{f"{name}_qpos": qpos for name in ("pregrasp", "grasp", "squeeze")},
    } | changes


def test_poses_are_in_the_world_and_joints_in_the_models_order(hand):
    pickled("one.npy", grasp(squeeze_qpos=grasp((0.03, -0.04))["grasp_qpos"]))
    data_set = read_dexgraspbench("one.npy", hand)
    place, turn = OBJECT
    np.testing.assert_allclose(
        data_set.transforms[0], matrix(place + turn.apply(BELOW - [0, 0, PALM]), turn), atol=1e-6
    )
    np.testing.assert_allclose(data_set.objects[0], matrix(place, turn), atol=1e-12)
    np.testing.assert_allclose(data_set.angles, [PINCH], atol=1e-8)
    assert hand.joints == ("left", "right") and data_set.scales.tolist() == [SIZE]
    assert data_set.mesh == "assets/cube/mesh/simplified.obj"
    np.testing.assert_allclose(
        read_dexgraspbench("one.npy", hand, posture="squeeze").angles, [[0.03, -0.04]], atol=1e-8
    )


@pytest.mark.slow
def test_forward_kinematics_puts_the_fingers_on_the_cube(folder, hand, capsys):
    trimesh = pytest.importorskip("trimesh")
    (folder / "data/assets/cube/mesh").mkdir(parents=True)
    trimesh.creation.box((1, 1, 1)).export("data/assets/cube/mesh/simplified.obj")
    pickled("one.npy", grasp())
    command = ["import", "dexgraspbench", "one.npy", "--hand", "hand.xml", "--object", "data", "--levels", "5"]
    assert main([*command, "--mass", "0.2"]) == 0
    sets = load_grasps("grasps.npz")
    on_opposite_faces(sets.points, sets.normals, matrix(*OBJECT))
    force = 0.2 * 9.81
    np.testing.assert_allclose(sets.wrench[0, 0], [0, 0, force, -0.2 * force, -0.3 * force, 0], atol=1e-9)
    assert sets.labels["object"].tolist() == ["cube"] and sets.labels["name"].tolist() == ["one 0"]


SWAPPED = grasp((1.2, -0.02))


@pytest.mark.parametrize(
    "bad, message",
    [
        ([1, 2], "not a DexGraspBench grasp: it is .* expected fields by their names"),
        ({"grasp_qpos": np.zeros(9)}, "not a DexGraspBench grasp: it has no 'obj_pose'"),
        (grasp(obj_pose=np.zeros(7)), r"obj_pose\[3:\] has the length 0: expected a unit quaternion w, x, y, z"),
        (grasp(obj_scale=-1.0), "obj_scale is -1: expected a positive number"),
        (grasp(grasp_qpos=np.full(9, np.nan)), r"record 0: grasp_qpos\[0\] is nan: expected a finite number"),
        (grasp(grasp_qpos=np.zeros(29)), "grasp_qpos has 29 numbers: expected 9, the root's 7 and the hand's 2 joints"),
        (SWAPPED, r"grasp_qpos\[7:\]\[0\] is 1.2, but the hand's 'left' goes from -1 to 1: is it this hand"),
    ],
)
def test_a_bad_file_is_named(hand, bad, message):
    pickled("bad.npy", bad)
    with pytest.raises(ValueError, match=message) as caught:
        read_dexgraspbench("bad.npy", hand)
    assert str(caught.value).startswith("bad.npy") and "\n" not in str(caught.value)


def test_bad_postures_among_good_ones_are_left_out_and_said(hand):
    rows = np.stack([grasp()["grasp_qpos"], SWAPPED["grasp_qpos"]])
    pickled("several.npy", grasp(grasp_qpos=rows))
    data_set = read_dexgraspbench("several.npy", hand, keep_going=True)
    assert len(data_set) == 1 and len(data_set.left_out) == 1 and "several.npy: record 1: " in data_set.left_out[0]


@pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"{SAMPLES.name} is not beside the project: ../shared/samples")
def test_the_benchmarks_own_files_stay_within_the_shadow_hands_limits(folder):
    """In the order of MuJoCo Menagerie's Shadow hand, whose limits these are, and in no order of the thumb first."""
    finger = [("J4", -0.349, 0.349), ("J3", -0.262, 1.571), ("J2", 0, 1.571), ("J1", 0, 1.571)]
    thumb = [
        ("J5", -1.047, 1.047),
        ("J4", 0, 1.222),
        ("J3", -0.209, 0.209),
        ("J2", -0.698, 0.698),
        ("J1", -0.262, 1.571),
    ]
    names = [(f"{name}{joint}", *limits) for name in ("FF", "MF", "RF") for joint, *limits in finger]
    names += [("LFJ5", 0, 0.785), *((f"LF{joint}", *limits) for joint, *limits in finger)]
    thumb = [(f"TH{joint}", *limits) for joint, *limits in thumb]

    def chain(joints: list) -> Hand:
        bodies = "".join(
            f'<body><joint name="{name}" range="{low} {high}"/><geom size="0.01"/>' for name, low, high in joints
        )
        xml = f'<mujoco><compiler angle="radian"/><worldbody>{bodies}{"</body>" * len(joints)}</worldbody></mujoco>'
        (folder / "chain.xml").write_text(xml)
        return hand_from_mujoco(load_mjcf("chain.xml"), "world").hand

    right, wrong, refused = chain(names + thumb), chain(thumb + names), 0
    files = sorted((SAMPLES / "dexgraspbench").glob("*.npy"))
    for file in files:
        assert len(read_dexgraspbench(file, right)) == 1
        try:
            read_dexgraspbench(file, wrong)
        except ValueError:
            refused += 1
    assert len(files) == 20 and refused == 20
