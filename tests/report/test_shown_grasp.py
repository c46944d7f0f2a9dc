"""A page of one grasp draws what was given, where it stands, and both answers' forces."""

import json
import re

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.cli.main import main
from jaxgrasp.hand import Box, Mesh, Plane, Pose, Posture, human_hand, pose_hand
from jaxgrasp.report import bundle, show
from tests.batch.conftest import make_sets

go = pytest.importorskip("plotly.graph_objects")


@pytest.fixture(scope="module")
def sets():
    return make_sets([3, 3])


def scenes(path) -> list[dict]:
    page = path.read_text(encoding="utf-8")
    scene_list = json.loads(re.search(r'<script type="application/json" id="[\w-]+">(.*?)</script>', page, re.S)[1])
    return scene_list if isinstance(scene_list, list) else [scene_list]


def traces(path) -> dict[str, dict]:
    (figure,) = scenes(path)
    go.Figure(figure)
    return {trace["name"]: trace for trace in figure["data"] if "name" in trace}


def corners(trace: dict) -> np.ndarray:
    return np.column_stack([np.array(trace[axis], float) for axis in "xyz"])


def test_both_answers_are_drawn_and_told(sets, tmp_path):
    show(tmp_path / "g.html", sets.grasp(0), sets.wrench[0, 0], title="<b>mine</b>")
    names = " ".join(traces(tmp_path / "g.html"))
    assert "closed form B (" in names and "optimum B (" in names and "friction cone" in names
    page = (tmp_path / "g.html").read_text(encoding="utf-8").replace(bundle.plotly_bundle(), "")
    assert "&lt;b&gt;mine&lt;/b&gt;" in page and "<b>mine" not in page
    best = jaxgrasp.constrained_optimum(sets.grasp(0), sets.wrench[0, 0])
    assert "It holds." in page and jaxgrasp.Verdict(int(best.verdict)).name in page


def test_without_a_wrench_there_are_contacts_alone(sets, tmp_path):
    show(tmp_path / "g.html", sets.grasp(0))
    assert set(traces(tmp_path / "g.html")) == {"friction cone", "inward normal", "contact"}


def test_given_forces_end_where_they_should(sets, tmp_path):
    grasp, forces = sets.grasp(0), np.array([[0, 0, 3.0], [0, 0, 0], [0, 4.0, 0]])
    show(tmp_path / "g.html", grasp, forces=forces)
    name, shafts = next((n, t) for n, t in traces(tmp_path / "g.html").items() if n.startswith("forces as given"))
    millimetres, newtons = map(float, re.search(r"\(([\d.]+) mm = ([\d.]+) N\)", name).groups())
    given_traces = [t for t in scenes(tmp_path / "g.html")[0]["data"] if t.get("legendgroup") == "forces as given"]
    heads = next(t for t in given_traces if "i" in t)
    tips = corners(heads)[np.unique(heads["i"])[::2]]
    np.testing.assert_allclose(tips, (grasp.points + forces * millimetres / 1000 / newtons)[[0, 2]], atol=1e-6)


def test_a_hand_stands_in_its_posture(tmp_path):
    hand = human_hand()
    wrist = Pose(jnp.array([1.0, 2.0, 3.0]), jnp.eye(3))
    posture = Posture(wrist, jnp.zeros(len(hand.joints)))
    show(tmp_path / "hand.html", hand=hand, posture=posture)
    drawn = corners(traces(tmp_path / "hand.html")["hand"])
    frames = pose_hand(hand, posture).links
    centers = np.einsum("lij,lmj->lmi", frames.rotation, hand.skin.centers) + np.asarray(frames.origin)[:, None]
    radii = np.asarray(hand.skin.radii)
    low = (centers - radii[..., None])[radii > 0].min(0)
    high = (centers + radii[..., None])[radii > 0].max(0)
    np.testing.assert_allclose(drawn.min(0), low, atol=2e-3)
    np.testing.assert_allclose(drawn.max(0), high, atol=2e-3)


def test_an_object_stands_at_its_pose(tmp_path):
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    pose = Pose(np.array([1.0, 0, 0]), turned)
    show(tmp_path / "box.html", solid=Box(0.2, 0.4, 0.6), pose=pose)
    drawn = corners(traces(tmp_path / "box.html")["object"])
    np.testing.assert_allclose(drawn.max(0) - drawn.min(0), [0.4, 0.2, 0.6], atol=1e-6)
    np.testing.assert_allclose(drawn.mean(0), [1, 0, 0], atol=1e-6)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    mesh = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), faces)
    show(tmp_path / "mesh.html", solid=mesh)
    np.testing.assert_array_equal(corners(traces(tmp_path / "mesh.html")["object"]), mesh.vertices)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "there is nothing to draw"),
        ({"forces": np.zeros((3, 3))}, "belong to a grasp: pass a grasp too"),
        ({"hand": human_hand()}, "hand and posture go together"),
        ({"solid": Plane()}, "a Plane cannot be drawn"),
        ({"pose": Pose(np.zeros(3), np.eye(3))}, "pose is given without an object"),
    ],
    ids=lambda value: "" if isinstance(value, str) else "+".join(value) or "nothing",
)
def test_what_does_not_belong_together_is_one_line(tmp_path, arguments, message):
    with pytest.raises((ValueError, TypeError), match=message):
        show(tmp_path / "x.html", **arguments)
    assert not list(tmp_path.iterdir())


def test_wrong_shapes_are_named(sets, tmp_path):
    with pytest.raises(ValueError, match=r"points is an array of shape \(2, 3, 3\): expected one grasp"):
        show(tmp_path / "x.html", sets.padded(3))
    with pytest.raises(ValueError, match=r"forces has shape \(2, 3\): expected \(3, 3\)"):
        show(tmp_path / "x.html", sets.grasp(0), forces=np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r"wrench is an array of shape \(3,\): expected one wrench"):
        show(tmp_path / "x.html", sets.grasp(0), np.zeros(3))


def test_the_command_finds_a_grasp_by_its_name(sets, folder, capsys):
    jaxgrasp.save_grasps("grasps.npz", sets, name=["left", "right"])
    assert main(["show", "grasps.npz", "--grasp", "right", "--out", "right.html"]) == 0
    drawn = next(t for t in scenes(folder / "right.html")[0]["data"] if t.get("name") == "contact")
    np.testing.assert_allclose(corners(drawn), sets.grasp(1).points, rtol=1e-4)
    assert main(["show", "grasps.npz", "--grasp", "1", "--out", "one.html"]) == 0
    assert "<h1>right</h1>" in (folder / "one.html").read_text(encoding="utf-8")
    capsys.readouterr()
    assert main(["show", "grasps.npz", "--grasp", "rihgt"]) == 1
    assert capsys.readouterr().err == "jaxgrasp: grasps.npz holds no grasp 'rihgt': did you mean 'right'?\n"
    assert main(["show", "grasps.npz", "--wrench", "1"]) == 1
    assert "wrench is 1: expected 0 to 0" in capsys.readouterr().err
    assert not (folder / "show.html").exists()
