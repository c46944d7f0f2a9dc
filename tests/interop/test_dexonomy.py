"""Dexonomy's files: contacts and wrenches that balance, in the layout of its own code, and a template of its own."""

import numpy as np
import pytest

from jaxgrasp.batch.sources import load_grasps
from jaxgrasp.cli.main import main
from jaxgrasp.files.plain_pickle import load_plain
from jaxgrasp.hand import pose_hand
from jaxgrasp.interop import hand_from_mujoco, load_mjcf, read_dexonomy
from jaxgrasp.model.hand import Pose, Posture
from tests.interop.two_fingers import PALM, SAMPLES, pickled

CENTER = np.array([0.2, -0.1, 0.3])


def balanced(pull=(0.0, 0.0, -0.3, 0.0, 0.01, 0.02)) -> dict:
    """Return a record of three contacts whose forces and torsional moments balance the wrench ``pull``."""
    points = CENTER + 0.04 * np.array([[1, 0, 0], [-0.5, 0.8, 0.1], [-0.5, -0.8, -0.1]])
    normals = (CENTER - points) / np.linalg.norm(CENTER - points, axis=1, keepdims=True)
    arms = points - CENTER
    columns = []
    for arm, normal in zip(arms, normals, strict=True):
        columns += [np.concatenate([axis, np.cross(arm, axis)]) for axis in np.eye(3)]
        columns.append(np.concatenate([np.zeros(3), normal]))
    grip = np.array(columns).T
    squeezed = np.concatenate([np.append(0.5 * normal, 0) for normal in normals])
    solved = squeezed + np.linalg.pinv(grip) @ (-np.array(pull) - grip @ squeezed)
    wrenches = np.stack([grip[:, 4 * i : 4 * i + 4] @ solved[4 * i : 4 * i + 4] for i in range(3)])
    return {
        "grasp_qpos": np.zeros((1, 29)),
        "ext_center": CENTER,
        "ext_wrench": np.array(pull),
        "ho_c": {
            "pos": points,
            "normal": normals,
            "wrench": 10 * wrenches,
            "bn1": ["a", "b", "c"],
            "dist": np.zeros(3),
        },
        "hand_cpn_w": np.concatenate([points + 0.001, normals], 1),
    }


def test_forces_and_loads_balance_about_the_worlds_origin(folder):
    pickled("one.npy", record := balanced())
    data_set = read_dexonomy("one.npy")
    wrenches = record["ho_c"]["wrench"]
    forces = wrenches[:, :3]
    spins = wrenches[:, 3:] - np.cross(data_set.points - CENTER, forces)
    held = np.concatenate([forces.sum(0), (np.cross(data_set.points, forces) + spins).sum(0)])
    np.testing.assert_allclose(held, -data_set.loads[0], atol=1e-12)
    assert np.abs(data_set.loads).max() > 1
    np.testing.assert_allclose(data_set.pressures, np.sum(forces * data_set.normals, -1))
    np.testing.assert_array_equal(data_set.points, record["ho_c"]["pos"])
    np.testing.assert_array_equal(data_set.centers, [CENTER])


def test_contacts_are_imported_as_they_are(folder):
    pickled("one.npy", record := balanced())
    pickled("two.npy", aimed := balanced() | {"ho_c": None})
    words = ["--force", "2", "--squeeze", "3", "--friction", "0.6", "--torsion", "0.02", "--mass", "0"]
    assert main(["import", "dexonomy", "one.npy", "two.npy", *words]) == 0
    sets, data_set = load_grasps("grasps.npz"), read_dexonomy("one.npy")
    np.testing.assert_allclose(sets[0].points, record["ho_c"]["pos"])
    np.testing.assert_allclose(sets[0].normals, record["ho_c"]["normal"])
    np.testing.assert_allclose(sets[0].squeeze, 2 * data_set.pressures)
    np.testing.assert_allclose(sets.wrench[0, 0], -2 * data_set.loads[0])
    np.testing.assert_allclose(sets[1].points, aimed["hand_cpn_w"][:, :3])
    np.testing.assert_allclose(sets[1].squeeze, 3)
    assert set(sets.friction) == {0.6} and set(sets.torsion) == {0.02}
    assert sets.labels["name"].tolist() == ["one 0", "two 0"]


def test_older_names_are_known(folder):
    written = balanced()
    pickled(
        "old.npy",
        {
            "grasp_qpos": np.zeros(29),
            "obj_gravity_center": CENTER,
            "obj_worldframe_contacts": written["hand_cpn_w"],
        },
    )
    data_set = read_dexonomy("old.npy")
    np.testing.assert_array_equal(data_set.centers, [CENTER])
    assert np.isnan(data_set.pressures).all() and not data_set.loads.any()


def spoiled(**changed: object) -> dict:
    written = balanced()
    return written | {"ho_c": written["ho_c"] | changed}


@pytest.mark.parametrize(
    "bad, message",
    [
        ("text", "record 0: it is 'text': expected fields by their names"),
        ({"grasp_qpos": 0}, "it has no contacts: expected ho_c, obj_cpn_w"),
        (
            spoiled(normal=-balanced()["ho_c"]["normal"]),
            r"ho_c.wrench\[\d\] pulls with .*: expected normals and forces into",
        ),
        (
            spoiled(normal=2 * balanced()["ho_c"]["normal"]),
            r"ho_c.normal\[0\] has the length 2: expected a unit vector",
        ),
        (spoiled(normal=np.eye(3)[:2]), "ho_c.normal has 2 rows: expected 3, as ho_c.pos has"),
        (spoiled(wrench=np.zeros((3, 5))), r"ho_c.wrench has the shape \(3, 5\): expected \(3, 6\)"),
        (spoiled(pos=np.full((3, 3), np.inf)), r"ho_c.pos\[0, 0\] is inf: expected a finite number"),
        (balanced() | {"ext_center": None}, "it has an ext_wrench, but no ext_center that it is about"),
    ],
)
def test_a_bad_file_is_named(folder, bad, message, capsys):
    pickled("bad.npy", bad)
    with pytest.raises(ValueError, match=message) as caught:
        read_dexonomy("bad.npy")
    assert str(caught.value).startswith("bad.npy: record 0: ")
    pickled("good.npy", balanced())
    assert main(["import", "dexonomy", "bad.npy", "good.npy", "--keep-going"]) == 0
    assert "left out: 1 bad records or files in all" in capsys.readouterr().out
    assert main(["import", "dexonomy", "bad.npy", "good.npy"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"{SAMPLES.name} is not beside the project: ../shared/samples")
def test_a_template_is_read_and_asks_for_the_centre_of_mass(folder, capsys):
    (file,) = (SAMPLES / "dexonomy").glob("*.npy")
    data_set = read_dexonomy(file)
    assert data_set.points.shape == (16, 3) and np.isnan(data_set.pressures).all() and np.isnan(data_set.centers).all()
    # The fingers close about something before the palm: what they press into lies on the way of every normal.
    middle = data_set.points.mean(0)
    assert np.mean(np.sum((middle - data_set.points) * data_set.normals, -1) > 0) > 0.9
    assert main(["import", "dexonomy", str(file)]) == 1
    assert "does not say the object's centre of mass: give it by --center" in capsys.readouterr().err


@pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"{SAMPLES.name} is not beside the project: ../shared/samples")
def test_forward_kinematics_puts_the_named_links_at_a_templates_contacts():
    """Forward kinematics by DexGraspNet's Shadow hand, whose last two thumb joints turn the other way and which has no
    palm above the world: checks root, quaternion, joint order and the link of each contact."""
    (file,) = (SAMPLES / "dexonomy").glob("*.npy")
    record, data_set = load_plain(file), read_dexonomy(file)
    model = load_mjcf(SAMPLES / "dexgraspnet" / "mjcf" / "shadow_hand_wrist_free.xml")
    hand = hand_from_mujoco(model, "robot0:palm").hand
    links = [
        hand.links.index(next(link for link in hand.links if link.name == name.replace("rh_", "robot0:")))
        for name in record["hand_contact_body_names"]
    ]

    def gaps(angles: np.ndarray) -> np.ndarray:
        """Return the distance of each contact from the skin of the link that the file names."""
        frames = pose_hand(hand, Posture(Pose(np.array([0, 0, PALM]), np.eye(3)), angles)).links
        origins, axes = np.asarray(frames.origin)[links], np.asarray(frames.rotation)[links]
        local = np.einsum("cji,cj->ci", axes, data_set.points - origins)
        centers, radii = np.asarray(hand.skin.centers)[links], np.asarray(hand.skin.radii)[links]
        return np.where(radii > 0, np.linalg.norm(local[:, None] - centers, axis=-1) - radii, np.inf).min(1)

    angles = record["grasp_qpos"].astype(float)
    angles[-2:] *= -1
    assert np.abs(gaps(angles)).max() < 2.5e-3
    assert np.abs(gaps(np.roll(angles, 5))).max() > 0.02
