"""``jaxgrasp contacts``: a box between jaws, and under a hand, from files of poses to a file of contacts."""

import re

import h5py
import numpy as np
import pytest
import trimesh

import jaxgrasp
from jaxgrasp.cli.main import main

WIDE = np.array([0.03, 0.05, 0.04])
QUICK = ("--levels", "4")


def poses(count: int = 3) -> np.ndarray:
    """Return hand poses with the box between the pads, each turned by another quarter about the approach direction."""
    transforms = np.tile(np.eye(4), (count, 1, 1))
    for i in range(count):
        turn = np.pi / 2 * i
        transforms[i, :2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    transforms[:, 2, 3] = -0.103
    return transforms


@pytest.fixture
def scene(folder):
    """Write a mesh in millimetres and files of both kinds that name it; return the folder."""
    (folder / "meshes").mkdir()
    trimesh.creation.box(1e3 * WIDE).export(folder / "meshes" / "box.obj")
    with h5py.File(folder / "poses.h5", "w") as file:
        file["grasps/transforms"] = poses()
        file["object/file"] = "meshes/box.obj"
        file["object/scale"], file["object/mass"], file["object/friction"] = 1e-3, 0.2, 0.7
        file["object/com"] = [0.0, 0.0, 0.004]
    np.savez(folder / "poses.npz", transforms=poses(), mesh="meshes/box.obj", scale=1e-3)
    return folder


@pytest.fixture
def run(scene, capsys):
    def call(*words: str) -> tuple[int, str]:
        status = main(["contacts", *words, *QUICK])
        captured = capsys.readouterr()
        return status, captured.out + captured.err

    return call


@pytest.mark.slow
def test_jaws_close_on_the_box_of_an_hdf5_file(run):
    status, output = run("poses.h5")
    assert status == 0, output
    grasps = jaxgrasp.load_grasps("contacts.npz")
    assert len(grasps) == 3 and np.all(grasps.sizes == 8) and "3 with 8" in output
    assert list(grasps.labels["name"]) == ["poses 0", "poses 1", "poses 2"]
    for i, axis in enumerate((0, 1, 0)):
        grasp = grasps.grasp(i)
        np.testing.assert_allclose(np.abs(grasp.points[:, axis]), WIDE[axis] / 2, atol=5e-4)
        np.testing.assert_allclose(np.sort(grasp.points[:, axis])[[0, -1]].sum(), 0, atol=2e-4)
        np.testing.assert_allclose(-grasp.normals[:, axis], np.sign(grasp.points[:, axis]), atol=0.02)
        # The jaws stop within a step of the depth that was asked for: K times it is the squeeze of the deepest.
        for jaw in (grasp.squeeze[:4], grasp.squeeze[4:]):
            assert 1.0 <= jaw.max() <= 1.08 and jaw.min() > 0
    np.testing.assert_allclose(grasps.friction, 0.7)
    np.testing.assert_allclose(grasps.wrench[:, 0], [[0, 0, 0.2 * 9.81, 0, 0, 0]] * 3, atol=1e-12)


@pytest.mark.slow
def test_more_grasps_than_are_worked_on_at_a_time(run, monkeypatch):
    assert run("poses.h5")[0] == 0
    grasps = jaxgrasp.load_grasps("contacts.npz")
    monkeypatch.setattr("jaxgrasp.interop.posed_contacts.CHUNK", 2)
    assert run("poses.h5")[0] == 0
    parts = jaxgrasp.load_grasps("contacts.npz")
    np.testing.assert_array_equal(parts.offsets, grasps.offsets)
    np.testing.assert_allclose(parts.points, grasps.points, atol=1e-12)
    assert list(parts.labels["name"]) == list(grasps.labels["name"])


@pytest.mark.slow
def test_what_the_user_says_goes_before_the_file(run):
    status, output = run(
        "poses.h5", "--friction", "0.3", "--mass", "1", "--gravity", "-9.81", "0", "0", "--out", "own.npz"
    )
    assert status == 0, output
    grasps = jaxgrasp.load_grasps("own.npz")
    np.testing.assert_allclose(grasps.friction, 0.3)
    # About the mesh's origin: the weight acts 4 mm above it.
    np.testing.assert_allclose(grasps.wrench[0, 0], [9.81, 0, 0, 0, 0.004 * 9.81, 0], atol=1e-12)


@pytest.mark.slow
def test_a_hands_posture_is_taken_as_it_is(scene, run):
    hand = jaxgrasp.hand.human_hand()
    transforms = np.tile(np.eye(4), (2, 1, 1))
    transforms[:, :3, 3] = [[-0.09, 0, 0.028], [-0.09, 0, 0.5]]
    np.savez("hand.npz", transforms=transforms, angles=np.zeros((2, len(hand.joints))))
    words = ("--mesh", "meshes/box.obj", "--scale", "1e-3", "--mass", "0.1", "--friction", "0.5")
    status, output = run("hand.npz", "--hand", "human-right", *words)
    assert status == 0, output
    grasps = jaxgrasp.load_grasps("contacts.npz")
    assert len(grasps) == 1 and grasps.sizes[0] > 2 and "left out: 1 that touch nothing (the first: 1)" in output
    status, output = run("hand.npz", "--hand", "human-right", *words, "--max-contacts", "2")
    assert f"dropped: {grasps.sizes[0] - 2} contacts beyond the deepest" in output
    limited_grasps = jaxgrasp.load_grasps("contacts.npz")
    assert limited_grasps.sizes[0] == 2
    np.testing.assert_allclose(np.sort(limited_grasps.squeeze), np.sort(grasps.squeeze)[-2:], rtol=1e-9)


@pytest.mark.slow
def test_a_file_of_misses_is_an_error(scene, run):
    np.savez(
        "far.npz", transforms=poses() + [[0, 0, 0, 9.0], *[[0] * 4] * 3], mesh="meshes/box.obj", mass=1, friction=1
    )
    status, output = run("far.npz", "--scale", "1e-3")
    assert status == 1 and "none of the 3 grasps can be used: left out: 3 that touch nothing" in output
    assert not (scene / "contacts.npz").exists()


@pytest.mark.slow
def test_a_gripper_that_starts_inside_is_left_out_and_named(scene, run):
    moved = poses()
    moved[1, :3, 3] += moved[1, :3, 0] * 0.045
    np.savez("moved.npz", transforms=moved, mesh="meshes/box.obj", scale=1e-3, mass=0.1, friction=0.5)
    status, output = run("moved.npz")
    assert status == 0 and "left out: 1 whose hand starts inside the object (the first: 1)" in output
    assert list(jaxgrasp.load_grasps("contacts.npz").labels["name"]) == ["moved 0", "moved 2"]


@pytest.mark.parametrize(
    "spoil, words",
    [
        ({"transforms": None}, "it has no transforms"),
        ({"transforms": np.eye(4)}, r"transforms has shape \(4, 4\): expected \(N, 4, 4\)"),
        (
            {"transforms": np.tile(2 * np.eye(4), (2, 1, 1))},
            r"transforms\[0\] is not a pose.* \(2 of 2 are not poses\)",
        ),
        ({"transforms": np.full((1, 4, 4), np.nan)}, r"transforms\[0, 0, 0\] is nan"),
        ({"transforms": np.full((1, 4, 4), "a")}, "transforms holds <U1: expected numbers"),
        ({"angles": np.zeros((2, 2))}, "angles has 2 rows: expected 3"),
        ({"angles": np.zeros((3, 5))}, "angles has 5 columns: expected 2, the joints of the jaw hand"),
        ({"mass": -1.0}, r"mass is \[?-1.0\]?: expected one number, 0 or more"),
        ({"mesh": "none.obj"}, "names the mesh 'none.obj', which is not beside it: give it by --mesh"),
        ({"mesh": None}, "no mesh: give it by --mesh"),
        ({"mass": None}, "does not say the object's mass: give it by --mass"),
    ],
)
def test_bad_files_are_refused_before_any_work(scene, run, spoil, words):
    fields = {"transforms": poses(), "mesh": "meshes/box.obj", "scale": 1e-3, "mass": 0.2, "friction": 0.7} | spoil
    np.savez("bad.npz", **{name: value for name, value in fields.items() if value is not None})
    status, output = run("bad.npz")
    assert status == 1 and len(output.strip().splitlines()) == 1
    assert re.search(words, output), output
    assert not (scene / "contacts.npz").exists()


@pytest.mark.parametrize(
    "words, expected",
    [
        (("none.npz",), "no such file; expected .npz, .h5 or .hdf5"),
        (("meshes/box.obj",), "box.obj ends in '.obj': expected .npz, .h5 or .hdf5"),
        (("poses.h5", "--depth", "0"), "depth is 0.0: expected a positive number"),
        (("poses.h5", "--out", "a.csv"), "expected a file that ends in .npz"),
    ],
)
def test_bad_arguments_are_refused(run, words, expected):
    status, output = run(*words)
    assert status == 1 and expected in output
