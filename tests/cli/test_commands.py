"""The commands as a person types them: what they print, write, and refuse."""

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import jaxgrasp
from jaxgrasp.cli.main import main
from jaxgrasp.files.replace import locked
from tests.batch.conftest import make_sets


def run(*arguments: str) -> subprocess.CompletedProcess:
    """Run a command in a process of its own, since the command line sets JAX up for itself."""
    return subprocess.run([sys.executable, "-m", "jaxgrasp.cli.main", *arguments], capture_output=True, text=True)


@pytest.fixture
def grasps(folder):
    jaxgrasp.save_grasps("grasps.npz", make_sets([3, 5, 4, 4]), name=np.array(["a", "b", "c", "d"]))
    return folder


def test_arguments_are_understood_without_jax():
    code = (
        "import sys, jaxgrasp.cli.main as m\n"
        "try: m.main(['evaluate', '--help'])\n"
        "except SystemExit: pass\n"
        "assert not {'jax', 'numpy'} & set(sys.modules), 'a heavy import before the arguments are read'"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_version_is_that_of_the_installed_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"jaxgrasp {version('jaxgrasp')}\n"


def test_kernel_prints_the_folder_of_the_headers_without_jax():
    code = (
        "import sys, jaxgrasp.cli.main as m\n"
        "assert m.main(['kernel', '--include']) == 0\n"
        "assert 'jax' not in sys.modules, 'the folder is known without JAX'"
    )
    printed = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    folder = Path(printed.removesuffix("\n"))
    names = {"one_grasp.h", "one_grasp_c.h", "one_grasp_c.cpp", "lanes.h", "tolerances.h"}
    assert names <= {path.name for path in folder.iterdir()}


def test_kernel_tells_how_to_compile(capsys):
    assert main(["kernel"]) == 0
    assert "g++ -std=c++17" in capsys.readouterr().out


def test_info_says_what_a_file_holds(grasps, capsys):
    assert main(["info", "grasps.npz"]) == 0
    output = capsys.readouterr().out
    assert "4 grasps" in output and "3: 1, 4: 2, 5: 1" in output and "a, b, c, d" in output


def test_validate_lists_every_fault(grasps, capsys):
    assert main(["validate", "grasps.npz"]) == 0
    with np.load("grasps.npz") as archive:
        columns = dict(archive)
    columns["friction"][[1, 15]] = -1
    columns["normals"][4] = 0
    np.savez("bad.npz", **columns)
    capsys.readouterr()
    assert main(["validate", "bad.npz"]) == 1
    captured = capsys.readouterr()
    assert captured.out.count("\n") == 3
    for place in ("normals[1, 1]", "friction[0, 1]", "friction[3, 3]"):
        assert place in captured.out
    assert "3 fault(s) in 3 of 4 grasps" in captured.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.npz"], "nowhere.npz"),
        (["grasps.npz", "--chunk", "0"], "chunk is 0: expected"),
        (["grasps.npz", "--out", "grasps.npz/out"], "output folder cannot be written"),
        (["."], "is a directory"),
        (["grasps.npz", "--friction", "0.3", "-1"], "friction[1] is -1.0: expected"),
        (["grasps.npz", "--squeeze", "2", "2"], "squeeze[1] is 2.0, for the second time"),
    ],
)
def test_errors_are_one_line(grasps, capsys, arguments, message):
    assert main(["evaluate", *arguments]) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("jaxgrasp: ") and captured.err.count("\n") == 1
    assert message in captured.err


def test_evaluate_writes_results_summary_and_report(grasps):
    answer = run("evaluate", "grasps.npz", "--out", "out")
    assert answer.returncode == 0, answer.stderr
    assert "4 grasps of 3 to 5 contacts" in answer.stdout
    with np.load("out/results.npz") as results:
        assert results["B-optimum.forces"].shape == (16, 1, 3)
    summary = json.loads((grasps / "out" / "summary.json").read_text())
    assert summary["summary"]["grasps"] == 4 and summary["times"]["problems"] == 4
    assert "report.html" in answer.stdout and (grasps / "out" / "report.html").stat().st_size > 10_000


@pytest.mark.slow
def test_a_folder_in_which_another_works_is_refused_before_anything_is_read(grasps):
    (grasps / "out").mkdir()
    with locked(grasps / "out"):
        done = run("evaluate", "nothing.npz", "--out", "out")
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert f"out: process {os.getpid()}, at work since" in done.stderr and "choose another --out" in done.stderr


@pytest.mark.slow
def test_outward_normals_are_suspected_and_turned(grasps):
    with np.load("grasps.npz") as archive:
        columns = dict(archive)
    np.savez("outward.npz", **columns | {"normals": -columns["normals"]})
    plain = run("evaluate", "outward.npz", "--no-report", "--out", "plain")
    assert "warning: normals of " in plain.stdout and "--normals outward" in plain.stdout
    turned = run("evaluate", "outward.npz", "--normals", "outward", "--no-report", "--out", "turned")
    straight = run("evaluate", "grasps.npz", "--no-report", "--out", "straight")
    assert "warning" not in turned.stdout + straight.stdout
    with np.load("turned/results.npz") as a, np.load("straight/results.npz") as b:
        np.testing.assert_array_equal(a["B.forces"], b["B.forces"])


@pytest.mark.slow
def test_normals_that_hold_nothing_up_are_suspected(folder):
    # Three contacts under a plate carry it only if their normals point up.
    points = np.array([[[0.1, 0, 0], [-0.05, 0.09, 0], [-0.05, -0.09, 0]]])
    down = np.broadcast_to([0.0, 0, -1], points.shape)
    columns = {"friction": np.full((1, 3), 0.5), "squeeze": np.ones((1, 3)), "wrench": np.array([[0, 0, 3.0, 0, 0, 0]])}
    np.savez("down.npz", points=points, normals=down, **columns)
    assert "warning: most grasps fail, but hold" in run("evaluate", "down.npz", "--no-report").stdout
    np.savez("up.npz", points=points, normals=-down, **columns)
    assert "warning" not in run("evaluate", "up.npz", "--no-report").stdout


def test_values_are_swept(grasps):
    answer = run("evaluate", "grasps.npz", "--friction", "0.2", "0.9", "--methods", "B", "--no-report", "--out", "out")
    assert answer.returncode == 0, answer.stderr
    assert "== friction-0.2 ==" in answer.stdout
    with np.load("out/friction-0.2/results.npz") as low, np.load("out/friction-0.9/results.npz") as high:
        assert np.all(high["B.margin"] > low["B.margin"])


@pytest.mark.slow
def test_the_shipped_grasps_are_evaluated_by_default(folder):
    answer = run("evaluate", "--no-report")
    assert answer.returncode == 0, answer.stderr
    with np.load("jaxgrasp-results/results.npz") as results:
        assert len(results["grasp"]) >= 2000
