"""Tasks in files: the numbers that stand there, and one line for what is no task."""

import jax
import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.sensitivity.task_file import FINGERS, cylinder_task, load_task

PAPER = """
fingers = ["thumb", "index", "middle", "ring", "little"]
gravity = [9.81, 0, 0]
[held]
kind = "cylinder"
radius = 0.05
length = 0.15
azimuths = [3.141592653589793, 0, 0, 0, 0]
heights = [0, 0.03, 0.01, -0.01, -0.03]
friction = [0.5, 0.5, 0.5, 0.5, 0.5]
contributions = [3.1, 0.1, 1, 1, 1]
stiffness = [1000, 1000, 1000, 1000, 1000]
depths = [2.5e-3, 2.5e-3, 2.5e-3, 2.5e-3, 2.5e-3]
mass = 1.019367991845056
[path]
kind = "turn"
axis = [0, 0, 1]
speed = 3.141592653589793
reversal = 2
"""
BLOCK = """
fingers = ["left", "right"]
[held]
kind = "points"
points = [[0.03, 0, 0], [-0.03, 0, 0]]
normals = [[-1, 0, 0], [1, 0, 0]]
friction = [0.5, 0.4]
contributions = [1, 1]
stiffness = [1000, 1000]
depths = [5e-3, 5e-3]
mass = 0.2
inertia = [[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]]
[path]
kind = "lift"
height = 0.1
duration = 0.5
"""


def test_the_papers_task_in_a_file_is_the_papers(folder):
    (folder / "paper.toml").write_text(PAPER)
    loaded, paper = load_task("paper.toml"), cylinder_task()
    assert loaded.fingers == FINGERS
    for leaf, expected in zip(*map(jax.tree.leaves, (loaded.task.parameters, paper.parameters)), strict=True):
        np.testing.assert_allclose(leaf, expected, rtol=1e-15)
    for leaf, expected in zip(*(jax.tree.leaves(task(0.7)) for task in (loaded.task, paper)), strict=True):
        np.testing.assert_allclose(leaf, expected, rtol=1e-12, atol=1e-12)


def test_a_block_that_is_lifted_weighs_more_as_it_speeds_up(folder):
    """Against the second difference of the way, by hand."""
    (folder / "block.toml").write_text(BLOCK)
    task, fingers = load_task("block.toml")
    assert fingers == ("left", "right")

    def height(time: float) -> float:
        share = min(max(time / 0.5, 0), 1)
        return 0.1 * share**3 * (10 - 15 * share + 6 * share**2)

    for time in (0.1, 0.4):
        grasp, wrench = task(time)
        gained = (height(time + 1e-4) - 2 * height(time) + height(time - 1e-4)) / 1e-8
        np.testing.assert_allclose(wrench, [0, 0, 0.2 * (9.81 + gained), 0, 0, 0], atol=1e-5)
        np.testing.assert_allclose(grasp.squeeze, [5, 5])
        np.testing.assert_array_equal(grasp.normals, [[-1, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gravity = [9.81, 0, 0]", "gravty = [9.81, 0, 0]", "has 'gravty': did you mean 'gravity'?"),
        ("gravity = [9.81, 0, 0]", "gravity = [9.81, 0]", "gravity is [9.81, 0]: expected three numbers"),
        ('"little"]', '"ring"]', "fingers is ['thumb', 'index', 'middle', 'ring', 'ring']: expected a list of names"),
        ('kind = "cylinder"', 'kind = "cone"', "held.kind is 'cone'"),
        ('kind = "turn"', 'kind = "trun"', "path.kind is 'trun': did you mean 'turn'?"),
        (
            "friction = [0.5, 0.5,",
            "friction = [-0.5, 0.5,",
            "held: friction[0] is -0.5: expected a number, zero or more",
        ),
        ("friction = [0.5, 0.5,", "friction = [0.5,", "held.friction has 4 entries: expected 5, as fingers"),
        ("radius = 0.05", "radius = 0", "held: radius is 0.0: expected a positive number"),
        ("radius = 0.05\n", "", "held has no 'radius'"),
        ("axis = [0, 0, 1]", "axis = [0, 0, 0]", "path: axis is [0.0, 0.0, 0.0]: expected a direction"),
        ("[held]", "held = 3\n[other]", "has 'other'"),
        ("mass = 1.019367991845056", "mass = nan", "held.mass is nan: expected a number"),
    ],
)
def test_what_is_no_task_is_one_line(folder, capsys, old, new, message):
    assert old in PAPER
    (folder / "bad.toml").write_text(PAPER.replace(old, new, 1))
    assert main(["sensitivity", "--task", "bad.toml", "--methods", "A"]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert [path.name for path in folder.iterdir()] == ["bad.toml"]


def test_a_task_that_is_not_there_and_a_finger_that_it_has_not(folder, capsys):
    assert main(["sensitivity", "--task", "nowhere.toml"]) == 1
    assert "task is 'nowhere.toml': expected a TOML file, or cylinder" in capsys.readouterr().err
    (folder / "block.toml").write_text(BLOCK)
    assert main(["sensitivity", "--task", "block.toml"]) == 1
    assert "finger is 'index': expected one of left, right" in capsys.readouterr().err


@pytest.mark.slow
def test_a_task_of_ones_own_is_followed(folder, capsys):
    (folder / "block.toml").write_text(BLOCK)
    options = ["--finger", "left", "--by", "mass", "friction", "--vary", "mass", "--values", "0.1", "0.3"]
    run_options = ["--methods", "B", "--step", "0.1", "--seconds", "0.5", "--no-report", "--out", "out"]
    assert main(["sensitivity", "--task", "block.toml", *options, *run_options]) == 0
    assert "B: worst slip angle" in capsys.readouterr().out
    rows = (folder / "out" / "sensitivity.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 6 and "friction[left]" in rows[0]
