"""BODex's files: grasps of a tetrahedron's faces, by the layout of its own code."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.batch.sources import load_grasps
from jaxgrasp.cli.main import main
from jaxgrasp.interop import read_bodex
from tests.interop.two_fingers import pickled, seven

OBJECT = (np.array([0.3, -0.2, 0.1]), Rotation.from_euler("xyz", (0.4, -0.3, 0.9)))
B, N, M, P = 1, 3, 2, 4


def record(**changes: object) -> dict:
    """Return a record whose contact frames, in the world, have the pressing normal as their first column."""
    rng = np.random.default_rng(7)
    frames = Rotation.random(B * N * P, random_state=3).as_matrix().reshape(B, N, P, 3, 3)
    forces = rng.uniform(-0.1, 0.1, (B, N, M, P, 3))
    forces[..., 0] = rng.uniform(0.1, 1, (B, N, M, P))
    mesh = {"scale": [0.06, 0.06, 0.06], "pose": seven(*OBJECT), "file_path": "/far/away/cube/mesh/simplified.obj"}
    return {
        "robot_pose": np.zeros((B, N, 3, 29)),
        "contact_point": rng.normal(0, 0.03, (B, N, P, 3)).astype(np.float32),
        "contact_frame": frames.astype(np.float32),
        "contact_force": forces.astype(np.float32),
        "grasp_error": np.zeros((B, N, M)),
        "world_cfg": [{"mesh": {"scene_cube": mesh}}],
        "scene_path": ["far/away.npy"],
        "joint_names": ["rh_THJ5"],
    } | changes


def test_normals_are_first_columns_and_pressures_means_over_the_wrenches(folder):
    pickled("some.npy", written := record())
    data_set = read_bodex("some.npy")
    assert data_set.names == ("0, 0", "0, 1", "0, 2") and data_set.offsets.tolist() == [0, 4, 8, 12]
    np.testing.assert_array_equal(data_set.points.reshape(N, P, 3), written["contact_point"][0])
    np.testing.assert_allclose(data_set.normals.reshape(N, P, 3), written["contact_frame"][0, ..., 0], atol=1e-6)
    np.testing.assert_allclose(data_set.pressures.reshape(N, P), written["contact_force"][0, ..., 0].mean(1), atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(data_set.normals, axis=1), 1, atol=1e-14)


@pytest.mark.filterwarnings("ignore:.*normals point away")
@pytest.mark.filterwarnings("ignore:.*normals of")
def test_the_weight_acts_where_the_mesh_has_its_centre_of_mass(folder):
    trimesh = pytest.importorskip("trimesh")
    (folder / "cube/mesh").mkdir(parents=True)
    cube = trimesh.creation.box((1, 1, 1))
    cube.apply_translation([0.5, 0, 0])
    cube.export("cube/mesh/simplified.obj")
    pickled("some.npy", record())
    assert main(["import", "bodex", "some.npy", "--mass", "0.1"]) == 0
    sets = load_grasps("grasps.npz")
    center, force = OBJECT[0] + OBJECT[1].apply([0.03, 0, 0]), np.array([0, 0, 0.1 * 9.81])
    np.testing.assert_allclose(sets.wrench[:, 0], [[*force, *np.cross(center, force)]] * N, atol=1e-9)
    np.testing.assert_allclose(sets.squeeze, read_bodex("some.npy").pressures)
    assert main(["import", "bodex", "some.npy", "--mass", "0.1", "--center", *map(str, center)]) == 0
    np.testing.assert_allclose(load_grasps("grasps.npz").wrench, sets.wrench, atol=1e-12)


def test_without_the_mesh_the_centre_of_mass_is_asked_for(folder, capsys):
    pickled("some.npy", record())
    assert main(["import", "bodex", "some.npy"]) == 1
    error = capsys.readouterr().err
    assert "some.npy does not say the object's centre of mass: give it by --center or its mesh" in error
    assert not (folder / "grasps.npz").exists()


def changed(name: str, place: tuple, value: float) -> dict:
    written = record()
    written[name][place] = value
    return written


@pytest.mark.parametrize(
    "bad, message",
    [
        ([], "not a BODex file: it is"),
        (record(contact_point=None), "not a BODex file: contact_point is not an array of numbers"),
        (
            record(contact_point=np.zeros((1, 3, 4))),
            r"contact_point has the shape \(1, 3, 4\): expected \(b, n, p, 3\)",
        ),
        (record(contact_frame=np.zeros((1, 3, 4, 3))), r"contact_frame has the shape .* expected \(1, 3, 4, 3, 3\)"),
        (
            record(contact_force=np.zeros((1, 3, 2, 5, 3))),
            r"contact_force has the shape .* expected \(1, 3, m, 4, 3 or 4\)",
        ),
        (changed("contact_point", (0, 1, 2), np.nan), r"record 0, 1: contact_point\[2, 0\] is nan: expected a finite"),
        (changed("contact_frame", (0, 1, 2), 0.5), r"record 0, 1: contact_frame\[2\] is not a rotation"),
        (changed("contact_force", (0, 1, slice(None), 3, 0), -0.9), r"record 0, 1: contact_force\[3\] pulls with 0.9"),
    ],
)
def test_a_bad_grasp_is_named_and_the_rest_go_on(folder, bad, message):
    pickled("bad.npy", bad)
    with pytest.raises(ValueError, match=message) as caught:
        read_bodex("bad.npy")
    assert str(caught.value).startswith("bad.npy")
    if "record" in message:
        data_set = read_bodex("bad.npy", keep_going=True)
        assert data_set.names == ("0, 0", "0, 2") and len(data_set.left_out) == 1
