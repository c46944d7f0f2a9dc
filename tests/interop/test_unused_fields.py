"""Fields of other projects' files that no reader uses are named, once for all files of a kind."""

import json
import warnings

import numpy as np
import pytest

from jaxgrasp.interop.acronym import read_acronym
from jaxgrasp.interop.bodex import read_bodex
from jaxgrasp.interop.dexgraspbench import read_dexgraspbench
from jaxgrasp.interop.dexgraspnet import read_dexgraspnet
from jaxgrasp.interop.dexonomy import read_dexonomy
from jaxgrasp.interop.grasp_fields import read_npz_poses
from jaxgrasp.interop.graspgen import read_graspgen
from jaxgrasp.interop.isaac_grasp import read_isaac_grasp
from tests.interop import test_bodex, test_dexgraspbench, test_dexgraspnet, test_dexonomy, test_gripper_files
from tests.interop.test_dexgraspbench import hand  # noqa: F401, a fixture
from tests.interop.two_fingers import pickled, written

h5py = pytest.importorskip("h5py")


def write_acronym(path, **more):
    with h5py.File(path, "w") as file:
        file["grasps/transforms"] = np.eye(4)[None]
        file["object/inertia"] = np.eye(3)
        for name, value in more.items():
            file[name] = value
    return path


def write_graspgen(path, **more):
    record = {"object": {"file": "mug.obj", "scale": 1.0}, "grasps": {"transforms": [np.eye(4).tolist()], **more}}
    path.write_text(json.dumps(record))
    return path


@pytest.mark.parametrize(
    "read, write, file, kind, name",
    [
        (read_acronym, write_acronym, "mug.h5", "ACRONYM", "object_pose"),
        (read_graspgen, write_graspgen, "mug.json", "GraspGen", "grasps.confidence"),
    ],
)
def test_a_field_that_is_not_used_is_named(tmp_path, read, write, file, kind, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(write(tmp_path / file))
    with pytest.warns(UserWarning, match=f"^{kind}: fields that are not used: {name}$"):
        read(write(tmp_path / file, **{name.removeprefix("grasps."): [1.0]}))


def says_unused(kind, name):
    return pytest.warns(UserWarning, match=f"^{kind}: fields that are not used: {name}$")


def test_dexgraspnets_energies_are_named_and_the_start_of_the_search_is_not(folder):
    """A record as ``generate_grasps.py`` writes it, before validation; a validated one has ``qpos`` and ``scale``."""
    validated = test_dexgraspnet.record(0.02, -0.02)
    written("validated.npy", validated, validated)
    read_dexgraspnet("validated.npy", ("left", "right"))
    energies = dict.fromkeys(("energy", "E_fc", "E_dis", "E_pen", "E_spen", "E_joints"), 0.1)
    written("found.npy", validated, validated | {"qpos_st": validated["qpos"]} | energies)
    with says_unused("DexGraspNet", "E_dis, E_fc, E_joints, E_pen, E_spen, energy"):
        read_dexgraspnet("found.npy", ("left", "right"))


def gripped(**other):
    """Return a BODex record with every field that ``save_helper.py`` writes, and a table beside the gripped object."""
    record = test_bodex.record()
    ((_, mesh),) = record["world_cfg"][0]["mesh"].items()
    return record | {
        "world_cfg": [{"mesh": {"cube": mesh, "table": mesh | {"file_path": "table.obj"}}}],
        "manip_name": ["cube"],
        "obj_code": ["cube"],
        "obj_pose": np.array([mesh["pose"]]),
        "obj_scale": np.array([0.07]),
        "obj_path": ["/far/away/cube/mesh/simplified.obj"],
        "pene_error": np.zeros((1, 3)),
        **other,
    }


def test_bodex_tells_the_gripped_object_from_a_table(folder):
    pickled("some.npy", gripped())
    records = read_bodex("some.npy")
    np.testing.assert_array_equal(records.scales, np.full((3, 3), 0.07))
    np.testing.assert_allclose(records.objects[:, :3, 3], [test_bodex.OBJECT[0]] * 3)
    np.testing.assert_allclose(records.objects[0, :3, :3], test_bodex.OBJECT[1].as_matrix(), atol=1e-12)
    assert records.mesh == "/far/away/cube/mesh/simplified.obj"
    pickled("more.npy", gripped(gravity=1.0))
    with says_unused("BODex", "gravity"):
        read_bodex("more.npy")


@pytest.mark.parametrize(
    "field, value, message",
    [
        ("obj_scale", np.array([0.0]), r"obj_scale is \[0.0\]: expected positive numbers"),
        ("obj_scale", np.array([1.0, 2.0]), r"obj_scale has the shape \(2,\)"),
        ("obj_pose", np.zeros((1, 6)), r"obj_pose has the shape \(1, 6\)"),
        ("obj_path", ["a", "b"], "obj_path is .*: expected 1, one for each b"),
    ],
)
def test_a_bad_object_of_bodex_is_named(folder, field, value, message):
    pickled("bad.npy", gripped(**{field: value}))
    with pytest.raises(ValueError, match=f"bad.npy is not a BODex file: {message}"):
        read_bodex("bad.npy")


def test_dexonomys_own_fields_are_known(folder):
    """Fields of ``gen_init.py`` and of its contacts out of MuJoCo, which say nothing about forces."""
    names = ("hand_name", "tmpl_name", "hand_cbody", "required_cbody", "n_evo", "scene_path", "hand_type", "scene_cfg")
    record = test_dexonomy.balanced() | dict.fromkeys(names, "any")
    record["ho_c"]["bn2"] = ["object"] * 3
    pickled("one.npy", record)
    read_dexonomy("one.npy")
    record["ho_c"]["friction"] = np.ones(3)
    pickled("more.npy", record | {"obj_mass": 0.2})
    with says_unused("Dexonomy", "ho_c.friction, obj_mass"):
        read_dexonomy("more.npy")


def test_dexgraspbench_takes_the_root_from_a_field_of_its_own_and_success(hand):  # noqa: F811
    whole = test_dexgraspbench.grasp()
    pickled("whole.npy", whole)
    measures = dict.fromkeys(
        ("ho_pene", "self_pene", "contact_num", "contact_dist", "contact_consis", "qp_metric"), 0.1
    )
    split = {
        f"{name}_{part}": values
        for name in ("pregrasp", "grasp", "squeeze")
        for part, values in (("pose", whole[f"{name}_qpos"][:7]), ("qpos", whole[f"{name}_qpos"][7:]))
    }
    evaluated = whole | split | measures | {"succ_flag": np.bool_(False), "delta_pos": 0.1, "delta_angle": 1.0}
    pickled("split.npy", evaluated)
    for posture in ("grasp", "squeeze"):
        expected, poses = (read_dexgraspbench(f"{name}.npy", hand, posture=posture) for name in ("whole", "split"))
        np.testing.assert_array_equal(poses.transforms, expected.transforms)
        np.testing.assert_array_equal(poses.angles, expected.angles)
        assert expected.succeeded is None and poses.succeeded.tolist() == [False]
    pickled("more.npy", evaluated | {"obj_mass": 0.2})
    with says_unused("DexGraspBench", "obj_mass"):
        read_dexgraspbench("more.npy", hand)
    for name, value, message in (
        ("succ_flag", 0.5, "succ_flag is .*: expected true or false"),
        ("grasp_pose", np.zeros(6), r"grasp_pose has the shape \(1, 6\): expected \(1, 7\)"),
    ):
        pickled("bad.npy", evaluated | {name: value})
        with pytest.raises(ValueError, match=f"bad.npy is not a DexGraspBench grasp: {message}"):
            read_dexgraspbench("bad.npy", hand)


def test_a_gripper_that_does_not_look_along_z_is_named(folder):
    """``approach_axis`` of GraspDataGen: grasps along x would be taken for grasps along z."""
    pytest.importorskip("yaml")
    test_gripper_files.isaac(folder / "some.yaml", test_gripper_files.grasps())
    text = (folder / "some.yaml").read_text()
    known = "created_with: grasp_sim\ncreated_at: 2025-08-01\napproach_axis: {}\ngrasps:"
    (folder / "along_z.yaml").write_text(text.replace("grasps:", known.format(2)))
    read_isaac_grasp("along_z.yaml")
    (folder / "along_x.yaml").write_text(text.replace("grasps:", known.format(0)))
    with pytest.warns(UserWarning, match="along_x.yaml: approach_axis is 0, and is not used: .* look along z"):
        read_isaac_grasp("along_x.yaml")


def test_arrays_of_a_file_of_poses_that_are_not_used_are_named(folder):
    np.savez("poses.npz", transforms=np.eye(4)[None], mas=0.2)
    with says_unused("poses", "mas"):
        read_npz_poses(folder / "poses.npz")
