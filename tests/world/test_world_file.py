"""The worlds of scene files: what begins inside what is refused, and the command runs them by either engine."""

import sys

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.cli.main import main
from jaxgrasp.grip import GripType, Hold
from jaxgrasp.grip.scene_entries import OtherEntry
from jaxgrasp.grip.scene_file import GrippedScene, SceneFile
from jaxgrasp.hand import Contacts, Pose, Posture, sphere_tree
from jaxgrasp.world import stands, world_of

from .worlds import BLOCK, tower


def made() -> GrippedScene:
    """Return a block on a table, which nothing grips."""
    world, state = tower([0.2])
    posture = Posture(Pose(jnp.full(3, 9.0), jnp.eye(3)), jnp.zeros(2))
    zero = jnp.zeros((2, 3))
    contacts = Contacts(zero, zero.at[:, 0].set(1), zero[:, 0], zero[:, 0], jnp.asarray(0))
    placed = Pose(jnp.asarray(state.placed.origin[0]), jnp.asarray(state.placed.rotation[0]))
    return GrippedScene(world.scene, posture, posture.angles, placed, contacts, GripType.NONE, "optimum")


def block(*at: float, **kwargs) -> OtherEntry:
    return OtherEntry(shape="box", size=(0.06, 0.05, 0.04), at=at, **kwargs)


def test_objects_stand_as_the_file_says():
    turned = block(0.1, 0.0, 0.0, turn=(0.0, 0.0, 0.5), rubbing=0.2, torsion=0.004)
    file = SceneFile(other=(block(0.0, 0.0, 0.04, mass=0.3), turned))
    world, state = world_of(file, made())
    np.testing.assert_allclose(state.placed.origin - state.placed.origin[0], [[0, 0, 0], [0, 0, 0.04], [0.1, 0, 0]])
    assert [body.body.mass for body in world.bodies] == [0.2, 0.3, 0.15] and world.bodies[2].rubbing == 0.2
    assert [body.torsion for body in world.bodies] == [None, None, 0.004] and world.is_soft
    assert stands(world, state.placed).stands


@pytest.mark.parametrize(
    ("others", "words"),
    [
        ([block(0.0, 0.0, 0.03)], "other[0] begins 10 mm deep in the object: expected it outside"),
        ([block(0.1, 0.0, -0.005)], "other[0] begins 5 mm deep in the table: expected it outside"),
        (
            [block(0.0, 0.0, 0.04), block(0.05, 0.0, 0.04)],
            "other[1] begins 10 mm deep in other[0]: expected it outside",
        ),
    ],
)
def test_what_a_world_cannot_have_is_refused_by_key(others, words):
    with pytest.raises(ValueError) as raised:
        world_of(SceneFile(other=tuple(others)), made())
    assert str(raised.value) == words


@pytest.mark.slow
def test_a_mesh_is_inside_another_by_its_balls():
    """They lie inside it, so that it is in another by what they fill: at most the 10 mm of the exact shapes."""
    gripped = made()
    as_tree = eqx.tree_at(lambda m: m.scene.body.shape, gripped, sphere_tree(BLOCK, 3))
    with pytest.raises(ValueError, match=r"other\[0\] begins (9\.\d+|10) mm deep in the object"):
        world_of(SceneFile(other=(block(0.0, 0.0, 0.03),)), as_tree)


def test_without_mujoco_one_line_says_what_to_install(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(["grip", "--scene", "stack", "--engine", "mujoco"]) == 1
    message = capsys.readouterr().err
    assert "engine mujoco needs MuJoCo: pip install 'jaxgrasp[hands]'" in message and message.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["quasi-static", "mujoco"])
def test_the_command_takes_a_ball_from_two_blocks(folder, capsys, engine):
    assert main(["grip", "--scene", "stack", "--engine", engine, "--seconds", "1.6", "--no-report"]) == 0
    output = capsys.readouterr().out
    assert f"moved by the engine {engine}" in output and "the hand did not touch it" in output
    with np.load("jaxgrasp-grip/grip.npz") as arrays:
        rise = arrays["object_origin"][-1, 2] - arrays["object_origin"][0, 2]
        assert rise > 0.1 and arrays["hold"][-1] == Hold.STABLE
        went = np.abs(arrays["others_origin"][-1] - arrays["others_origin"][0]).max()
        assert went < 3e-3 and arrays["loads_by_table"].shape == (len(arrays["time"]), 3, 6)
        # At last the table has the blocks' weight alone.
        assert arrays["loads_by_table"][-2, 2, 2] == pytest.approx(9.81 * 0.5, rel=1e-3)
