"""``jaxgrasp grip``: what it writes obeys the laws of statics, and what it cannot do it says."""

import json
import sys

import jax
import numpy as np
import pytest

from jaxgrasp.cli.arguments import Grip
from jaxgrasp.cli.grip import _write_report
from jaxgrasp.cli.main import main
from jaxgrasp.grip import Body, GripType, Hold, Record, Scene, contributions_of, observe
from jaxgrasp.grip.power_grip import lay_on
from jaxgrasp.grip.scene_file import SceneFile
from jaxgrasp.grip.simulation import stacked
from jaxgrasp.hand import Pose, Sphere, human_hand
from jaxgrasp.report import bundle
from jaxgrasp.report.grip_over_time import history


@pytest.mark.slow
@pytest.mark.parametrize(
    "grip, kind",
    [
        ("power", GripType.CYLINDRICAL_POWER),
        ("precision-3", GripType.PRECISION_3),
        ("precision-5", GripType.PRECISION_5),
    ],
)
def test_a_cylinder_is_held_and_let_go(folder, capsys, grip, kind):
    arguments = ["grip", "--grip", grip, "--seconds", "2", "--release", "--mass", "0.3", "--out", "out"]
    assert main(arguments) == 0
    output = capsys.readouterr().out
    assert "closed on the cylinder:" in output and "not stable for the first time" in output
    with np.load(folder / "out" / "grip.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    assert "report:" in output and "pictures:" in output
    assert (folder / "out" / "grip.html").stat().st_size < 6e6
    assert all((folder / "out" / name).stat().st_size > 20_000 for name in ("grip.png", "grip_forces.png"))
    summary = json.loads((folder / "out" / "grip.json").read_text())
    count = len(arrays["time"])
    assert count == 101 == summary["instants"] and sum(summary["hold"].values()) == count
    assert (arrays["grip_type"][:70] == kind).all() and arrays["grip_type"][-1] == GripType.NONE
    assert summary["grip"] == kind.name.lower().replace("_", " ")
    share = arrays["squeeze"][0] / np.where(arrays["present"][0] > 0, 1e3 * arrays["depths"][0], 1)
    expected = contributions_of(human_hand(), kind) * arrays["present"][0]
    np.testing.assert_allclose(share, expected, rtol=1e-9)
    assert all(np.isfinite(arrays[name]).all() for name in arrays if arrays[name].dtype.kind == "f")
    stable = arrays["hold"] == Hold.STABLE
    assert stable[:70].all() and arrays["hold"][-1] == Hold.LOST
    # Where it is stable the forces balance the wrench, about the object's centre, inside their cones.
    arms = arrays["points"] - arrays["object_origin"][:, None]
    forces, normals = arrays["forces"], arrays["normals"]
    exerted = np.concatenate([forces.sum(1), np.cross(arms, forces).sum(1)], -1)
    np.testing.assert_allclose(exerted[stable], arrays["wrench"][stable], atol=1e-8)
    along = np.einsum("tli,tli->tl", forces, normals)
    across = np.linalg.norm(forces - along[..., None] * normals, axis=-1)
    assert (across <= 0.6 * along + 1e-9)[stable].all()
    assert (forces[arrays["present"] == 0] == 0).all()
    # The object rose with the hand, and fell.
    lifted = arrays["object_origin"][:, 2] - arrays["object_origin"][0, 2]
    assert lifted[:76].max() > 0.15 and lifted[-1] < lifted[75] - 0.05


@pytest.mark.slow
def test_a_grip_out_of_reach_is_said(folder, capsys):
    assert main(["grip", "--grip", "precision-5", "--object", "sphere", "--radius", "0.003"]) == 1
    assert "no precision grip of 5 fingers on this Sphere was found" in capsys.readouterr().err
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_what_is_not_installed_is_said_in_a_line_each(folder, capsys, monkeypatch):
    bundle.plotly_bundle.cache_clear()
    for module in ("plotly.offline", "matplotlib.figure"):
        monkeypatch.setitem(sys.modules, module, None)
    hand, shape = human_hand(), Sphere(0.03)
    posture, placed = lay_on(hand, shape)
    table = Pose(np.array([0.0, 0, -0.5]), np.eye(3))
    scene = Scene(hand, Body(shape, 0.4), table, 0.6, 1e3, np.ones(len(hand.links)), np.array([0.0, 0, -9.81]))
    tick = observe(scene, posture, placed)
    record = [Record(placed, tick, Hold(int(tick.assessment.hold)), False, tick.exerted, np.zeros(6))]
    postures = jax.tree.map(lambda x: x[None], posture)
    _write_report(Grip(out=folder), SceneFile(), scene, history(scene, postures, np.zeros(1), stacked(record)))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["no report", "no pictures"]
    assert all(line.endswith("pip install 'jaxgrasp[report]'") for line in lines) and not list(folder.iterdir())


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--mass", "0"], "mass is 0.0: expected a positive number"),
        (["--friction", "-1"], "friction is -1.0: expected a finite number, 0 or more"),
        (["--turn", "nan"], "turn is nan: expected a finite number"),
        (["--step", "9"], "step is 9.0: expected at most seconds, 4.0"),
        (["--radius", "-0.1"], "radius is -0.1: expected a positive number"),
    ],
)
def test_bad_arguments_are_named_before_any_work(folder, capsys, arguments, message):
    assert main(["grip", *arguments]) == 1
    assert message in capsys.readouterr().err
    assert not list(folder.iterdir())
