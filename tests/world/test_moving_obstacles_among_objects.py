"""Obstacles that move among several objects, by either engine: what they push goes with them, as its weight asks."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrasp.grip.scene import Obstacle, ObstaclePath
from jaxgrasp.hand import Box, Pose, rigid_body, sphere_tree
from tests.world.worlds import BLOCK, ENGINES, G, left_alone, world_with

SPEED, MASSES, RUBBING = 0.05, [0.2, 0.3], 0.5


def pushed(at: tuple[float, float, float], direction: tuple[float, float, float], shape: Box):
    """Return two blocks beside each other, and a board that moves steadily along a direction for two seconds."""
    path = ObstaclePath(
        jnp.array([0.0, 2.0]), jnp.array([[0.0, 0, 0], 2 * SPEED * np.array(direction)]), jnp.zeros((2, 3))
    )
    board = Obstacle(shape, Pose(jnp.array(at), jnp.eye(3)), 4000.0, path=path)
    centers = np.array([[0.0, 0.0, BLOCK.height / 2], [0.5, 0.0, BLOCK.height / 2]])
    return world_with(
        [BLOCK, BLOCK], centers, MASSES, rubbing=RUBBING, obstacles=(board,), outline=rigid_body(sphere_tree(BLOCK))
    )


@pytest.mark.parametrize("engine", ["quasi-static", pytest.param("mujoco", marks=pytest.mark.slow)])
def test_a_board_pushes_a_block_along_the_table_by_its_friction(engine):
    """Coulomb: the board's push is mu m g once the block goes with it; the other block stays."""
    gap = 0.002
    world, state = pushed((-BLOCK.length / 2 - 0.01 - gap, 0.0, 0.02), (1.0, 0, 0), Box(0.02, 0.1, 0.03))
    steps = left_alone(world, ENGINES[engine](world, state), state, 0.6)
    last, before = steps[-1], steps[-31]
    assert last.state.time == pytest.approx(0.6)
    speed = (last.state.placed.origin - before.state.placed.origin)[0] / 0.3
    # MuJoCo's block sticks and slips, and hops a little.
    np.testing.assert_allclose(speed, [SPEED, 0, 0], atol=1e-6 if engine == "quasi-static" else 3e-3)
    push, rub = (np.array([getattr(s.loads, by)[0] for s in steps[-30:]]) for by in ("by_obstacles", "by_table"))
    gained = np.array([s.gained[0, 0] for s in steps[-30:]])
    np.testing.assert_allclose(push[:, 0] + rub[:, 0], gained, atol=0.02 * MASSES[0] * G)
    assert np.all(-rub[:, 0] <= RUBBING * rub[:, 2] * 1.01 + 1e-9)
    if engine == "quasi-static":
        np.testing.assert_allclose(push[:, 0], RUBBING * MASSES[0] * G, rtol=1e-4)
    went = last.state.placed.origin[:, 0] - state.placed.origin[:, 0]
    # From where it stood it lags by the gap, and by as much as the board's springs give.
    assert went[0] == pytest.approx(0.6 * SPEED - gap, abs=1e-3)
    assert abs(went[1]) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("engine", list(ENGINES))
def test_a_board_lifts_what_stands_on_it(engine):
    world, state = pushed((0.0, 0.0, -0.0101), (0, 0, 1.0), Box(0.04, 0.04, 0.02))
    steps = left_alone(world, ENGINES[engine](world, state), state, 0.8)
    np.testing.assert_allclose(steps[-1].state.motion.linear[0], [0, 0, SPEED], atol=2e-3)
    assert steps[-1].loads.by_obstacles[0][2] == pytest.approx(MASSES[0] * G, rel=0.01)
    assert np.abs(steps[-1].loads.by_table[0]).max() < 1e-6
    assert steps[-1].loads.by_table[1][2] == pytest.approx(MASSES[1] * G, rel=0.01)
