"""Files as a person makes, turns and checks them: what is written is whole, and nothing is overwritten unasked."""

import csv
import itertools

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.cli.main import main
from tests.batch.conftest import make_sets


def pinches(count: int = 3):
    """Return antipodal jaws that hold a weight beside the line between them."""
    points = np.tile([[0.03, 0, 0], [-0.03, 0, 0]], (count, 1, 1))
    normals = np.tile([[-1.0, 0, 0], [1, 0, 0]], (count, 1, 1))
    grasp = jaxgrasp.Grasp(points, normals, np.full((count, 2), 0.6), np.full((count, 2), 8.0))
    return grasp, np.tile([0, 0, 1.0, 0.005, 0, 0], (count, 1))


@pytest.mark.slow
def test_the_template_is_a_file_of_grasps_that_hold(folder, capsys):
    assert main(["template", "csv"]) == 0
    sets = jaxgrasp.load_grasps("grasps.csv")
    assert sets.labels["name"].tolist() == ["three fingers", "jaw"]
    assert (jaxgrasp.evaluate(sets, methods=("A-optimum",)).why == 0).all()
    before = (folder / "grasps.csv").read_bytes()
    assert main(["template", "csv"]) == 1
    assert capsys.readouterr().err == "jaxgrasp: grasps.csv exists already: choose another --out\n"
    assert (folder / "grasps.csv").read_bytes() == before


def test_converting_there_and_back_changes_nothing(folder):
    pytest.importorskip("pyarrow")
    pytest.importorskip("h5py")
    jaxgrasp.save_grasps("a.npz", make_sets([3, 5, 2]), name=["x", "y", "z"])
    paths = ["a.npz", "b.csv", "c.parquet", "d.h5", "e.npz"]
    for source, target in itertools.pairwise(paths):
        assert main(["convert", source, target]) == 0
    with np.load("a.npz") as first, np.load("e.npz") as last:
        assert set(first) == set(last)
        for name in first:
            np.testing.assert_array_equal(first[name], last[name])


def test_converting_is_whole_or_not_at_all(folder, capsys):
    jaxgrasp.save_grasps("good.npz", make_sets([3, 3]))
    with np.load("good.npz") as archive:
        columns = dict(archive)
    columns["normals"][1, 2] *= 1.5
    np.savez("long.npz", **columns)
    for arguments, message in (
        (("long.npz", "out.csv"), "normals[1, 2] is "),
        (("good.npz", "out.json"), "out.json: its name ends in '.json': expected .npz, .csv"),
        (("good.npz", "long.npz"), "long.npz exists already; --overwrite replaces it"),
    ):
        capsys.readouterr()
        assert main(["convert", *arguments]) == 1
        error_text = capsys.readouterr().err
        assert message in error_text and error_text.count("\n") == 1
    assert sorted(path.name for path in folder.iterdir()) == ["good.npz", "long.npz"]


def test_converting_turns_outward_normals(folder):
    sets = make_sets([3, 3])
    with pytest.warns(UserWarning, match="normals of 2 of 2 grasps point away from the middle of their contacts"):
        jaxgrasp.save_grasps("in.npz", sets)
        with np.load("in.npz") as archive:
            np.savez("out.npz", **dict(archive) | {"normals": -archive["normals"]})
        jaxgrasp.load_grasps("out.npz")
    assert main(["convert", "out.npz", "back.npz", "--normals", "outward"]) == 0
    np.testing.assert_array_equal(jaxgrasp.load_grasps("back.npz").normals, sets.normals)


def test_validate_suspects_outward_normals(folder, capsys):
    sets = make_sets([3, 5, 4])
    jaxgrasp.save_grasps("in.npz", sets)
    with np.load("in.npz") as archive:
        np.savez("out.npz", **dict(archive) | {"normals": -archive["normals"]})
    assert main(["validate", "out.npz"]) == 0
    assert "warning: normals of 3 of 3 grasps point away from the middle of their contacts" in capsys.readouterr().out
    for arguments in (["in.npz"], ["out.npz", "--normals", "outward"]):
        assert main(["validate", *arguments]) == 0
        assert "warning" not in capsys.readouterr().out


def test_fingers_under_a_tray_are_not_suspected(folder, capsys):
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(-0.1, 0.1, (50, 3, 2)), np.full((50, 3, 1), 0.3)], -1)
    # As far from upright as rounding of a file may be, and outwards each of them.
    normals = np.array([0, 0, 1.0]) + 1e-3 * (points - points.mean(1, keepdims=True))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    grasp = jaxgrasp.Grasp(points, normals, np.full((50, 3), 0.5), np.ones((50, 3)))
    jaxgrasp.save_grasps("tray.npz", grasp, np.array([0, 0, 3.0, 0, 0, 0]))
    jaxgrasp.load_grasps("tray.npz")
    assert main(["validate", "tray.npz"]) == 0
    assert "warning" not in capsys.readouterr().out


@pytest.mark.slow
def test_jaws_that_cannot_hold_are_told_why_and_what_mends_it(folder, capsys):
    jaxgrasp.save_grasps("jaws.npz", *pinches(), name=["a", "b", "c"])
    common = ["evaluate", "jaws.npz", "--methods", "A-optimum", "--no-report"]
    assert main([*common, "--out", "hard"]) == 0
    output = capsys.readouterr().out
    assert "0 of 3 grasps hold" in output and "3 not: no torque about the line through its contacts (a; b; c)" in output
    assert "resist no torque about the line between them" in output and "--torsion" in output
    with open("hard/results.csv", newline="") as stream:
        assert [(row["name"], row["holds"]) for row in csv.DictReader(stream)] == [(n, "no") for n in "abc"]
    assert main([*common, "--out", "soft", "--torsion", "0.01"]) == 0
    output = capsys.readouterr().out
    assert "3 of 3 grasps hold" in output and "warning" not in output


def test_torsion_must_be_a_length(folder, capsys):
    jaxgrasp.save_grasps("jaws.npz", *pinches())
    assert main(["evaluate", "jaws.npz", "--torsion", "-1"]) == 1
    assert "torsion[0] is -1.0: expected a finite number, zero or more" in capsys.readouterr().err


def test_the_table_is_written_when_small_or_asked_for(folder, capsys, monkeypatch):
    jaxgrasp.save_grasps("jaws.npz", *pinches())
    common = ["evaluate", "jaws.npz", "--methods", "A", "--no-report", "--overwrite"]
    monkeypatch.setattr("jaxgrasp.cli.evaluate.SMALL_TABLE", 2)
    assert main([*common]) == 0
    assert "no table of 3 rows" in capsys.readouterr().out and not (folder / "jaxgrasp-results/results.csv").exists()
    assert main([*common, "--table", "csv"]) == 0
    assert len((folder / "jaxgrasp-results/results.csv").read_text().splitlines()) == 4
    assert main([*common, "--table", "none"]) == 0
    assert not (folder / "jaxgrasp-results/results.csv").exists(), "a table of an earlier evaluation is stale"
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    assert main([*common, "--table", "parquet"]) == 1
    assert "pip install 'jaxgrasp[table]'" in capsys.readouterr().err
