"""Warnings of quantities out of human scale, and of nothing else."""

import pytest

from jaxgrasp.grip.scene_entries import GripEntry, HandEntry, ObjectEntry
from jaxgrasp.grip.scene_file import (
    TORQUE,
    SceneFile,
    human_scale_warnings,
    load_scene,
    ready_scenes,
    scene_path,
    torque_warnings,
)


@pytest.mark.parametrize(
    "entries, words",
    [
        ({"object": ObjectEntry(shape="sphere", radius=3.0)}, "radius or half its edge is 3 m, out of human scale"),
        ({"object": ObjectEntry(shape="box", size=(50.0, 30.0, 2.0))}, "half its edge is 25 m"),
        ({"object": ObjectEntry(mass=400.0)}, "mass is 400 kg, out of human scale, 0.001 to 20 kg: is it in kg?"),
        ({"hand": HandEntry(length=19.0)}, "the hand's length is 19 m"),
        ({"grip": GripEntry(depth=2.0)}, "press is 2 m"),
    ],
)
def test_another_unit_is_suspected(entries, words):
    (line,) = human_scale_warnings(SceneFile(**{"name": "a scene"} | entries))
    assert line.startswith("WARNING: ") and words in line


def test_the_ready_scenes_are_of_human_scale():
    assert not [line for name in ready_scenes() for line in human_scale_warnings(load_scene(scene_path(name)))]


def test_torques_of_no_finger():
    assert not torque_warnings(TORQUE) and "57.1 N.m" in torque_warnings(57.1)[0]
