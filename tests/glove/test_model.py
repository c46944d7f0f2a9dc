"""Gloves: what they pull on, from a hand's joint torques, and what a file may say of one."""

import subprocess
import sys

import numpy as np
import pytest

from jaxgrasp.glove.model import FLEXIONS, GloveModel, load_glove, lrp_hand_master
from jaxgrasp.hand import human_hand

FILE = """
name = "ours"
joints = ["index MP", "thumb IP"]
limits = [0.1, 0.2]
rate = 2
quantum = 1e-4
"""


def test_it_needs_no_jax():
    code = (
        "import sys, pkgutil, importlib, jaxgrasp.glove\n"
        "for one in pkgutil.walk_packages(jaxgrasp.glove.__path__, 'jaxgrasp.glove.'):\n"
        "    importlib.import_module(one.name)\n"
        "assert 'jax' not in sys.modules and 'jaxgrasp.glove.guard' in sys.modules"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_the_papers_glove_resists_the_flexions_of_the_human_hand():
    model, joints = lrp_hand_master(), human_hand().joints
    assert len(model.joints) == 14 and set(model.limits) == {0.12}
    assert set(joints) - set(model.joints) == {joint for joint in joints if "abduction" in joint}
    torques = np.arange(2.0 * len(joints)).reshape(2, -1)
    resisted = model.resisting(joints, torques)
    np.testing.assert_array_equal(resisted[:, 3], -torques[:, joints.index("index PIP")])
    assert resisted.shape == (2, 14) and model.joints == FLEXIONS


def test_no_count_exceeds_its_limit():
    for limit in (0.12, 0.05, 0.3, 1e-5, 0.1 + 0.2):
        model = GloveModel("one", ("a",), (limit,))
        assert limit - model.quantum < model.max_counts[0] * model.quantum <= limit


def test_a_file(tmp_path):
    path = tmp_path / "glove.toml"
    path.write_text(FILE)
    assert load_glove(path) == GloveModel("ours", ("index MP", "thumb IP"), (0.1, 0.2), 2.0, 1e-4)
    path.write_text(FILE.replace("[0.1, 0.2]", "0.1"))
    assert load_glove(path).limits == (0.1, 0.1)


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("quantum", "quantun", "has 'quantun': did you mean 'quantum'?"),
        ('name = "ours"', "", "has no 'name'"),
        ('"ours"', "3", "name is 3: expected text"),
        ('"thumb IP"', "3", "expected a list of names"),
        ('"thumb IP"', '"index MP"', r"joints\[1\] is 'index MP' again"),
        ('["index MP", "thumb IP"]', "[]", "joints has 0 entries: expected 1 to 32"),
        ("0.2]", "nan]", r"limits\[1\] is nan: expected a positive number"),
        ("0.2]", "true]", r"limits\[1\] is True: expected a number"),
        ("[0.1, 0.2]", "[0.1]", "limits has 1 entries: expected one for each of 2 joints"),
        ("0.2]", "20.0]", r"limits\[1\] is 20: expected 1 to 32767 times quantum"),
        ("rate = 2", "rate = -2", "rate is -2.0: expected a positive number"),
        ("rate = 2", "rate 2", "is no TOML"),
        ("1e-4", "1.5e-7", "quantum is 1.5e-07: expected 1 to 32767 times 1e-7 N.m"),
        ("1e-4", "4e-8", "quantum is 4e-08"),
        ("0.2]", "1" + "0" * 400 + "]", r"limits\[1\] is 1000"),
        ('["index MP", "thumb IP"]\nlimits = [0.1, 0.2]', "5\nlimits = 0.1", "expected a list of names"),
    ],
)
def test_bad_files(tmp_path, old, new, message):
    path = tmp_path / "glove.toml"
    path.write_text(FILE.replace(old, new))
    with pytest.raises(ValueError, match=message):
        load_glove(path)


def test_a_hand_without_its_joints():
    with pytest.raises(ValueError, match="the hand has no joint 'thumb MP', .*: did you mean 'thumb MCP'?"):
        lrp_hand_master().resisting(["thumb MCP", "thumb IP"], np.zeros(2))
    with pytest.raises(ValueError, match=r"torques have shape \(3,\): expected \(..., 19\)"):
        lrp_hand_master().resisting(human_hand().joints, np.zeros(3))
