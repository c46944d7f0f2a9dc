"""Grasps whose normals point out of the object are named; those that cannot tell count for nothing."""

import warnings

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.batch.contact_sets import ContactSets
from jaxgrasp.batch.sources import outward_normals
from jaxgrasp.cli.main import main

TRAY = [[0.05, 0, 0], [-0.03, 0.04, 0], [-0.02, -0.04, 0]]


def on_ellipsoid(rng, n):
    """Return points on an ellipsoid away from the origin, and the inward normals there."""
    axes, unit = rng.uniform(0.02, 0.06, 3), rng.normal(size=(n, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    normals = -unit / axes
    return axes * unit + [0.3, -0.2, 0.5], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def sets_of(grasps, **labels):
    points, normals = (np.concatenate([np.asarray(grasp[k], float) for grasp in grasps]) for k in (0, 1))
    count = len(points)
    return ContactSets(
        points,
        normals,
        np.full(count, 0.5),
        np.full(count, 5.0),
        np.concatenate([[0], np.cumsum([len(grasp[0]) for grasp in grasps])]),
        np.tile([0.0, 0, 2, 0, 0, 0], (len(grasps), 1, 1)),
        labels={name: np.array(values) for name, values in labels.items()},
    )


@pytest.mark.parametrize("n", [2, 3, 5, 20])
def test_inward_normals_of_convex_objects_are_never_suspected_and_outward_ones_nearly_always(n):
    rng = np.random.default_rng(n)
    grasps = [on_ellipsoid(rng, n) for _ in range(200)]
    inward = outward_normals(sets_of(grasps))
    outward = outward_normals(sets_of([(points, -normals) for points, normals in grasps]))
    assert (inward.away, inward.names) == (0, ())
    assert outward.away == outward.decided == inward.decided > 190 and outward.is_most


def test_one_turned_normal_of_a_pinch_is_suspected():
    points, normals = [[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [-1, 0, 0]]
    assert outward_normals(sets_of([(points, normals)])).away == 1


def test_grasps_that_cannot_tell_are_left_out_of_the_count():
    rng = np.random.default_rng(0)
    trays = [(TRAY, np.tile([0.0, 0, sign], (3, 1))) for sign in (1, -1, 1)]
    single = [([[0.0, 0, 0.1]], [[0, 0, -1.0]])]
    outward = [(points, -normals) for points, normals in (on_ellipsoid(rng, 4) for _ in range(2))]
    is_outward = outward_normals(sets_of([*trays, *single, *outward]))
    assert (is_outward.away, is_outward.decided, is_outward.names) == (2, 2, ("grasp 4", "grasp 5"))
    assert is_outward.is_most


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    names = ["mug", "box", "tray", "bottle"]
    grasps = [on_ellipsoid(rng, 3) for _ in names]
    grasps[1] = grasps[1][0], -grasps[1][1]
    grasps[2] = TRAY, np.tile([0.0, 0, 1], (3, 1))
    jaxgrasp.save_grasps("grasps.npz", sets_of(grasps, name=names))
    return tmp_path


WARNING = r"normals of 1 of 3 grasps point away from the middle of their contacts.*\('box'\)"


def test_they_are_named_wherever_grasps_are_read(folder, capsys):
    with pytest.warns(UserWarning, match=WARNING):
        sets = jaxgrasp.load_grasps("grasps.npz")
    with pytest.warns(UserWarning, match=WARNING):
        evaluation = jaxgrasp.evaluate(sets, methods=("A",))
    assert evaluation.summary.outward.names == ("box",)
    assert main(["validate", "grasps.npz"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("warning: normals of 1 of 3 grasps") and "('box')" in lines[0]
    assert lines[1:] == ["4 grasps, no fault; 1 with doubtful normals"]


def test_evaluate_warns_before_it_says_what_holds(folder, capsys):
    assert main(["evaluate", "grasps.npz", "--methods", "A", "--no-report"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("warning: normals of 1 of 3 grasps") and "('box')" in output.splitlines()[0]


def test_check_grasp_warns_of_one_grasp_and_names_those_of_a_batch():
    rng = np.random.default_rng(2)
    points, normals = map(np.stack, zip(*(on_ellipsoid(rng, 4) for _ in range(3)), strict=True))
    some = np.full((3, 4), 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jaxgrasp.check_grasp(jaxgrasp.Grasp(points, normals, some, some))
    normals[[0, 2]] *= -1
    with pytest.warns(UserWarning, match=r"normals of 2 of 3 grasps .*\('\[0\]', '\[2\]'\)"):
        jaxgrasp.check_grasp(jaxgrasp.Grasp(points, normals, some, some))
    with pytest.warns(UserWarning, match="normals point away from the middle of the contacts"):
        jaxgrasp.check_grasp(jaxgrasp.Grasp(points[0], normals[0], some[0], some[0]))
    # A contact that is not there says nothing.
    present = np.array([1.0, 1, 0, 0])
    turned = normals[1] * np.array([1, 1, -1, -1])[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jaxgrasp.check_grasp(jaxgrasp.Grasp(points[1], turned, some[1], some[1], present=present))
