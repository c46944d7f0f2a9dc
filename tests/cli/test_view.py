"""``jaxgrasp view``: what is wrong is said in one line, before anything compiles."""

import re
import socket
import sys

import pytest

from jaxgrasp import save_grasps
from jaxgrasp.cli.main import main
from tests.batch.conftest import make_sets

HAS_VISER = pytest.mark.skipif("not __import__('importlib.util').util.find_spec('viser')", reason="needs viser")


def refused(arguments: list[str], capsys) -> str:
    assert main(arguments) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    return captured.err


@HAS_VISER
@pytest.mark.parametrize(
    "arguments, message",
    [
        (["nowhere.npz"], "nowhere.npz"),
        (["nowhere"], "scene is 'nowhere': expected a TOML file, or one of ball"),
        (["ball", "--mesh", "mug.stl"], "mesh is given without a file of grasps: expected .npz, .csv"),
        (["ball", "--grasp", "0"], "grasp is given without a file of grasps"),
        (["--normals", "outward"], "normals is given without a file of grasps"),
        (["--seconds", "0"], "seconds is 0.0: expected a positive number"),
        (["--port", "70000"], "port is 70000: expected 0 to 65535"),
    ],
)
def test_what_cannot_be_shown(folder, capsys, arguments, message):
    assert message in refused(["view", *arguments], capsys)


@HAS_VISER
def test_an_unknown_grasp_is_named_with_the_nearest(folder, capsys):
    save_grasps("grasps.npz", make_sets([3, 3]), name=["mug, left", "mug, right"])
    unknown = refused(["view", "grasps.npz", "--grasp", "mug, rihgt"], capsys)
    assert "holds no grasp 'mug, rihgt': did you mean 'mug, right'" in unknown
    beyond = refused(["view", "grasps.npz", "--grasp", "2"], capsys)
    assert "holds no grasp '2': expected a number from 0 to 1" in beyond


@HAS_VISER
@pytest.mark.slow
@pytest.mark.parametrize("query", ["mug <right>", "1"])
def test_the_chosen_grasp_is_saved_under_its_name(folder, capsys, query):
    save_grasps("grasps.npz", make_sets([3, 4]), name=["mug, left", "mug <right>"])
    assert main(["view", "grasps.npz", "--grasp", query, "--save", "right.html"]) == 0
    page = (folder / "right.html").read_text()
    assert re.findall("<title>(.*?)</title>", page) == ["grasps.npz: mug &lt;right&gt;"]
    words = page[page.index("<aside") :]
    assert "mug &lt;right&gt;" in words and "contact 4" in words and "mug, left" not in words


@HAS_VISER
@pytest.mark.slow
def test_a_scene_of_several_objects_is_saved_with_all_of_them(folder, capsys):
    assert main(["view", "stack", "--save", "stack.html"]) == 0
    page = (folder / "stack.html").read_text()
    assert "<title>a ball on two blocks</title>" in page
    assert "written: stack.html" in capsys.readouterr().out and "friction margin" in page


@HAS_VISER
def test_a_port_in_use(folder, capsys):
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        message = refused(["view", "--port", str(port)], capsys)
    assert re.search(rf"port {port} of 127.0.0.1 is in use; \d+ is free: --port \d+$", message.strip())


@HAS_VISER
def test_a_bad_grasp_is_named(folder, capsys):
    sets = make_sets([3, 3])
    sets.friction[4] = -1
    with open("bad.csv", "w") as file:
        file.write("grasp,px,py,pz,ax,ay,az,friction,squeeze,fx,fy,fz,tx,ty,tz\n")
        for k in range(6):
            row = [
                k // 3,
                *sets.points[k],
                *sets.normals[k],
                sets.friction[k],
                sets.squeeze[k],
                *sets.wrench[k // 3, 0],
            ]
            file.write(",".join(map(str, row)) + "\n")
    assert "friction[1, 1] is -1" in refused(["view", "bad.csv"], capsys)


@pytest.mark.parametrize("arguments", [["view"], ["view", "--save", "page.html"]])
def test_without_viser_one_line_says_how_to_get_it(folder, capsys, monkeypatch, arguments):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "the live scene needs viser: pip install 'jaxgrasp[view]'" in refused(arguments, capsys)
    assert not list(folder.iterdir())


def test_a_page_beside_the_loop_needs_a_glove(folder, capsys):
    assert "view needs a glove, by port or connect" in refused(["glove", "run", "--view"], capsys)
    message = refused(["experiment", "run", "--subject", "a", "--simulate", "--view"], capsys)
    assert "view needs the port of a glove" in message
