"""``jaxgrasp import``: what every format has in common."""

import subprocess
import sys
from typing import get_args

import numpy as np
import pytest

from jaxgrasp.cli.interop_arguments import ImportCommand
from jaxgrasp.cli.main import FUNCTIONS, main
from tests.interop.two_fingers import model, pickled

FORMATS = ("acronym", "bodex", "dexgraspbench", "dexgraspnet", "dexonomy", "graspgen", "graspit", "isaac-grasp")


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_has_help(name, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["import", name, "--help"])
    assert caught.value.code == 0
    output = capsys.readouterr().out
    assert f"jaxgrasp import {name}" in output and "--keep-going" in output


def test_every_format_is_listed_and_runs_something():
    union = get_args(get_args(ImportCommand.__annotations__["command"])[0])
    classes = {
        get_args(get_args(annotation)[0])[0] if get_args(get_args(annotation)[0]) else get_args(annotation)[0]
        for annotation in union
    }
    assert len(classes) == len(FORMATS) and classes <= set(FUNCTIONS)


def test_help_comes_without_jax():
    code = (
        "import sys, jaxgrasp.cli.main as m\n"
        "try: m.main(['import', 'dexonomy', '--help'])\n"
        "except SystemExit: pass\n"
        "assert not {'jax', 'numpy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_an_unknown_format_is_told_the_known_ones(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["import", "dexgrasp", "some.npy"])
    message = capsys.readouterr().err
    assert caught.value.code == 2 and all(name in message for name in FORMATS)


@pytest.mark.parametrize(
    "words, message",
    [
        (("dexonomy",), "no input files: pass at least one"),
        (("dexonomy", "nowhere.npy"), "nowhere.npy: no such file"),
        (("dexonomy", "some.npy", "--out", "some.json"), "out is some.json: expected a file that ends in .npz or .csv"),
        (("dexonomy", "some.npy", "--friction", "-1"), "friction is -1.0: expected a finite number, 0 or more"),
        (("dexonomy", "some.npy", "--mass", "nan"), "mass is nan: expected a finite number, 0 or more"),
        (("dexonomy", "some.npy", "--center", "nan", "0", "0"), "center is (nan, 0.0, 0.0): expected finite numbers"),
        (("dexonomy", "some.npy", "--gravity", "0", "0", "inf"), "gravity is (0.0, 0.0, inf): expected finite numbers"),
        (("bodex", "some.npy", "--object", "nowhere"), "nowhere: no such file"),
        (
            ("dexgraspbench", "some.npy", "--hand", "hand.xml"),
            "names the mesh 'far/cube/mesh/simplified.obj'",
        ),
        (
            ("dexgraspbench", "some.npy", "--hand", "hand.xml", "--scale", "0"),
            "scale is 0.0: expected a positive number",
        ),
        (("graspgen", "some.npy"), "some.npy is not text in UTF-8"),
        (("acronym", "some.npy"), "some.npy: it cannot be read as HDF5"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_before_any_work(folder, words, message, capsys):
    if words[0] == "acronym":
        pytest.importorskip("h5py")
    (folder / "hand.xml").write_text(model())
    posture = np.array([0, 0, 0, 1, 0, 0, 0, 0.1, 0.2])
    record = {"obj_pose": posture[:7], "obj_scale": 0.1, "obj_path": "far/cube", "grasp_qpos": posture}
    pickled("some.npy", record)
    assert main(["import", *words]) == 1
    error = capsys.readouterr().err
    assert message in error and error.startswith("jaxgrasp: ") and error.count("\n") == 1
    assert {path.name for path in folder.iterdir()} == {"hand.xml", "some.npy"}
