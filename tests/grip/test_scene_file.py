"""Scenes in TOML files: what they leave out, what is wrong with them, and that hand and object stand as they say."""

import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.grip.scene_file import SceneFile, gripped_scene, load_scene, ready_scenes
from jaxgrasp.grip.table_support import support_points


def test_an_empty_file_is_the_ready_cylinder(folder):
    (folder / "empty.toml").write_text("")
    assert load_scene("empty.toml") == load_scene(ready_scenes()["cylinder"]) == SceneFile()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[objekt]\nmass = 1", "'objekt': did you mean 'object'?"),
        ("[object]\nmas = 1", "object has 'mas': did you mean 'mass'?"),
        ("[object]\nmass = -1", "object: mass is -1.0: expected a positive number"),
        ('[object]\nmass = "heavy"', "object.mass is heavy: expected a number"),
        ("[object]\nradius = inf", "object.radius is inf: expected a number"),
        ("[object]\nfriction = -0.1", "object: friction is -0.1: expected a finite number, 0 or more"),
        ('[object]\nshape = "cone"', "object.shape is 'cone': did you mean 'cylinder'?"),
        ('[hand]\nside = "both"', "hand.side is 'both'"),
        ("[hand]\nlength = 0", "hand: length is 0.0: expected a positive number"),
        ('[grip]\nkind = "precision"', "grip.kind is 'precision': did you mean 'precision-5'?"),
        ("[table]\nbelow = -1", "table: below is -1.0: expected a finite number, 0 or more"),
        ("[world]\ngravity = [0, 0]", "world: gravity is [0.0, 0.0]: expected three finite numbers"),
        ("hand = 3", "hand is 3: expected a table"),
        ("name = 3", "name is 3: expected text"),
        ("[object", "is no TOML"),
    ],
)
def test_what_is_wrong_is_said_by_table_and_key_before_anything_compiles(folder, capsys, text, words):
    (folder / "scene.toml").write_text(text)
    for command in (
        ["scene", "check", "scene.toml"],
        ["glove", "run", "scene.toml"],
        ["grip", "--scene", "scene.toml"],
    ):
        assert main(command) == 1
        said = capsys.readouterr().err
        assert words in said and said.count("\n") == 1


def test_ready_scenes_are_listed_and_checked(folder, capsys):
    assert main(["scene", "list"]) == 0
    said = capsys.readouterr().out
    for name in ready_scenes():
        assert name in said and main(["scene", "check", name]) == 0
    assert main(["scene", "check", "nowhere"]) == 1
    assert "scene is 'nowhere': expected a TOML file, or one of ball, box, cylinder" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cylinder", "ball", "box"])
def test_the_object_stands_as_far_above_the_table_as_the_file_says(name):
    file = load_scene(ready_scenes()[name])
    made = gripped_scene(file)
    _, heights = support_points(made.scene, made.placed)
    np.testing.assert_allclose(heights, file.table.below, atol=1e-5)
    assert made.contacts.present.sum() >= 3 and made.scene.table_friction == file.table.friction
