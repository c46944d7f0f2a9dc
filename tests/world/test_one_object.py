"""One object on its own: the engine of many objects moves it as the engine of a held one does."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrasp.grip import simulate
from jaxgrasp.hand import Box, Cylinder, Pose
from tests.grip.hands import without_hand
from tests.world.worlds import ENGINES, G, left_alone, world_with

DT, SECONDS = 2.5e-3, 0.8


@pytest.mark.slow
@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("shape", [Box(0.06, 0.08, 0.05), Cylinder(0.03, 0.1)])
@pytest.mark.parametrize("tilt", [10, 30])
def test_a_tilted_object_comes_to_lie_alike(name, shape, tilt):
    turn = Rotation.from_euler("x", tilt, degrees=True).as_matrix()
    world, state = world_with([shape], np.array([[0, 0, 0.08]]), [0.3], turns=turn[None])
    alone = simulate(
        world.scene, without_hand(round(SECONDS / DT)), Pose(jnp.array([0, 0, 0.08]), jnp.asarray(turn)), DT
    )
    placed = left_alone(world, ENGINES[name](world, state), state, SECONDS, DT)[-1].state.placed
    held = alone[-1].placed
    # On the same face, as high, and at the same place to less than the way of a step at the speed of the impact.
    up, same_up = np.asarray(held.rotation)[2], placed.rotation[0, 2]
    assert np.abs(up).max() > 1 - 1e-3
    np.testing.assert_allclose(same_up, up, atol=2e-3)
    np.testing.assert_allclose(placed.origin[0, 2], held.origin[2], atol=1e-4)
    np.testing.assert_allclose(placed.origin[0, :2], held.origin[:2], atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("slope, rubbing", [(0.5, 0.45), (0.5, 0.55), (0.2, 0.0)])
def test_on_a_slope_it_slides_alike(slope, rubbing):
    """The engine of many objects has the law and the solver of the held one: places agree in every step."""
    angle = np.arctan(slope)
    gravity = G * np.array([np.sin(angle), 0, -np.cos(angle)])
    shape, start = Box(0.06, 0.08, 0.05), np.array([0, 0, 0.025])
    world, state = world_with([shape], start[None], [0.3], rubbing=rubbing, gravity=tuple(gravity))
    records = simulate(world.scene, without_hand(160), Pose(jnp.asarray(start), jnp.eye(3)), DT)
    held = np.stack([record.placed.origin for record in records[1:]])
    steps = left_alone(world, ENGINES["quasi-static"](world, state), state, 159 * DT, DT)
    origins = np.stack([step.state.placed.origin[0] for step in steps])
    assert (origins[-1, 0] > 0.03) == (slope > rubbing)
    np.testing.assert_allclose(origins, held[: len(origins)], atol=2e-6)
