"""Files for other programs: what is written is read back, by our readers and as the formats' own users read it."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxgrasp
from jaxgrasp import Grasp, Verdict
from jaxgrasp.batch.sources import save_grasps
from jaxgrasp.cli.main import main
from jaxgrasp.interop import (
    GraspPoses,
    hold_confidence,
    judged_by_margin,
    read_graspgen,
    read_isaac_grasp,
    write_graspgen,
    write_isaac_grasp,
)
from jaxgrasp.interop.isaac_grasp import joints_of_isaac_grasp
from jaxgrasp.quality import hold_margin
from jaxgrasp.testing.problems import problems
from tests.interop.two_fingers import SAMPLES

JOINTS = ("left", "right", "yes")
COUNT, N = 40, 4
NAMES = ("grasp_0", "0", "yes", "1e-5", "Tasse, links: ü", "#", "two\nlines", *map(str, range(7, COUNT)))
FIELDS = ("transforms", "angles", "scales", "succeeded", "confidence")


def poses(**changed: object) -> GraspPoses:
    rng = np.random.default_rng(0)
    transforms = np.tile(np.eye(4), (COUNT, 1, 1))
    turns = Rotation.random(COUNT, rng=rng).as_matrix()
    # Half turns, whose quaternions have a real part of zero.
    turns[:3] = [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.eye(3)]
    transforms[:, :3, :3], transforms[:, :3, 3] = (
        turns,
        rng.normal(size=(COUNT, 3)) * 10.0 ** rng.integers(-9, 2, COUNT)[:, None],
    )
    fields: dict = {
        "angles": rng.normal(size=(COUNT, 3)) * 1e-5,
        "scales": np.full(COUNT, 0.00026),
        "mesh": "meshes/mug: a.obj",
        "confidence": rng.uniform(size=COUNT),
        "succeeded": np.ones(COUNT, bool),
    }
    return GraspPoses(Path("some.npz"), NAMES, transforms, **(fields | changed))


def assert_same(read: GraspPoses, written: GraspPoses, *left_out: str) -> None:
    for name in FIELDS:
        value, expected = getattr(read, name), getattr(written, name)
        if name in left_out or expected is None:
            assert value is None
        else:
            np.testing.assert_allclose(value, expected, rtol=0, atol=1e-14)
    assert read.mesh == written.mesh


def test_isaac_grasp_is_read_back(folder):
    pytest.importorskip("yaml")
    write_isaac_grasp("some.yaml", poses(), JOINTS)
    read = read_isaac_grasp("some.yaml", JOINTS)
    assert_same(read, poses())
    assert read.names == NAMES and joints_of_isaac_grasp("some.yaml") == JOINTS
    with pytest.warns(UserWarning, match="isaac_grasp: not in the file: mass, angles"):
        write_isaac_grasp("plain.yaml", poses(mass=0.1, confidence=None, succeeded=None, scales=None, mesh=None))
    read = read_isaac_grasp("plain.yaml")
    assert read.succeeded is None and read.confidence is None and joints_of_isaac_grasp("plain.yaml") == ()
    labels = np.arange(COUNT) % 2 == 0
    write_isaac_grasp("some.yaml", poses(succeeded=labels, confidence=None), JOINTS)
    read = read_isaac_grasp("some.yaml", JOINTS)
    np.testing.assert_array_equal(read.succeeded, labels)
    np.testing.assert_array_equal(read.confidence, labels)


def test_isaac_grasp_is_plain_to_a_reader_of_yaml_1_1(folder):
    """Numbers with an exponent are numbers there too, joints of the open hand have the same names, and no name is
    another type."""
    yaml = pytest.importorskip("yaml")
    write_isaac_grasp("some.yaml", poses(), JOINTS, open_angles=np.array([1e-5, 0, 2.0]))
    content = yaml.safe_load(Path("some.yaml").read_text("utf-8"))
    assert content["format"] == "isaac_grasp" and content["format_version"] == 1.0
    assert tuple(content["grasps"]) == NAMES
    for grasp in content["grasps"].values():
        numbers = [grasp["confidence"], *grasp["position"], grasp["orientation"]["w"], *grasp["orientation"]["xyz"]]
        assert all(type(number) is float for number in (*numbers, *grasp["cspace_position"].values()))
        assert grasp["pregrasp_cspace_position"] == {"left": 1e-5, "right": 0.0, "yes": 2.0}
        assert tuple(grasp["cspace_position"]) == JOINTS


def test_graspgen_is_read_back_as_its_documentation_reads_it(folder):
    labels = np.arange(COUNT) % 3 == 0
    with pytest.warns(UserWarning, match="GraspGen: not in the file: angles, confidence, names"):
        write_graspgen("some.json", poses(succeeded=labels))
    assert_same(read_graspgen("some.json"), poses(succeeded=labels), "angles", "confidence")
    content = json.loads(Path("some.json").read_text())
    transforms, mask = np.array(content["grasps"]["transforms"]), np.array(content["grasps"]["object_in_gripper"])
    assert mask.dtype == bool and transforms[mask].shape == (labels.sum(), 4, 4)
    assert content["object"] == {"file": "meshes/mug: a.obj", "scale": 0.00026}


def test_poses_in_a_world_become_poses_in_the_objects_frame(folder):
    pytest.importorskip("yaml")
    objects = np.roll(poses().transforms, 1, 0)
    world = objects @ poses().transforms
    write_isaac_grasp("some.yaml", replace(poses(), transforms=world, objects=objects), JOINTS)
    np.testing.assert_allclose(read_isaac_grasp("some.yaml").transforms, poses().transforms, atol=1e-12)


@pytest.mark.parametrize("file", ["ur_robotiq_grasps_sim_angled.yaml", "robotiq_2f_85_grasps_soup_can.yaml"])
def test_a_file_of_isaac_sim_is_written_again(folder, file):
    pytest.importorskip("yaml")
    path = SAMPLES / "isaac_grasp" / file
    if not path.exists():
        pytest.skip(f"{SAMPLES} is not there")
    joints = joints_of_isaac_grasp(path)
    first = read_isaac_grasp(path, joints)
    write_isaac_grasp("again.yaml", first, joints)
    again = read_isaac_grasp("again.yaml", joints)
    assert again.names == first.names
    assert_same(again, first)


def test_confidence_grows_with_the_margin_and_is_a_half_where_a_grasp_begins_to_hold():
    eps = np.finfo(np.float64).eps
    margins = np.array([-1, -0.1, -eps, 0, eps, 1e-3, 0.5, 1, 2, 2.5])
    confidence = hold_confidence(margins)
    assert (np.diff(confidence) >= 0).all() and ((confidence >= 0.5) == (margins > 0)).all()
    assert ((confidence > 0) == (margins > 0)).all() and confidence[-1] == 1
    np.testing.assert_allclose(4 * confidence[4:9] - 2, margins[4:9], atol=eps)
    with pytest.raises(ValueError, match=r"margin\[1\] is nan: expected a number"):
        hold_confidence(np.array([1.0, np.nan]))


@pytest.mark.slow
def test_the_command_says_of_each_grasp_what_the_optimum_says(folder, capsys):
    """Of grasps with friction and nearly without; poses without contacts are left out, and the line says so."""
    yaml = pytest.importorskip("yaml")
    problem = problems("ordinary", N, COUNT, seed=3)
    friction = problem.friction * np.where(np.arange(COUNT) % 2, 1, 0.02)[:, None]
    wrench, grasp = problem.wrench, Grasp(problem.points, problem.normals, friction, problem.squeeze)
    kept = np.arange(COUNT) != 5
    np.savez("some.npz", transforms=poses().transforms, mesh="mug.obj", scale=1.0)
    rows = [f"some {i}" for i in range(COUNT)]
    save_grasps("contacts.npz", grasp, wrench, name=rows)
    assert main(["export", "isaac-grasp", "some.npz", "--contacts", "contacts.npz"]) == 0
    said = capsys.readouterr().out
    verdict = np.asarray(jaxgrasp.constrained_optimum(grasp, wrench).verdict)
    held = np.isin(verdict, [Verdict.CLOSED_FORM_OPTIMAL, Verdict.OPTIMAL, Verdict.FEASIBLE])
    assert 5 < held.sum() < COUNT - 5
    assert f"{COUNT} grasps, {held.sum()} of them held according to the hold margin" in said
    read = read_isaac_grasp("grasps.yaml")
    np.testing.assert_array_equal(read.confidence >= 0.5, held)
    np.testing.assert_array_equal(read.succeeded, held)
    np.testing.assert_allclose(read.confidence, hold_confidence(np.asarray(hold_margin(grasp, wrench))), atol=1e-12)
    assert type(yaml.safe_load(Path("grasps.yaml").read_text())["grasps"]["5"]["confidence"]) is float
    few = [row for row, keep in zip(rows, kept, strict=True) if keep] + ["another"]
    save_grasps("contacts.npz", grasp, wrench, name=[*few])
    with pytest.warns(UserWarning, match="GraspGen: not in the file: confidence, names"):
        assert main(["export", "graspgen", "some.npz", "--contacts", "contacts.npz"]) == 0
    said = capsys.readouterr().out
    assert "left out: 1 poses without contacts in contacts.npz (the first: '5')" in said
    assert len(read_graspgen("grasps.json")) == COUNT - 1


BAD = {
    r"poses.transforms\[2\]\[0, 0\] is nan": {
        "transforms": lambda a: np.where(np.arange(COUNT)[:, None, None] == 2, np.nan, a)
    },
    r"poses.transforms\[0\] is not a pose": {"transforms": lambda a: 2 * a},
    r"poses.transforms\[0\] has the shape \(3, 3\)": {"transforms": lambda a: a[:, :3, :3]},
    r"poses.scales\[1\] is 1: expected 0.00026 as of \[0\]": {
        "scales": lambda a: np.where(np.arange(COUNT) == 1, 1, a)
    },
    r"poses.scales has the shape \(3,\)": {"scales": lambda a: a[:3]},
    r"poses.succeeded is float64": {"succeeded": lambda a: a.astype(float), "confidence": lambda a: None},
    r"poses.names has 2 entries: expected 40": {"names": lambda a: a[:2]},
    r"poses.names\[1\] is 'grasp_0', as is \[0\]": {"names": lambda a: ("grasp_0", *a[:1], *a[2:])},
    "poses is empty": {name: (lambda a: a[:0]) for name in (*FIELDS, "names")},
}
OF_ISAAC = {
    r"poses.confidence\[3\] is 1.5: expected a number from 0 to 1": {
        "confidence": lambda a: np.where(np.arange(COUNT) == 3, 1.5, a)
    },
    r"poses.angles\[7, 1\] is inf": {
        "angles": lambda a: np.where((np.arange(COUNT) == 7)[:, None] & (np.arange(3) == 1), np.inf, a)
    },
    r"poses.angles has the shape \(40, 2\): expected \(40, 3\)": {"angles": lambda a: a[:, :2]},
    r"joints names 3 joints, but poses.angles is None": {"angles": lambda a: None},
}


@pytest.mark.parametrize("message", [*BAD, *OF_ISAAC])
def test_bad_poses_are_named_and_the_file_that_is_there_stays(folder, unchecked, message):
    pytest.importorskip("yaml")
    good = poses()
    bad = replace(good, **{name: change(getattr(good, name)) for name, change in (BAD | OF_ISAAC)[message].items()})
    writers = [
        ("a.yaml", lambda path: write_isaac_grasp(path, bad, JOINTS)),
        ("a.json", lambda path: write_graspgen(path, bad)),
    ]
    for path, write in writers[: 1 if message in OF_ISAAC else 2]:
        Path(path).write_text("there before")
        with pytest.raises(ValueError, match=message):
            write(path)
        assert Path(path).read_text() == "there before" and len(list(folder.glob("*.partial"))) == 0


def test_arguments_that_cannot_be_used_are_named(folder):
    pytest.importorskip("yaml")
    for call, message in {
        lambda: write_isaac_grasp(
            "a.json", poses(), JOINTS
        ): "path is a.json: expected a name that ends in .yaml or .yml",
        lambda: write_isaac_grasp("a.yaml", poses(), ("a", "a", "b")): "joints has 'a' twice",
        lambda: write_isaac_grasp(
            "a.yaml", poses(), JOINTS, open_angles=np.zeros(2)
        ): r"open_angles has the shape \(2,\)",
        lambda: write_isaac_grasp("a.yaml", poses(), open_angles=np.zeros(3)): "open_angles were given without joints",
        lambda: write_graspgen("a.json", poses(mesh=None)): "poses.mesh is None",
        lambda: write_graspgen("a.json", poses(succeeded=None)): "poses.succeeded is None",
        lambda: judged_by_margin(poses(), np.zeros(3)): r"margin has shape \(3,\): expected \(40,\)",
        lambda: judged_by_margin(poses(), np.full(COUNT, np.nan)): r"margin\[0\] is nan",
    }.items():
        with pytest.raises(ValueError, match=message):
            call()
    with pytest.raises(OSError, match=r"missing"), pytest.warns(UserWarning, match="not in the file"):
        write_graspgen("missing/a.json", poses())
    assert not list(folder.iterdir())


@pytest.mark.parametrize("name", ["graspgen", "isaac-grasp", "lerobot"])
def test_help_of_each_format_comes_without_jax(name):
    code = (
        "import sys, jaxgrasp.cli.main as m\n"
        f"try: m.main(['export', '{name}', '--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "assert not {'jax', 'numpy'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert f"jaxgrasp export {name}" in done.stdout and "--out" in done.stdout


@pytest.mark.parametrize(
    "words, message",
    [
        (("graspgen", "nowhere.npz"), "nowhere.npz: no such file"),
        (("graspgen", "some.npz", "--out", "a.yaml"), "out is a.yaml: expected a file that ends in .json"),
        (("graspgen", "some.npz"), "some.npz names no mesh, which the format requires: give its path by --mesh"),
        (
            ("graspgen", "some.npz", "--mesh", "a.obj"),
            "some.npz does not say which grasps hold: give their contacts by",
        ),
        (("isaac-grasp", "some.txt"), "some.txt ends in '.txt': expected .npz, .h5, .hdf5, .json, .yaml or .yml"),
        (("isaac-grasp", "some.npz", "--joints", "a"), "joints names 1 joints, but poses.angles is None"),
        (("isaac-grasp", "some.npz", "--out", "some.txt/a.yaml"), "out is some.txt, where nothing can be written"),
        (
            ("isaac-grasp", "some.npz", "--contacts", "other.npz"),
            "other.npz has no grasp named 'some 0', but such as 'b'",
        ),
        (
            ("isaac-grasp", "some.npz", "--contacts", "bare.npz"),
            "bare.npz has no names: expected contacts of these poses",
        ),
    ],
)
def test_what_is_wrong_is_said_in_one_line(folder, words, message, capsys):
    pytest.importorskip("yaml")
    np.savez("some.npz", transforms=poses().transforms)
    Path("some.txt").write_text("text")
    problem = problems("ordinary", N, 1, seed=0)
    grasp = Grasp(problem.points, problem.normals, problem.friction, problem.squeeze)
    save_grasps("other.npz", grasp, problem.wrench, name=["b"])
    save_grasps("bare.npz", grasp, problem.wrench)
    before = set(folder.iterdir())
    assert main(["export", *words]) == 1
    error = capsys.readouterr().err
    assert message in error and error.startswith("jaxgrasp: ") and error.count("\n") == 1
    assert set(folder.iterdir()) == before
